/* A change of Newton's method of the stages of collocation, interval by interval (see `integrate/collocation.py`).

   `collocated` gives f, its derivatives by x, by (t where it matters, s, free) and the integrand, NUMBERS in all. */
#include <string.h>

#define STAGED (POINTS * D)           /* unknowns of an interval */
#define TAILS (1 + UNFOLDING + FREE)  /* T, s and free */
#define RIGHT (1 + D + TAILS)         /* the change, and derivatives by the node and by T, s and free */
#define WIDE 4
#define ROW ((STAGED + RIGHT + WIDE - 1) / WIDE)
typedef double Q __attribute__((vector_size(8 * WIDE)));

/* LU with the largest pivot of each column and its right sides, in rows of ROW Qs; 0 where there is no pivot. */
static int reduced_rows(Q (*a)[ROW]) {
  for (int c = 0; c < STAGED; c++) {
    int best = c;
    for (int r = c + 1; r < STAGED; r++) if (fabs(((double *)a[r])[c]) > fabs(((double *)a[best])[c])) best = r;
    if (!(fabs(((double *)a[best])[c]) > 0)) return 0;
    if (best != c) for (int q = c / WIDE; q < ROW; q++) { Q x = a[c][q]; a[c][q] = a[best][q]; a[best][q] = x; }
    double inverse = 1.0 / ((double *)a[c])[c];
    for (int r = c + 1; r < STAGED; r++) {
      double share = ((double *)a[r])[c] * inverse;
      if (share != 0.0) for (int q = c / WIDE; q < ROW; q++) a[r][q] -= share * a[c][q];
    }
  }
  for (int c = STAGED - 1; c >= 0; c--) {
    double inverse = 1.0 / ((double *)a[c])[c];
    for (int q = STAGED / WIDE; q < ROW; q++) a[c][q] *= inverse;
    for (int r = 0; r < c; r++) {
      double share = ((double *)a[r])[c];
      if (share != 0.0) for (int q = STAGED / WIDE; q < ROW; q++) a[r][q] -= share * a[c][q];
    }
  }
  return 1;
}

/* Values (k x NUMBERS) at times and states (k x D), of T, s and free (k x TAILS). */
void valued(ptrdiff_t count, const double *times, const double *at, const double *tails, double *out) {
  for (ptrdiff_t first = 0; first < count; first += LANES) {
    V t, x[D], p[TAILS], r[NUMBERS];
    for (int l = 0; l < LANES; l++) {
      ptrdiff_t k = first + l < count ? first + l : count - 1;
      t[l] = times[k];
      for (int i = 0; i < D; i++) x[i][l] = at[k * D + i];
      for (int i = 0; i < TAILS; i++) p[i][l] = tails[k * TAILS + i];
    }
    collocated(&t, x, p + 1, p + 1 + UNFOLDING, r);
    for (int l = 0; l < LANES && first + l < count; l++)
      for (int i = 0; i < NUMBERS; i++) out[(first + l) * NUMBERS + i] = r[i][l];
  }
}

/* The matrix and the right sides of an interval from the values at its points in one lane. */
static void assembled(Q (*a)[ROW], V (*v)[NUMBERS], int lane, const double *rule, const double *z, double begin,
                      double step, const double *tail) {
  const double *points = rule, *inner = rule + POINTS, duration = step * tail[0];
  memset(a, 0, STAGED * sizeof *a);
  for (int i = 0; i < POINTS; i++) for (int b = 0; b < D; b++) {
    double *row = (double *)a[i * D + b], *right = row + STAGED;
    for (int j = 0; j < POINTS; j++) {
      const double share = duration * inner[i * POINTS + j];
      right[1 + D] += share * v[j][b][lane];
      for (int c = 0; c < D; c++) {
        const double across = share * v[j][D + c * D + b][lane];
        row[j * D + c] = (i == j && b == c) - across;
        right[1 + c] += across;
      }
      for (int c = 0; c < TAILS - 1; c++) right[2 + D + c] += share * v[j][D + D * D + (FORCED + c) * D + b][lane];
    }
    right[0] = right[1 + D] - z[i * D + b];
    right[1 + D] /= tail[0];
    if (FORCED) for (int j = 0; j < POINTS; j++) /* a longer period moves every moment */
      right[1 + D] += duration * inner[i * POINTS + j] * v[j][D + D * D + b][lane] * (begin + step * points[j]);
  }
}

/* Changes and derivatives (count x STAGED x RIGHT) of stages z (count x STAGED) of steps that begin at shares of the
   period, and the integrals (count); `rule` is points, inner and weights. Returns whether it is not possible. */
int changed(ptrdiff_t count, const double *nodes, const double *begins, const double *steps, const double *tails,
            const double *rule, const double *z, double *found, double *integrals) {
  const double *weights = rule + POINTS + POINTS * POINTS;
  void *memory = malloc(STAGED * sizeof(Q[ROW]) + POINTS * sizeof(V[NUMBERS]) + 128);
  if (!memory) return 1;
  Q (*a)[ROW] = (Q (*)[ROW])(((uintptr_t)memory + 63) & ~(uintptr_t)63);
  V (*v)[NUMBERS] = (V (*)[NUMBERS])(((uintptr_t)(a + STAGED) + 63) & ~(uintptr_t)63);
  int singular = 0;
  for (ptrdiff_t first = 0; first < count && !singular; first += LANES) {
    V p[TAILS];
    ptrdiff_t own[LANES];
    for (int l = 0; l < LANES; l++) own[l] = first + l < count ? first + l : count - 1;
    for (int l = 0; l < LANES; l++) for (int i = 0; i < TAILS; i++) p[i][l] = tails[own[l] * TAILS + i];
    for (int j = 0; j < POINTS; j++) {
      V t = all(0.0), x[D];
      for (int l = 0; l < LANES; l++) {
        const ptrdiff_t k = own[l];
        if (FORCED) t[l] = (begins[k] + steps[k] * rule[j]) * tails[k * TAILS];
        for (int i = 0; i < D; i++) x[i][l] = nodes[k * D + i] + z[k * STAGED + j * D + i];
      }
      collocated(&t, x, p + 1, p + 1 + UNFOLDING, v[j]);
    }
    for (int l = 0; l < LANES && first + l < count; l++) {
      const ptrdiff_t k = first + l;
      const double *tail = tails + k * TAILS;
      assembled(a, v, l, rule, z + k * STAGED, begins[k], steps[k], tail);
      if (!reduced_rows(a)) { singular = 1; break; }
      for (int i = 0; i < STAGED; i++) memcpy(found + (k * STAGED + i) * RIGHT, (double *)a[i] + STAGED, RIGHT * 8);
      double sum = 0;
      if (ADDED) for (int j = 0; j < POINTS; j++) sum += weights[j] * v[j][NUMBERS - 1][l];
      integrals[k] = steps[k] * tail[0] * sum;
    }
  }
  free(memory);
  return singular;
}
