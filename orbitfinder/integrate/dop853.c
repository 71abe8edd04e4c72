/* DOP853 of Hairer, Norsett and Wanner (Solving Ordinary Differential Equations I, section II.10, and their dop853.f)
   of y' = f(t, y u) / u for a field f(t, x, free) in CasADi's own C, which stands above as FIELD: u are units.

   A and B are the method's coefficients, WITHIN its moments, THIRD and FIFTH those of its errors. Operations are in the
   order of dop853.f, so that steps are those of SciPy, to the last bit where its own code is not contracted. REFUSED is
   fmin in dop853.f and in SciPy before 1.17, then most_cut: a refused step is cut to 0.3 of it, whatever its error; steps
   shorter than ROUND_OFF are the shortest. */
#include <stdint.h>
#include <stddef.h>
#include <stdlib.h>

#define ORDER 8
#define SAFETY 0.9
#define LEAST_FACTOR 0.3
#define MOST_FACTOR 6.0
#define STABLE 6.1
#define LOOKED_AT 1000

enum { DONE = 1, WAITING = 0, TOO_MANY = -2, TOO_SHORT = -3, STIFF = -4, NO_MEMORY = -5 };

/* Where an integration stands between two calls; `units`, `freed`, y and k (12 rows) belong to the caller. One that is
   `patient` goes on at the limit of stability, where dop853.f gives up. */
typedef struct {
  ptrdiff_t size, left, accepted;
  const double *units, *freed;
  double *y, *k, t, end, h, longest, relative, absolute;
  ptrdiff_t begun, rejected, stiff, calm, patient;
} Standing;

typedef struct {
  const double **arg;
  double **res, *w, *x, time;
  casadi_int *iw;
  ptrdiff_t size;
  const double *units, *freed;
} Call;

static int prepared(Call *call, ptrdiff_t size, const double *units, const double *freed) {
  casadi_int arg, res, iw, w;
  FIELD_work(&arg, &res, &iw, &w);
  size_t bytes = arg * sizeof(double *) + res * sizeof(double *) + iw * sizeof(casadi_int) + (w + size) * sizeof(double);
  char *memory = malloc(bytes + 64);
  if (!memory) return 1;
  call->arg = (const double **)memory;
  call->res = (double **)(call->arg + arg);
  call->iw = (casadi_int *)(call->res + res);
  call->w = (double *)(call->iw + iw);
  call->x = call->w + w;
  call->size = size, call->units = units, call->freed = freed;
  return 0;
}

/* rate = f(t, y u) / u; not a number where f says that it failed. */
static void rates_at(Call *call, double t, const double *y, double *rate) {
  for (ptrdiff_t i = 0; i < call->size; i++) call->x[i] = call->units ? y[i] * call->units[i] : y[i];
  call->time = t;
  call->arg[0] = &call->time, call->arg[1] = call->x;
  if (FREED) call->arg[2] = call->freed;
  call->res[0] = rate;
  if (FIELD(call->arg, call->res, call->iw, call->w, 0)) for (ptrdiff_t i = 0; i < call->size; i++) rate[i] = NAN;
  else if (call->units) for (ptrdiff_t i = 0; i < call->size; i++) rate[i] /= call->units[i];
}

/* Rates (count x size) at times (count) and states (count x size). Returns whether there was no memory for it. */
int rates(ptrdiff_t count, ptrdiff_t size, const double *times, const double *states, const double *units,
          const double *freed, double *found) {
  Call call;
  if (prepared(&call, size, units, freed)) return 1;
  for (ptrdiff_t k = 0; k < count; k++) rates_at(&call, times[k], states + k * size, found + k * size);
  free(call.arg);
  return 0;
}

#define most_cut(most, asked) (most)
#define EACH for (ptrdiff_t i = 0; i < n; i++)
#define STAGE(TO, SHARE, CHANGE) { EACH v[i] = y[i] + h * CHANGE; rates_at(call, t + SHARE * h, v, TO); }
#define ROWS double *k1 = k, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *k5 = k4 + n, *k6 = k5 + n, *k7 = k6 + n, \
  *k8 = k7 + n, *k9 = k8 + n, *k10 = k9 + n
#define SLOPE (B[0] * k1[i] + B[5] * k6[i] + B[6] * k7[i] + B[7] * k8[i] + B[8] * k9[i] + B[9] * k10[i] \
    + B[10] * k2[i] + B[11] * k3[i])

