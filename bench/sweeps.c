/* The motions of bench/sweeps.mac in C: the same method (DOP853), controller and tolerances, and equations written by
   hand. sweeps N T TOLERANCE: N x N double pendulums from rest until the time T; prints CPU seconds, evaluations, and
   the sum of the first angles; sweeps N T TOLERANCE table prints the ends of all. */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#define M 8

typedef void (*field)(const double *, double *);
static long ev, acc, rej;

static int dop(field f, int n, const double *y0, double t0, double t1, double rel, double ab, double *out) {
  static double K[17][M], y[M], z[M], w[M];
  double t = t0, h, perr = 1e-4, err, dir = t1 < t0 ? -1 : 1, hmax = fabs(t1 - t0);
  int after = 0;
  ev = acc = rej = 0;
  for (int i = 0; i < n; i++)
    y[i] = y0[i];
#define k1 K[0]
#define k2 K[1]
#define k3 K[2]
#define k4 K[3]
#define k5 K[4]
#define k6 K[5]
#define k7 K[6]
#define k8 K[7]
#define k9 K[8]
#define k10 K[9]
#define k11 K[10]
#define k12 K[11]
#define k13 K[12]
#define k14 K[13]
#define k15 K[14]
#define k16 K[15]
#define ST(T, e)                                                                                                     \
  for (int i = 0; i < n; i++)                                                                                        \
    w[i] = y[i] + h * (e);                                                                                           \
  f(w, T);                                                                                                           \
  ev++;
  f(y, k1);
  ev++;
  {
    double a = 0, b = 0;
    for (int i = 0; i < n; i++) {
      double u = ab + rel * fabs(y[i]);
      a += y[i] * y[i] / u / u;
      b += k1[i] * k1[i] / u / u;
    }
    a = sqrt(a / n);
    b = sqrt(b / n);
    double tr = (a < 1e-10 || b < 1e-10) ? 1e-6 : 0.01 * a / b;
    if (tr > hmax)
      tr = hmax;
    h = tr * dir;
    ST(k2, k1[i]);
    double c = 0;
    for (int i = 0; i < n; i++) {
      double u = ab + rel * fabs(y[i]);
      double d = (k2[i] - k1[i]) / u;
      c += d * d;
    }
    c = sqrt(c / n) / tr;
    double L = b > c ? b : c, g = L <= 1e-15 ? fmax(1e-6, tr * 1e-3) : pow(0.01 / L, 0.125);
    double s = fmin(100 * tr, g);
    h = dir * fmin(hmax, s);
  }
  for (;;) {
    double left = t1 - t;
    if (left == 0)
      return 0;
    int last = 0;
    if (fabs(left) <= 1.01 * fabs(h)) {
      h = left;
      last = 1;
    } else if (fabs(h) <= 2.3e-15 * fabs(t) || fabs(h) < 1e-300)
      return 1;
    else {
      volatile double q = t + h;
      h = q - t;
    }
    ST(k2, 0.05260015195876773 * k1[i])
    ST(k3, 0.0197250569845379 * k1[i] + 0.0591751709536137 * k2[i])
    ST(k4, 0.02958758547680685 * k1[i] + 0.08876275643042054 * k3[i])
    ST(k5, 0.2413651341592667 * k1[i] - 0.8845494793282861 * k3[i] + 0.924834003261792 * k4[i])
    ST(k6, 0.037037037037037035 * k1[i] + 0.17082860872947386 * k4[i] + 0.12546768756682242 * k5[i])
    ST(k7, 0.037109375 * k1[i] + 0.17025221101954405 * k4[i] + 0.06021653898045596 * k5[i] - 0.017578125 * k6[i])
    ST(k8, 0.03709200011850479 * k1[i] + 0.17038392571223998 * k4[i] + 0.10726203044637328 * k5[i] -
               0.015319437748624402 * k6[i] + 0.008273789163814023 * k7[i])
    ST(k9, 0.6241109587160757 * k1[i] - 3.3608926294469414 * k4[i] - 0.868219346841726 * k5[i] +
               27.59209969944671 * k6[i] + 20.154067550477894 * k7[i] - 43.48988418106996 * k8[i])
    ST(k10, 0.47766253643826434 * k1[i] - 2.4881146199716677 * k4[i] - 0.590290826836843 * k5[i] +
                21.230051448181193 * k6[i] + 15.279233632882423 * k7[i] - 33.28821096898486 * k8[i] -
                0.020331201708508627 * k9[i])
    ST(k11, -0.9371424300859873 * k1[i] + 5.186372428844064 * k4[i] + 1.0914373489967295 * k5[i] -
                8.149787010746927 * k6[i] - 18.52006565999696 * k7[i] + 22.739487099350505 * k8[i] +
                2.4936055526796523 * k9[i] - 3.0467644718982196 * k10[i])
    ST(k12, 2.273310147516538 * k1[i] - 10.53449546673725 * k4[i] - 2.0008720582248625 * k5[i] -
                17.9589318631188 * k6[i] + 27.94888452941996 * k7[i] - 2.8589982771350235 * k8[i] -
                8.87285693353063 * k9[i] + 12.360567175794303 * k10[i] + 0.6433927460157636 * k11[i])
    double th = 0, fi = 0;
    for (int i = 0; i < n; i++) {
      double s = 0.054293734116568765 * k1[i] + 4.450312892752409 * k6[i] + 1.8915178993145003 * k7[i] -
                 5.801203960010585 * k8[i] + 0.3111643669578199 * k9[i] - 0.1521609496625161 * k10[i] +
                 0.20136540080403034 * k11[i] + 0.04471061572777259 * k12[i];
      double v = y[i] + h * s, u = ab + rel * fmax(fabs(y[i]), fabs(v));
      double e3 = (s - (0.244094488188976377952755905512 * k1[i] + 0.733846688281611857341361741547 * k9[i] +
                        0.0220588235294117647058823529412 * k12[i])) /
                  u;
      double e5 = (0.01312004499419488 * k1[i] - 1.2251564463762044 * k6[i] - 0.4957589496572502 * k7[i] +
                   1.6643771824549864 * k8[i] - 0.35032884874997366 * k9[i] + 0.3341791187130175 * k10[i] +
                   0.08192320648511571 * k11[i] - 0.022355307863886294 * k12[i]) /
                  u;
      z[i] = v;
      th += e3 * e3;
      fi += e5 * e5;
    }
    double both = fi + 0.01 * th;
    err = both > 0 ? fabs(h) * fi / sqrt(both * n) : both * 0;
    if (err <= 1) {
      f(z, k13);
      ev++;
      t += h;
      acc++;
      memcpy(y, z, n * 8);
      memcpy(k1, k13, n * 8);
      if (last)
        t = t1;
      double e = fmax(err, 1e-4), g = 0.9 * pow(perr, 0.04) / pow(e, 0.125 - 0.008), lim = after ? 1 : 6;
      h = dir * fmin(fabs(h) * fmin(lim, fmax(g, 0.333)), hmax);
      perr = e;
      after = 0;
    } else {
      rej++;
      after = 1;
      if (err < 1e200)
        h *= fmax(0.333, 0.9 / pow(err, 0.125 - 0.008));
      else
        h *= 0.25;
    }
    if (t == t1 || acc > 10000000) {
      memcpy(out, y, n * 8);
      return 0;
    }
  }
}
/* Two points of mass 1 on rods of length 1: angles and rates. */
static void pendulum(const double *y, double *rates) {
  const double g = 9.81, a = y[0], b = y[1], u = y[2], v = y[3];
  double c = cos(a - b), s = sin(a - b), det = 2 - c * c;
  double p = -v * v * s - 2 * g * sin(a), q = u * u * s - g * sin(b);
  rates[0] = u;
  rates[1] = v;
  rates[2] = (p - c * q) / det;
  rates[3] = (2 * q - c * p) / det;
}

int main(int count, char **arguments) {
  int n = atoi(arguments[1]);
  double end = atof(arguments[2]), tolerance = atof(arguments[3]), sum = 0, pi = 3.141592653589793;
  long evaluations = 0;
  clock_t start = clock();
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++) {
      double last[M], first[4] = {-pi + 2 * pi * i / (n - 1), -pi + 2 * pi * j / (n - 1), 0, 0};
      dop(pendulum, 4, first, 0, end, tolerance, tolerance, last);
      evaluations += ev;
      sum += last[0];
      if (count > 4)
        printf("%.17g,%.17g,%.17g,%.17g\n", last[0], last[1], last[2], last[3]);
    }
  if (count <= 4)
    printf("%.3f %ld %.15g\n", (double)(clock() - start) / CLOCKS_PER_SEC, evaluations, sum);
  return 0;
}
