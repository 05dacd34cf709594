/* anmech: motions of one system by Taylor's method, several at a time, one in each lane of the processor's registers.

   lanes.lisp writes what stands for the line "the system" below.  A motion goes its own way, with steps of its own:
   what becomes of it is the same to the last bit whatever the others do, and however wide the registers are.  The
   method is that of taylor.lisp, where its parts are told of: order, steps, what is looked at within them.  What that
   would take by stages, or look at more closely, is given up here, and left to it.

   On the standard input stand whole numbers of 64 bits: 1, by which the order of their octets is known; how many
   motions, how many steps at most; the last time, the part of the sizes of states that the error of a step may be, and
   the longest step; then for each motion its states, time and parameters, and the least such errors of each state.  On
   the standard output there is 1, and for each motion whether it has come to its end, and its states there. */

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* As many as the processor's registers hold. */
#if defined __AVX512F__
#define LANES 8
#elif defined __AVX__
#define LANES 4
#else
#define LANES 2
#endif

typedef double numbers __attribute__((vector_size(8 * LANES)));
typedef int64_t choices __attribute__((vector_size(8 * LANES)));

#define FOR_LANES for (int lane = 0; lane < LANES; lane++)

static inline numbers all(double x) {
  numbers y;
  FOR_LANES y[lane] = x;
  return y;
}

static inline numbers chosen(choices which, numbers a, numbers b) {
  return (numbers)((which & (choices)a) | (~which & (choices)b));
}

static inline numbers larger(numbers a, numbers b) { return chosen(a > b, a, b); }
static inline numbers smaller(numbers a, numbers b) { return chosen(a < b, a, b); }
static inline numbers size_of(numbers a) { return (numbers)((choices)a & INT64_MAX); }

static inline int any(choices which) {
  int64_t found = 0;
  FOR_LANES found |= which[lane];
  return found != 0;
}

static inline numbers root(numbers a) {
  numbers y;
  FOR_LANES y[lane] = sqrt(a[lane]);
  return y;
}

/* Functions of the library of C, where they are wanted. */
#define IN_LANES(name, function)                                                                                       \
  static numbers name(numbers x, choices on) {                                                                         \
    numbers y = x;                                                                                                     \
    FOR_LANES if (on[lane]) y[lane] = function(x[lane]);                                                               \
    return y;                                                                                                          \
  }
#define PAIR_IN_LANES(name, function)                                                                                  \
  static inline numbers name(numbers x, numbers y, choices on) {                                                       \
    numbers z = x;                                                                                                     \
    FOR_LANES if (on[lane]) z[lane] = function(x[lane], y[lane]);                                                      \
    return z;                                                                                                          \
  }

static inline double sign_of(double x) { return (double)((x > 0.0) - (x < 0.0)); }

/* A power as the kernel has it: of positive numbers. */
static inline double power(double x, double c) { return x > 0.0 ? pow(x, c) : NAN; }

/* Both by the remainder and the polynomials of fdlibm (Sun Microsystems, 1993): the libraries of C give other last
   digits on other processors.  Of large numbers the remainder would take more parts of pi/2. */
static inline void sine_and_cosine(numbers x, choices on, numbers *sine, numbers *cosine) {
  const numbers shifted = x * 6.36619772367581382433e-01 + 0x1.8p52, turns = shifted - 0x1.8p52;
  const numbers first = x - turns * 1.57079632673412561417e+00, second = first - turns * 6.07710050630396597660e-11;
  const numbers rest = turns * 2.02226624879595063154e-21 - ((first - second) - turns * 6.07710050630396597660e-11);
  const numbers r = second - rest, tail = (second - r) - rest, z = r * r;
  const numbers odd =
      8.33333333332248946124e-03 +
      z * (-1.98412698298579493134e-04 +
           z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)));
  const numbers s = r - ((z * (0.5 * tail - z * r * odd) - tail) - z * r * -1.66666666666666324348e-01);
  const numbers high =
      z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11));
  const numbers even = z * (4.16666666666666019037e-02 +
                            z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + high)));
  const numbers near = 1.0 - 0.5 * z, c = near + (((1.0 - near) - 0.5 * z) + (z * even - r * tail));
  const choices quarter = (choices)shifted, crossed = -(quarter & 1);
  *sine = (numbers)((choices)chosen(crossed, c, s) ^ ((quarter & 2) << 62));
  *cosine = (numbers)((choices)chosen(crossed, s, c) ^ (((quarter + 1) & 2) << 62));
  const choices far = on & ~(size_of(x) < 5e5);
  if (any(far))
    FOR_LANES if (far[lane]) {
      (*sine)[lane] = sin(x[lane]);
      (*cosine)[lane] = cos(x[lane]);
    }
}

