/* The measurement of rhs_c.lisp, of the same code in C: see rhs_c.sh.  The solver is that of src/linear.lisp. */
#include <math.h>
#include <stdio.h>
#include <time.h>
#include "generated.c"

static int solve(int n, double *a, double *b)
{
  double row[16];
  for (int i = 0; i < n; i++) {
    double largest = 0;
    for (int j = 0; j < n; j++) largest = fmax(largest, fabs(a[i * n + j]));
    if (!(largest > 0 && largest < 1e300)) return 0;
    row[i] = 1 / largest;
  }
  for (int k = 0; k < n; k++) {
    int best = k;
    double size = 0, above = 0;
    for (int i = k; i < n; i++)
      if (row[i] * fabs(a[i * n + k]) > size) size = row[i] * fabs(a[i * n + k]), best = i;
    for (int i = 0; i < k; i++) above = fmax(above, row[i] * fabs(a[i * n + k]));
    if (!(size > n * 1e-15 * above)) return 0;
    if (best != k) {
      double t;
      for (int j = 0; j < n; j++) t = a[k * n + j], a[k * n + j] = a[best * n + j], a[best * n + j] = t;
      t = b[k], b[k] = b[best], b[best] = t;
      t = row[k], row[k] = row[best], row[best] = t;
    }
    double inverse = 1 / a[k * n + k];
    a[k * n + k] = inverse;
    for (int i = k + 1; i < n; i++) {
      double factor = inverse * a[i * n + k];
      for (int j = k + 1; j < n; j++) a[i * n + j] -= factor * a[k * n + j];
      b[i] -= factor * b[k];
    }
  }
  for (int i = n - 1; i >= 0; i--) {
    for (int j = i + 1; j < n; j++) b[i] -= a[i * n + j] * b[j];
    b[i] *= a[i * n + i];
  }
  return 1;
}

static void pendulum_mass_matrix_field(const double *restrict in, double *restrict out)
{
  double work[6];
  pendulum_mass_matrix(in, work);
  if (!solve(2, work, work + 4)) return;
  out[0] = in[2], out[1] = in[3], out[2] = work[4], out[3] = work[5];
}

static double in[32], out[32];

static double seconds(void (*volatile field)(const double *, double *), long count)
{
  clock_t start = clock();
  for (long k = 0; k < count; k++) field(in, out);
  return (double)(clock() - start) / CLOCKS_PER_SEC;
}

static void measure(const char *name, void (*field)(const double *, double *))
{
  long count = 1000;
  double least = 1e9;
  for (int k = 0; k < 32; k++) in[k] = 1 + (k + 1) / 32.;
  while (seconds(field, count) < 0.2) count *= 2;
  for (int k = 0; k < 10; k++) least = fmin(least, seconds(field, count));
  printf("rhs %s %.3f\n", name, 1e9 * least / count);
}

int main(void)
{
  measure("pendulum_mass_matrix", pendulum_mass_matrix_field);
  measure("pendulum_explicit", pendulum_explicit);
  measure("three_bodies", three_bodies);
  return 0;
}
