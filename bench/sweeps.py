"""The motions of sweeps.mac with heyoka's batch integrator, as many at a time as the processor has lanes: CPU
microseconds a motion."""
import sys
import time

try:
    import heyoka as hy
    import numpy as np
except ImportError:
    print("heyoka: not there: pip install heyoka into", sys.prefix)
    sys.exit()

n = int(sys.argv[1])
a, b, u, v = hy.make_vars("a", "b", "u", "v")
c, s = hy.cos(a - b), hy.sin(a - b)
p, q = -v * v * s - 2 * 9.81 * hy.sin(a), u * u * s - 9.81 * hy.sin(b)
det = 2.0 - c * c
system = [(a, u), (b, v), (u, (p - c * q) / det), (v, (2.0 * q - c * p) / det)]
angles = np.linspace(-np.pi, np.pi, n)
starts = np.array([[x, y, 0.0, 0.0] for x in angles for y in angles])
size = hy.recommended_simd_size()
for tolerance in (1e-7, 1e-10):
    batch = hy.taylor_adaptive_batch(system, np.zeros((4, size)), tol=tolerance)
    seconds = []
    for run in range(7):
        begin = time.process_time()
        for k in range(0, len(starts) - size + 1, size):
            batch.set_time(0.0)
            batch.state[:] = starts[k:k + size].T
            batch.propagate_until(3.0)
        seconds.append(time.process_time() - begin)
    print("heyoka: tolerance %g: %.1f us a motion, %d at a time" %
          (tolerance, 1e6 * min(seconds) / (len(starts) // size * size), size))