/* The logarithm to base 2 of positive numbers, and the power, to three digits: for lengths of steps. */
static inline numbers roughly_log2(numbers x) {
  const choices bits = (choices)x;
  const numbers part = (numbers)((bits & 0xfffffffffffff) | 0x3ff0000000000000), z = (part - 1.5) / (part + 1.5);
  const numbers exponent = (numbers)((bits >> 52 & 0x7ff) | 0x4330000000000000) - (0x1p52 + 1023.0);
  return exponent + 0.5849625007211562 + z * (2.8853900817779268 + z * z * (0.9617966939259756 + z * z * 0.577));
}

static inline numbers roughly_power_of_2(numbers x) {
  const numbers bounded = smaller(larger(x, all(-1000.0)), all(1000.0));
  const numbers shifted = bounded + 0x1.8p52, z = bounded - (shifted - 0x1.8p52);
  const numbers power = (numbers)(((choices)shifted + 1023) << 52);
  return power * (1.0 + z * (0.6931471805599453 + z * (0.2402265069591007 + z * (0.0555041086648216 + z * 0.0096))));
}

/* the system */

#define SIZE (SERIES * ROOM + CONSTANTS + UNKNOWNS * UNKNOWNS + UNKNOWNS * UNKNOWNS + 1)

/* Coefficients from order 0 on of states, time, instructions and unknowns, ROOM each; then constants, and the factors
   of the matrix with the exchanges of its rows. */
typedef struct {
  numbers w[SIZE];
} expansion;

/* Where steps begin; and other places, of which only order 0 is known.  What stands there of lanes that no function was
   taken in is not to be used. */
static expansion here, there;
static numbers slopes[STATES], absolute[STATES]; /* slopes of the polynomials, by the unit of time, there */
static numbers relative, unit, last, limit;

#define COEFFICIENT(e, series, order) ((e)->w[(series) * ROOM + (order)])

/* Of a series, or of the constant -1 - place. */
static inline numbers coefficient(const expansion *e, int place, int order) {
  if (place >= 0)
    return COEFFICIENT(e, place, order);
  return order ? all(0.0) : e->w[SERIES * ROOM - 1 - place];
}

static inline numbers rate(const expansion *e, int i, int order) { return coefficient(e, rates[i], order); }

/* Linear equations: the rows of each lane are exchanged for the largest pivots, in units of what they begin with. */
#if UNKNOWNS
#define FACTORS (SERIES * ROOM + CONSTANTS)
#define EXCHANGES (FACTORS + UNKNOWNS * UNKNOWNS)

static inline void exchange(choices which, numbers *a, numbers *b) {
  const numbers x = *a;
  *a = chosen(which, *b, x);
  *b = chosen(which, x, *b);
}

