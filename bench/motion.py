"""The motions of motion_problems.mac with SciPy's DOP853 and, where it is installed, heyoka's Taylor integrator: CPU
milliseconds of a run with the tolerance asked for.  Neither says how large its error is."""
import time
import numpy as np
import sympy as sm
from scipy.integrate import solve_ivp

try:
    import heyoka
except ImportError:
    heyoka = None
    print("motion: heyoka is not there: pip install heyoka into", __import__("sys").prefix)

x, y, u, v, w, p, a, b = sm.symbols("x y u v w p a b")
R = sm.Rational


def bodies(q, v, m):
    n, d = len(m), len(q[0])
    force = [sum(m[j]*(q[j][c] - q[i][c])/sum((q[i][k] - q[j][k])**2 for k in range(d))**R(3, 2)
                 for j in range(n) if j != i) for i in range(n) for c in range(d)]
    return sum(v, []) + force, sum(q, []) + sum(v, [])


def named(names, n, first):
    return [[sm.Symbol(name + str(i)) for name in names] for i in range(first, first + n)]


m, D, g = R(12277471, 10**9), 2 - sm.cos(a - b)**2, R(981, 100)
near, far = ((x + m)**2 + y**2)**R(3, 2), ((x - 1 + m)**2 + y**2)**R(3, 2)
force = w*(u*sm.cos(p) + v*sm.sin(p)) + sm.sin(p)
masses = [R("2.95912208286e-4")*R(k) for k in ("1.00000597682", "0.000954786104043", "0.000285583733151",
                                               "0.0000437273164546", "0.0000517759138449")] + \
    [R("2.95912208286e-4")/130000000]
problems = {
    "kepler": (([u, v, -x/(x**2 + y**2)**R(3, 2), -y/(x**2 + y**2)**R(3, 2)], [x, y, u, v]),
               [0.1, 0, 0, 19**0.5], 20*np.pi),
    "arenstorf": (([u, v, x + 2*v - (1 - m)*(x + m)/near - m*(x - 1 + m)/far, y - 2*u - (1 - m)*y/near - m*y/far],
                   [x, y, u, v]), [0.994, 0, 0, -2.00158510637908252240537862224], 17.0652165601579625588917206249),
    "pleiades": (bodies(named("xy", 7, 1), named("uv", 7, 1), range(1, 8)),
                 [3, 3, 3, -3, -1, 2, -3, 0, 2, 0, -2, -4, 2, 4,
                  0, 0, 0, 0, 0, 0, 0, -1.25, 0, 1, 1.75, 0, -1.5, 0], 3.0),
    "outer planets": (bodies(named("xyz", 6, 0), named("uvw", 6, 0), masses),
                      [0, 0, 0, -3.5023653, -3.8169847, -1.5507963, 9.0755314, -3.0458353, -1.6483708, 8.3101420,
                       -16.2901086, -7.2521278, 11.4707666, -25.7294829, -10.8169456, -15.5387357, -25.2225594,
                       -3.1902382, 0, 0, 0, 0.00565429, -0.00412490, -0.00190589, 0.00168318, 0.00483525, 0.00192462,
                       0.00354178, 0.00137102, 0.00055029, 0.00288930, 0.00114527, 0.00039677, 0.00276725,
                       -0.00170702, -0.00136504], 50000.0),
    "henon_heiles": (([u, v, -x - 2*x*y, -y - x**2 + y**2], [x, y, u, v]), [0, 0.1, 0.39590402658134056, 0], 1000.0),
    "double pendulum": (([u, v, (-2*g*sm.sin(a) + sm.cos(a - b)*g*sm.sin(b)
                                 - sm.sin(a - b)*(v**2 + u**2*sm.cos(a - b)))/D,
                          (2*sm.sin(a - b)*u**2 + sm.sin(a - b)*sm.cos(a - b)*v**2
                           + 2*g*sm.sin(a)*sm.cos(a - b) - 2*g*sm.sin(b))/D], [a, b, u, v]),
                        [1.2, -0.7, 0, 0], 20.0),
    "knife edge": (([u, v, w, 1 - force*sm.sin(p), force*sm.cos(p), sm.Integer(0)], [x, y, p, u, v, w]),
                   [0, 0, 0, 0, 0, 1], 100.0),
    "sleigh": (([v*sm.cos(p), v*sm.sin(p), w, w**2/5, -v*w/5/(1 + R(1, 25))], [x, y, p, v, w]),
               [0, 0, 0, 0.5, 2], 30.0),
}


def milliseconds(function):
    count, least = 1, float("inf")
    while True:
        start = time.process_time()
        for _ in range(count):
            function()
        spent = time.process_time() - start
        if spent > 0.1:
            break
        count *= 2
    for _ in range(3):
        start = time.process_time()
        for _ in range(count):
            function()
        least = min(least, (time.process_time() - start)/count)
    return 1000*least


def taylor(rates, states, start, end, tolerance):
    """heyoka takes no rationals from SymPy: they become numbers."""
    variables = [heyoka.expression(str(s)) for s in states]
    names = dict(zip(states, variables))
    system = [(variable, heyoka.from_sympy(sm.N(rate, 17), names)) for variable, rate in zip(variables, rates)]
    integrator = heyoka.taylor_adaptive(system, start, tol=tolerance, compact_mode=len(states) > 20)

    def run():
        integrator.time = 0.0
        integrator.state[:] = start
        integrator.propagate_until(end)
        return integrator.state
    return run


def main():
    for tolerance in (1e-6, 1e-9, 1e-12):
        for name, ((rates, states), start, end) in problems.items():
            start = np.array(start, dtype=float)
            field = sm.lambdify([states], rates, "math", cse=True)
            spent = milliseconds(lambda: solve_ivp(lambda t, z: field(z), (0, end), start, method="DOP853",
                                                   rtol=tolerance, atol=tolerance))
            line = "motion: peers  %-16s %7.0e  SciPy %9.2f" % (name, tolerance, spent)
            if heyoka:
                line += "  heyoka %7.3f" % milliseconds(taylor(rates, states, start, end, tolerance))
            print(line, flush=True)


if __name__ == "__main__":
    main()