/* The other eleven stages of a step of length h from y with the first in k (10 rows), the last two in rows 2 and 3. */
static void staged(Call *call, double t, double h, const double *y, double *k, double *v) {
  const ptrdiff_t n = call->size;
  ROWS;
  STAGE(k2, WITHIN[1], A[1][0] * k1[i])
  STAGE(k3, WITHIN[2], (A[2][0] * k1[i] + A[2][1] * k2[i]))
  STAGE(k4, WITHIN[3], (A[3][0] * k1[i] + A[3][2] * k3[i]))
  STAGE(k5, WITHIN[4], (A[4][0] * k1[i] + A[4][2] * k3[i] + A[4][3] * k4[i]))
  STAGE(k6, WITHIN[5], (A[5][0] * k1[i] + A[5][3] * k4[i] + A[5][4] * k5[i]))
  STAGE(k7, WITHIN[6], (A[6][0] * k1[i] + A[6][3] * k4[i] + A[6][4] * k5[i] + A[6][5] * k6[i]))
  STAGE(k8, WITHIN[7], (A[7][0] * k1[i] + A[7][3] * k4[i] + A[7][4] * k5[i] + A[7][5] * k6[i] + A[7][6] * k7[i]))
  STAGE(k9, WITHIN[8], (A[8][0] * k1[i] + A[8][3] * k4[i] + A[8][4] * k5[i] + A[8][5] * k6[i] + A[8][6] * k7[i]
        + A[8][7] * k8[i]))
  STAGE(k10, WITHIN[9], (A[9][0] * k1[i] + A[9][3] * k4[i] + A[9][4] * k5[i] + A[9][5] * k6[i] + A[9][6] * k7[i]
        + A[9][7] * k8[i] + A[9][8] * k9[i]))
  STAGE(k2, WITHIN[10], (A[10][0] * k1[i] + A[10][3] * k4[i] + A[10][4] * k5[i] + A[10][5] * k6[i] + A[10][6] * k7[i]
        + A[10][7] * k8[i] + A[10][8] * k9[i] + A[10][9] * k10[i]))
  STAGE(k3, WITHIN[11], (A[11][0] * k1[i] + A[11][3] * k4[i] + A[11][4] * k5[i] + A[11][5] * k6[i] + A[11][6] * k7[i]
        + A[11][7] * k8[i] + A[11][8] * k9[i] + A[11][9] * k10[i] + A[11][10] * k2[i]))
}

/* The first step's length, by dop853.f's hinit. */
static double first_length(Call *call, const Standing *at, double *next, double *v) {
  const ptrdiff_t n = at->size;
  double moved = 0.0, placed = 0.0, bent = 0.0;
  EACH {
    double scale = at->absolute + at->relative * fabs(at->y[i]), rate = at->k[i] / scale, place = at->y[i] / scale;
    moved += rate * rate, placed += place * place;
  }
  double h = moved <= 1e-10 || placed <= 1e-10 ? 1e-6 : sqrt(placed / moved) * 0.01;
  h = fmin(h, at->longest);
  EACH v[i] = at->y[i] + h * at->k[i];
  rates_at(call, at->t + h, v, next);
  EACH {
    double change = (next[i] - at->k[i]) / (at->absolute + at->relative * fabs(at->y[i]));
    bent += change * change;
  }
  double most = fmax(fabs(sqrt(bent) / h), sqrt(moved));
  double other = most <= 1e-15 ? fmax(1e-6, fabs(h) * 1e-3) : pow(0.01 / most, 1.0 / ORDER);
  return fmin(fmin(100.0 * fabs(h), other), at->longest);
}

/* Go on to the end or until `room` more steps are accepted, whose ends are noted where there are `moments`. */
int dop853(Standing *at, ptrdiff_t room, double *moments, double *states) {
  const ptrdiff_t n = at->size;
  Call call;
  double *v = malloc(2 * n * sizeof(double) + 64), *next = v + n, *y = at->y;
  if (!v || prepared(&call, n, at->units, at->freed)) { free(v); return NO_MEMORY; }
  double *k = at->k;
  ROWS;
  int code = WAITING;
  if (!at->begun) {
    rates_at(&call, at->t, y, k1);
    at->h = first_length(&call, at, k3, v);
    at->begun = 1;
  }
  for (ptrdiff_t noted = 0; noted < room && code == WAITING;) {
    double t = at->t, h = at->h;
    int last = 0;
    if (at->left-- < 0) { code = TOO_MANY; break; }
    if (0.1 * fabs(h) <= fabs(t) * ROUND_OFF) { code = TOO_SHORT; break; }
    if (t + 1.01 * h - at->end > 0.0) h = at->end - t, last = 1;
    staged(&call, t, h, y, at->k, v);
    double fifth = 0.0, third = 0.0;
    EACH {
      double slope = SLOPE;
      next[i] = y[i] + h * slope;
      double scale = at->absolute + at->relative * fmax(fabs(y[i]), fabs(next[i]));
      double of_third = slope - THIRD[0] * k1[i] - THIRD[1] * k9[i] - THIRD[2] * k3[i];
      double of_fifth = FIFTH[0] * k1[i] + FIFTH[5] * k6[i] + FIFTH[6] * k7[i] + FIFTH[7] * k8[i] + FIFTH[8] * k9[i]
        + FIFTH[9] * k10[i] + FIFTH[10] * k2[i] + FIFTH[11] * k3[i];
      third += (of_third / scale) * (of_third / scale), fifth += (of_fifth / scale) * (of_fifth / scale);
    }
    double both = fifth + 0.01 * third;
    if (both <= 0.0) both = 1.0;
    double error = fabs(h) * fifth * sqrt(1.0 / (n * both)), shrink = pow(error, 1.0 / ORDER);
    double factor = fmax(1.0 / MOST_FACTOR, fmin(1.0 / LEAST_FACTOR, shrink / SAFETY)), length = h / factor;
    if (!(error <= 1.0)) {
      at->h = h / REFUSED(1.0 / LEAST_FACTOR, shrink / SAFETY), at->rejected = 1;
      continue;
    }
    at->accepted++;
    rates_at(&call, t + h, next, k4);
    if (!at->patient && (at->accepted % LOOKED_AT == 0 || at->stiff > 0)) {
      double change = 0.0, apart = 0.0, steep = 0.0;
      EACH change += (k4[i] - k3[i]) * (k4[i] - k3[i]), apart += (next[i] - v[i]) * (next[i] - v[i]);
      if (apart > 0.0) steep = fabs(h) * sqrt(change / apart);
      if (steep > STABLE) {
        at->calm = 0;
        if (++at->stiff == 15) code = STIFF;
      } else if (++at->calm == 6) at->stiff = 0;
      if (code == STIFF) break;
    }
    EACH k1[i] = k4[i], y[i] = next[i];
    at->t = t + h;
    if (moments) {
      moments[noted] = at->t;
      EACH states[noted * n + i] = y[i];
    }
    noted++;
    if (last) { at->h = length, code = DONE; break; }
    if (fabs(length) > at->longest) length = at->longest;
    if (at->rejected) length = fmin(fabs(length), fabs(h));
    at->rejected = 0, at->h = length;
  }
  free(call.arg);
  free(v);
  return code;
}

