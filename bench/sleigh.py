"""The motion of sleigh.mac with SciPy's DOP853 and a right-hand side lambdified by SymPy (explicit accelerations, cse):
the loosest tolerance whose error against the closed solution is at most 1e-9, and its seconds."""
import time
import numpy as np
import sympy as sm
from scipy.integrate import solve_ivp

x, y, phi, vx, vy, w = state = sm.symbols("x y phi vx vy w")
m, a, J = sm.Integer(2), sm.Rational(1, 5), sm.Rational(1, 20)
start = time.process_time()
# the accelerations that normal_form(sleigh) gives
v = vx*sm.cos(phi) + vy*sm.sin(phi)
rates = [vx, vy, w,
         -w*(sm.sin(phi)*v - a*sm.cos(phi)*w), w*(sm.cos(phi)*v + a*sm.sin(phi)*w), -a*m*v*w/(J + m*a**2)]
field = sm.lambdify([state], rates, cse=True)
compiled = time.process_time() - start

m, a, J = 2.0, 0.2, 0.05
V = np.sqrt(1 + (J + m*a**2)/m*0.09)
W, k = np.sqrt(m/(J + m*a**2))*V, m*a/(J + m*a**2)*V
c = np.arctanh(-1/V)
exact = np.array([V*np.tanh(10*k + c), W/np.cosh(10*k + c), W/k*(np.arctan(np.sinh(10*k + c)) - np.arctan(np.sinh(c)))])
for tolerance in 10.0**-np.arange(6, 15):
    def run():
        return solve_ivp(lambda t, z: field(z), (0, 10), [0, 0, 0, -1, 0, 0.3], method="DOP853", rtol=tolerance,
                         atol=tolerance)
    z = run().y[:, -1]
    error = np.abs([z[3]*np.cos(z[2]) + z[4]*np.sin(z[2]), z[5], z[2]] - exact).max()
    if error <= 1e-9:
        break
start, n = time.process_time(), 10
for _ in range(n):
    run()
print("sleigh SciPy DOP853: %.5f s, error %.1e, tolerance %.0e, lambdified in %.2f s"
      % ((time.process_time() - start)/n, error, tolerance, compiled))
