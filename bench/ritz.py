"""The same two problems between fixed ends by scipy.integrate.solve_bvp, at several tolerances; see ritz.mac."""
import time
import numpy
from scipy.integrate import solve_bvp, solve_ivp
from scipy.optimize import brentq

TIMES = numpy.linspace(0, 1, 201)


def truth_of(force):
    """By shooting with DOP853, as accurately as doubles allow."""
    def shot(v):
        return solve_ivp(lambda t, y: [y[1], force(y[0])], (0, 1), [0, v], method="DOP853", rtol=1e-13, atol=1e-14,
                         dense_output=True)
    return shot(brentq(lambda v: shot(v).y[0, -1] - 1, 0.5, 3, xtol=1e-15)).sol(TIMES)[0]


def tell(name, force):
    truth = truth_of(force)
    for tolerance in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10):
        clock = time.perf_counter()
        found = solve_bvp(lambda t, y: numpy.vstack([y[1], force(y[0])]), lambda a, b: numpy.array([a[0], b[0] - 1]),
                          numpy.linspace(0, 1, 5), numpy.vstack([numpy.linspace(0, 1, 5), numpy.ones(5)]),
                          tol=tolerance, max_nodes=100000)
        seconds = time.perf_counter() - clock
        print(f"{name}, solve_bvp, tolerance {tolerance:.0e}, {len(found.x)} nodes: "
              f"error {abs(found.sol(TIMES)[0] - truth).max():.1e}, {seconds:.3f} s")


tell("oscillator", lambda x: -x)
tell("pendulum", lambda x: -numpy.sin(x))