/* The pivots are inverted; where there are none numbers come out that are none. */
static void factor(expansion *e) {
  numbers(*a)[UNKNOWNS] = (numbers(*)[UNKNOWNS])(e->w + FACTORS);
  numbers *exchanges = e->w + EXCHANGES;
  numbers scales[UNKNOWNS];
  for (int i = 0; i < UNKNOWNS; i++)
    for (int j = 0; j < UNKNOWNS; j++)
      a[i][j] = all(0.0);
  for (int k = 0; k < ENTRIES; k++)
    a[entries[k].row][entries[k].column] = coefficient(e, entries[k].place, 0);
  for (int i = 0; i < UNKNOWNS; i++) {
    scales[i] = all(0.0);
    for (int j = 0; j < UNKNOWNS; j++)
      scales[i] = larger(scales[i], size_of(a[i][j]));
  }
  for (int k = 0; k < UNKNOWNS; k++) {
    for (int i = k + 1; i < UNKNOWNS; i++) {
      const choices better = size_of(a[i][k]) * scales[k] > size_of(a[k][k]) * scales[i];
      exchanges[k * UNKNOWNS + i] = (numbers)better;
      exchange(better, &scales[i], &scales[k]);
      for (int j = 0; j < UNKNOWNS; j++)
        exchange(better, &a[i][j], &a[k][j]);
    }
    const choices singular = ~(size_of(a[k][k]) > 1e-15 * UNKNOWNS * scales[k]);
    a[k][k] = chosen(singular, all(NAN), 1.0 / a[k][k]);
    for (int i = k + 1; i < UNKNOWNS; i++) {
      a[i][k] *= a[k][k];
      for (int j = k + 1; j < UNKNOWNS; j++)
        a[i][j] -= a[i][k] * a[k][j];
    }
  }
}

/* The sum of a[j] u[k - j] from j = 1 to k. */
static inline numbers products(const numbers *a, const numbers *u, int k) {
  numbers odd = all(0.0), even = all(0.0);
  for (int j = 1; j < k; j += 2) {
    odd += a[j] * u[k - j];
    even += a[j + 1] * u[k - j - 1];
  }
  return k % 2 ? odd + a[k] * u[0] + even : odd + even;
}

static void solve(expansion *e, int order) {
  numbers(*a)[UNKNOWNS] = (numbers(*)[UNKNOWNS])(e->w + FACTORS);
  const numbers *exchanges = e->w + EXCHANGES;
  numbers b[UNKNOWNS];
  for (int i = 0; i < UNKNOWNS; i++)
    b[i] = coefficient(e, rights[i], order);
  for (int k = 0; k < ENTRIES; k++)
    if (order && entries[k].place >= 0)
      b[entries[k].row] -= products(&COEFFICIENT(e, entries[k].place, 0),
                                    &COEFFICIENT(e, SERIES - UNKNOWNS + entries[k].column, 0), order);
  for (int k = 0; k < UNKNOWNS; k++)
    for (int i = k + 1; i < UNKNOWNS; i++)
      exchange((choices)exchanges[k * UNKNOWNS + i], &b[i], &b[k]);
  for (int i = 1; i < UNKNOWNS; i++)
    for (int j = 0; j < i; j++)
      b[i] -= a[i][j] * b[j];
  for (int i = UNKNOWNS - 1; i >= 0; i--) {
    for (int j = i + 1; j < UNKNOWNS; j++)
      b[i] -= a[i][j] * b[j];
    b[i] *= a[i][i];
    COEFFICIENT(e, SERIES - UNKNOWNS + i, order) = b[i];
  }
}
#else
static inline void factor(expansion *e) { (void)e; }
static inline void solve(expansion *e, int order) { (void)e, (void)order; }
#endif

/* All of order 0, from states, time and constants. */
static void find_values(expansion *e, choices on) {
  values(e->w, on);
  factor(e);
  solve(e, 0);
}

/* The other orders, too. */
static void find_coefficients(expansion *e) {
  COEFFICIENT(e, STATES, 1) = unit;
  for (int k = 2; k <= ORDER; k++)
    COEFFICIENT(e, STATES, k) = all(0.0);
  for (int k = 0; k < ORDER; k++) {
    const numbers factor = unit / (k + 1.0);
    if (k) {
      coefficients[k](e->w);
      solve(e, k);
    }
    for (int i = 0; i < STATES; i++)
      COEFFICIENT(e, i, k + 1) = factor * rate(e, i, k);
  }
}

/* Values of order 0 become those where the next step begins. */
static void take(choices which) {
  for (int s = 0; s < SERIES; s++)
    COEFFICIENT(&here, s, 0) = chosen(which, COEFFICIENT(&there, s, 0), COEFFICIENT(&here, s, 0));
  for (int c = SERIES * ROOM; c < SIZE; c++)
    here.w[c] = chosen(which, there.w[c], here.w[c]);
}

