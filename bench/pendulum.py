"""The n-link pendulum of pendulum.mac with SymPy's LagrangesMethod: seconds for M and f, operations after cse."""
import time
import sympy as sm
import sympy.physics.mechanics as me


def measure(n):
    t = me.dynamicsymbols._t
    q = me.dynamicsymbols("q1:%d" % (n + 1))
    m, l, g = sm.symbols("m1:%d" % (n + 1)), sm.symbols("l1:%d" % (n + 1)), sm.Symbol("g")
    x = y = T = V = 0
    for i in range(n):
        x, y = x + l[i] * sm.sin(q[i]), y - l[i] * sm.cos(q[i])
        T, V = T + m[i] * (x.diff(t)**2 + y.diff(t)**2) / 2, V + m[i] * g * y
    start = time.process_time()
    method = me.LagrangesMethod(T - V, q)
    method.form_lagranges_equations()
    M, f = method.mass_matrix, method.forcing
    seconds = time.process_time() - start
    shared, rest = sm.cse(list(M) + list(f))
    operations = sum(int(sm.count_ops(e)) for _, e in shared) + sum(int(sm.count_ops(e)) for e in rest)
    print("pendulum SymPy  n = %2d: M and f in %.3f s, %d operations" % (n, seconds, operations))


for n in (2, 4, 8):
    measure(n)