/* Where a step leads from each state (count x size) at its time by its span. Returns as `rates` does. */
int stepped(ptrdiff_t count, ptrdiff_t n, const double *times, const double *states, const double *spans,
            const double *units, const double *freed, double *ends) {
  Call call;
  double *k = malloc(11 * n * sizeof(double) + 64), *v = k + 10 * n;
  if (!k || prepared(&call, n, units, freed)) { free(k); return 1; }
  ROWS;
  for (ptrdiff_t m = 0; m < count; m++) {
    const double *y = states + m * n, h = spans[m];
    rates_at(&call, times[m], y, k1);
    staged(&call, times[m], h, y, k, v);
    EACH ends[m * n + i] = y[i] + h * SLOPE;
  }
  free(call.arg);
  free(k);
  return 0;
}

#define BESIDE 8 /* moments whose polynomials are evaluated together */

/* How far rates at increasing `moments` (count), each within a `step`, are off the slope there of the polynomial of degree
   seven through values and slopes (known x n) at the four times about it. Returns as `rates` does. */
int strayed(ptrdiff_t count, ptrdiff_t known, ptrdiff_t n, const double *times, const double *values,
            const double *slopes, const ptrdiff_t *step, const double *moments, const double *units, const double *freed,
            double *off) {
  Call call;
  double z[8], *c = malloc(n * (9 + 2 * BESIDE) * sizeof(double) + 64), *value = c + 8 * n, *slope = value + n * BESIDE;
  double *rate = slope + n * BESIDE;
  if (!c || prepared(&call, n, units, freed)) { free(c); return 1; }
  for (ptrdiff_t m = 0, some; m < count; m += some) {
    if (!m || step[m] != step[m - 1]) {
      ptrdiff_t first = step[m] - 1 > known - 4 ? known - 4 : step[m] - 1;
      if (first < 0) first = 0;
      for (int j = 0; j < 8; j++) {
        z[j] = times[first + j / 2];
        EACH c[j * n + i] = values[(first + j / 2) * n + i];
      }
      for (int order = 1; order < 8; order++) for (int j = 7; j >= order; j--) {
        double gap = z[j] - z[j - order];
        EACH c[j * n + i] = gap > 0.0 ? (c[j * n + i] - c[(j - 1) * n + i]) / gap
          : order == 1 ? slopes[(first + j / 2) * n + i] : 0.0;
      }
    }
    for (some = 1; some < BESIDE && m + some < count && step[m + some] == step[m]; some++) {}
    double ahead[7][BESIDE];
    for (int order = 0; order < 7; order++) for (int l = 0; l < BESIDE; l++)
      ahead[order][l] = moments[m + (l < some ? l : 0)] - z[order];
    EACH {
      double x[BESIDE], v[BESIDE];
      for (int l = 0; l < BESIDE; l++) x[l] = c[7 * n + i], v[l] = 0.0;
      for (int order = 6; order >= 0; order--) {
        const double next = c[order * n + i];
        for (int l = 0; l < BESIDE; l++) v[l] = v[l] * ahead[order][l] + x[l], x[l] = x[l] * ahead[order][l] + next;
      }
      for (int l = 0; l < BESIDE; l++) value[l * n + i] = x[l], slope[l * n + i] = v[l];
    }
    for (int l = 0; l < some; l++) {
      rates_at(&call, moments[m + l], value + l * n, rate);
      off[m + l] = 0.0;
      EACH {
        double apart = fabs(rate[i] - slope[l * n + i]);
        if (!(apart <= off[m + l])) off[m + l] = apart == apart ? apart : INFINITY;
      }
    }
  }
  free(call.arg);
  free(c);
  return 0;
}