/* The polynomial of a series, and its slope, at a part of the unit of time. */
static inline numbers polynomial(const numbers *a, numbers part, numbers *slope) {
  numbers value = a[ORDER], derivative = all(0.0);
  for (int k = ORDER - 1; k >= 0; k--) {
    derivative = value + part * derivative;
    value = a[k] + part * value;
  }
  *slope = derivative;
  return value;
}

static inline numbers error_unit(int i, numbers size) {
  return larger(absolute[i] + relative * size, all(1e-290));
}

/* The larger one; what is no number stays. */
static inline numbers worse(numbers a, numbers b) { return chosen((b <= a) | (a != a), a, b); }

static numbers largest_of_order(int k) {
  numbers worst = all(0.0);
  for (int i = 0; i < STATES; i++) {
    const numbers size = size_of(COEFFICIENT(&here, i, k)) / error_unit(i, size_of(COEFFICIENT(&here, i, 0)));
    worst = worse(worst, size);
  }
  return worst;
}

/* The logarithm of the root. */
static inline numbers growth(numbers size, int order) {
  return chosen(size > 1e-290, roughly_log2(size) / (double)order, all(-100.0));
}

/* The longest step; no number where coefficients are none. */
static numbers longest_step(void) {
  const numbers final = largest_of_order(ORDER), before = largest_of_order(ORDER - 1);
  const numbers most = larger(growth(7.4 * final, ORDER), growth(before, ORDER - 1));
  return chosen((final < 1e290) & (before < 1e290), unit * roughly_power_of_2(-most), all(NAN));
}

/* A first step: no longer than ten times what the lower orders let expect of the radius of convergence. */
static numbers first_limit(void) {
  numbers most = all(-100.0);
  for (int k = 1; k <= ORDER; k++)
    most = larger(most, growth(relative * largest_of_order(k), k));
  return 10.0 * unit * roughly_power_of_2(-most);
}

static inline double near_power(double size) {
  int exponent;
  frexp(size, &exponent);
  return ldexp(1.0, exponent < -900 ? -900 : exponent > 900 ? 900 : exponent);
}

/* The unit of time where nothing is known of it: that in which states change by their sizes, or by their errors. */
static double first_unit(int lane, double way) {
  double size = way;
  for (int i = 0; i < STATES; i++) {
    const double slope = fabs(rate(&here, i, 0)[lane]), state = fabs(COEFFICIENT(&here, i, 0)[lane]);
    if (slope > 1e-250 && state > 1e-250 && (slope > 1 || state < 1e50))
      size = fmin(size, fmax(state, absolute[i][lane]) / slope);
  }
  return near_power(size);
}

/* Go to a part of the step h: what the polynomials give becomes the states there. */
static void go(numbers h, numbers part_of_step, choices on) {
  const numbers way = h * part_of_step, part = way / unit;
  for (int i = 0; i < STATES; i++)
    COEFFICIENT(&there, i, 0) = polynomial(&here.w[i * ROOM], part, &slopes[i]);
  COEFFICIENT(&there, STATES, 0) = COEFFICIENT(&here, STATES, 0) + way;
  find_values(&there, on);
}

#define MOST_DEFECT 30.0

/* The largest defect, in units of what is no harm: by how much the rates are not the slopes, and, where they are also
   known at neighbouring numbers, by more than roundings explain. */
static numbers largest_defect(numbers h, const numbers *found, const numbers *others) {
  numbers worst = all(0.0);
  for (int i = 0; i < STATES; i++) {
    const numbers parted = size_of(slopes[i] / unit - found[i]);
    const numbers size = larger(size_of(COEFFICIENT(&here, i, 0)), size_of(COEFFICIENT(&there, i, 0)));
    numbers error = parted * size_of(h) / (MOST_DEFECT * error_unit(i, size));
    if (others) {
      const numbers rounding = size_of(others[i] - found[i]);
      error = chosen((parted < 100.0 * rounding) & (rounding < INFINITY), all(0.0), error);
    }
    worst = worse(worst, error);
  }
  return worst;
}

static void find_rates(numbers *found) {
  for (int i = 0; i < STATES; i++)
    found[i] = rate(&there, i, 0);
}

static choices rejections; /* how often the step has been tried in vain */

/* What the polynomials do not follow of the equations there.  A large defect may be due to rounding, if that of a
   shorter step is large, too: what the equations give at states and times that are changed by some units in the last
   place tells. */
static numbers defect(numbers h, choices which) {
  numbers found[STATES], others[STATES], before[STATES + 1];
  find_rates(found);
  const numbers error = largest_defect(h, found, NULL);
  const choices large = which & ~(error <= 1.0) & (rejections > 0);
  if (!any(large))
    return error;
  for (int i = 0; i <= STATES; i++) {
    before[i] = COEFFICIENT(&there, i, 0);
    COEFFICIENT(&there, i, 0) = before[i] * (i % 2 ? 1.0 - 8.9e-16 : 1.0 + 8.9e-16);
  }
  find_values(&there, which);
  find_rates(others);
  for (int i = 0; i <= STATES; i++)
    COEFFICIENT(&there, i, 0) = before[i];
  find_values(&there, which);
  return chosen(large, largest_defect(h, found, others), error);
}

/* Whether all values there are finite. */
static choices all_finite(void) {
  numbers sum = all(0.0);
  for (int s = 0; s < SERIES; s++)
    sum += COEFFICIENT(&there, s, 0) - COEFFICIENT(&there, s, 0);
  return sum == 0.0;
}

/* The same at places within steps that are much longer than the last. */
static numbers defect_within(numbers h, choices on) {
  static const double places[] = {0.83, 0.61, 0.37, 0.19};
  numbers worst = all(0.0);
  for (int k = 0; k < 4; k++) {
    go(h, all(places[k]), on);
    worst = worse(worst, defect(h, on));
  }
  return chosen(on, worst, all(0.0));
}

/* The same where what an exponential is taken of, for example, is largest or least within the step, or vanishes: there
   a bump may be, or a step, of which nothing is to be seen where it begins. */
#define PARTS_OF_STEP 8

static numbers defect_at(numbers h, numbers where, choices which) {
  which &= (where > 0.0) & (where < PARTS_OF_STEP);
  if (!any(which))
    return all(0.0);
  go(h, chosen(which, where / PARTS_OF_STEP, all(1.0)), which);
  return chosen(which, defect(h, which), all(0.0));
}

/* Where the argument turns near a place, by parabolas through nearer and nearer values; BEND becomes that there. */
static numbers turn(const numbers *argument, numbers part, numbers where, numbers *bend) {
  numbers slope;
  for (double apart = 0.25; apart > 0.003; apart /= 8) {
    const numbers a = polynomial(argument, part * (where - apart), &slope);
    const numbers b = polynomial(argument, part * where, &slope);
    const numbers c = polynomial(argument, part * (where + apart), &slope);
    const numbers second = (c - b) - (b - a), move = -0.5 * apart * (c - a) / second;
    where = chosen(size_of(move) < 1.0, where + move, where);
    *bend = second / (apart * apart);
  }
  return where;
}

/* Where it vanishes near a place. */
static numbers zero(const numbers *argument, numbers part, numbers where) {
  numbers slope;
  for (int k = 0; k < 3; k++) {
    const numbers value = polynomial(argument, part * where, &slope), move = -value / (slope * part);
    where = chosen(size_of(move) < 1.0, where + move, where);
  }
  return where;
}

static numbers defect_where_steep(int series, numbers h, choices on) {
  const numbers *argument = &here.w[series * ROOM];
  const numbers part = h / (PARTS_OF_STEP * unit);
  numbers slope, a, b = polynomial(argument, -part, &slope), c = argument[0], worst = all(0.0);
  for (int k = 0; k <= PARTS_OF_STEP; k++) {
    a = b, b = c, c = polynomial(argument, part * (k + 1.0), &slope);
    const numbers before = b - a, step = c - b, bend = step - before, size = size_of(bend);
    const choices known = on & (size < 1e290);
    const choices rose = before > 0.0, turned = (rose & (step <= 0.0)) | (~rose & (step >= 0.0));
    const choices turns = known & turned & (size > 1.0);
    if (any(turns)) {
      numbers bend_there = bend;
      const numbers where = turn(argument, part, k - 0.5 * (before + step) / bend, &bend_there);
      worst = worse(worst, defect_at(h, where, turns));
      /* what changes its sign where the bump is highest */
      worst = worse(worst, defect_at(h, where + 1.0 / root(size_of(bend_there)), turns));
    }
    const choices vanishes = known & (((b < 0.0) & (c > 0.0)) | (~(b < 0.0) & (c < 0.0))) & (size_of(step) > 2.0);
    if (any(vanishes))
      worst = worse(worst, defect_at(h, zero(argument, part, k + b / (b - c)), vanishes));
  }
  return worst;
}

/* Where roots are taken: they vanish within the step, or are no numbers. */
static choices root_vanishes(numbers h) {
  choices found = {0};
  numbers slope;
  for (int k = 0; k < ROOTS; k++)
    found |= ~(polynomial(&here.w[roots[k] * ROOM], h / unit, &slope) > 0.0);
  return found;
}

/* Input and output */

static int64_t *input, *output;

/* A number: the mantissa; and OFFSET more than the power of 2, times two, and one more if it is negative. */
#define OFFSET 2048

static double next_number(void) {
  const double mantissa = (double)*input++;
  const int64_t rest = *input++;
  return ldexp(rest & 1 ? -mantissa : mantissa, (int)(rest >> 1) - OFFSET);
}

static void put_number(int64_t **place, double x) {
  int exponent;
  const double mantissa = frexp(fabs(x), &exponent);
  *(*place)++ = (int64_t)ldexp(mantissa, 53);
  *(*place)++ = 2 * (exponent - 53 + OFFSET) + (x < 0.0);
}

static size_t length_of_input;
static int foreign_order; /* of octets */

static void reverse_octets(int64_t *numbers, size_t length) {
  for (size_t i = 0; i < length; i++)
    numbers[i] = (int64_t)__builtin_bswap64((uint64_t)numbers[i]);
}

static int64_t *read_all(void) {
  size_t room = 1 << 16, length = 0, got;
  char *data = malloc(room);
  while (data && (got = fread(data + length, 1, room - length, stdin)) > 0)
    if ((length += got) == room)
      data = realloc(data, room *= 2);
  length_of_input = length / sizeof(int64_t);
  return (int64_t *)data;
}

/* The motions in hand */

#define MOST_REJECTIONS 12

static int64_t count, next_row, most_steps, row[LANES], steps[LANES];
static double end, part, longest;
static choices on; /* lanes in which there is a motion */

#define SIZE_OF_RESULT (1 + 2 * STATES)

/* Whether the numbers of the next motion are such that there are constants. */
static int begin_motion(int lane) {
  double in[INPUTS], c[CONSTANTS + 1];
  for (int i = 0; i < INPUTS; i++)
    in[i] = next_number();
  for (int i = 0; i <= STATES; i++)
    COEFFICIENT(&there, i, 0)[lane] = in[i];
  const int begun = constants(in, c);
  for (int i = 0; i < CONSTANTS; i++)
    there.w[SERIES * ROOM + i][lane] = c[i];
  for (int i = 0; i < STATES; i++)
    absolute[i][lane] = next_number();
  row[lane] = next_row++;
  last[lane] = steps[lane] = rejections[lane] = 0;
  return begun;
}

static void end_motion(int lane, int lost) {
  int64_t *place = output + 1 + row[lane] * SIZE_OF_RESULT;
  for (int i = 0; i < STATES; i++)
    lost |= fpclassify(COEFFICIENT(&here, i, 0)[lane]) == FP_SUBNORMAL;
  *place++ = !lost;
  for (int i = 0; i < STATES && !lost; i++)
    put_number(&place, COEFFICIENT(&here, i, 0)[lane]);
  on[lane] = 0;
}

/* New motions in lanes that are free. */
static void fill_lanes(void) {
  choices fresh = {0};
  FOR_LANES while (!on[lane] && next_row < count) fresh[lane] = on[lane] = -begin_motion(lane);
  if (!any(fresh))
    return;
  find_values(&there, fresh);
  take(fresh);
  FOR_LANES if (fresh[lane]) {
    unit[lane] = first_unit(lane, fabs(end - COEFFICIENT(&here, STATES, 0)[lane]));
    limit[lane] = NAN;
  }
}

/* The step to be tried, as far as it goes; whether it leads to the end, and where there is none. */
static numbers chosen_step(choices *at_end, choices *lost) {
  const numbers now = COEFFICIENT(&here, STATES, 0), left = end - now;
  const choices fresh = limit != limit;
  if (any(fresh))
    limit = chosen(fresh, first_limit(), limit);
  numbers h = longest_step();
  *lost = ~(h > 0.0);
  h = smaller(smaller(h, limit), all(longest));
  *lost |= ~(h > size_of(now) * 2.3e-15);
  h = smaller(h, size_of(left));
  *at_end = size_of(left) <= 1.01 * h;
  return chosen(*at_end, left, (now + chosen(left < 0.0, -h, h)) - now);
}

/* What the polynomials do not follow of the equations, all in all; the values at the end of the step are there then. */
static numbers whole_defect(numbers h) {
  const choices longer = on & (size_of(h) > 1.5 * last);
  numbers worst = any(longer) ? defect_within(h, longer) : all(0.0);
  for (int k = 0; k < STEEP; k++)
    worst = worse(worst, defect_where_steep(steep[k], h, on));
  go(h, all(1.0), on);
  return worse(worst, defect(h, on));
}

/* Sizes of states that have grown; whether they are numbers. */
static choices raise_sizes(void) {
  numbers sum = all(0.0);
  for (int i = 0; i < STATES; i++) {
    const numbers size = size_of(COEFFICIENT(&here, i, 0));
    absolute[i] = larger(absolute[i], part * size);
    sum += size;
  }
  return sum < 1e150;
}

static void step(void) {
  choices at_end, lost;
  find_coefficients(&here);
  const numbers h = chosen_step(&at_end, &lost);
  const choices good = on & (whole_defect(h) <= 1.0) & all_finite();
  COEFFICIENT(&there, STATES, 0) = chosen(at_end, all(end), COEFFICIENT(&there, STATES, 0));
  lost |= root_vanishes(h);
  limit = chosen(good, 6.0 * size_of(h), 0.4 * size_of(h));
  last = chosen(good, size_of(h), last);
  take(good);
  lost |= ~raise_sizes();
  FOR_LANES if (on[lane]) {
    const double ratio = last[lane] / unit[lane];
    if (good[lane] && !(ratio > 1e-3 && ratio < 1e3))
      unit[lane] = near_power(last[lane]);
    rejections[lane] = good[lane] ? 0 : rejections[lane] + 1;
    if (lost[lane] || rejections[lane] > MOST_REJECTIONS || ++steps[lane] > most_steps)
      end_motion(lane, 1);
    else if (COEFFICIENT(&here, STATES, 0)[lane] == end)
      end_motion(lane, 0);
  }
}

int main(void) {
  if (!(input = read_all()) || length_of_input < 9)
    return 1;
  if ((foreign_order = *input != 1))
    reverse_octets(input, length_of_input);
  input++, count = *input++, most_steps = *input++;
  if (length_of_input != 9 + (size_t)count * 2 * (INPUTS + STATES))
    return 1; /* it was cut short */
  end = next_number(), part = next_number(), longest = next_number();
  relative = all(0.1 * part);
  if (!(output = calloc(1 + count * SIZE_OF_RESULT, sizeof *output)))
    return 1;
  for (fill_lanes(); any(on); fill_lanes())
    step();
  const size_t length = 1 + count * SIZE_OF_RESULT;
  output[0] = 1;
  if (foreign_order)
    reverse_octets(output, length);
  return fwrite(output, sizeof *output, length, stdout) == length && fflush(stdout) == 0 ? 0 : 1;
}
