/* Gragg's midpoint rule, extrapolated (Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section
   II.9), of y' = f(t, y u) / u for a field f(t, x, free) in CasADi's own C, which stands above as FIELD in casadi_real:
   u are units. Its coefficients are ratios of whole numbers, so that they are exact in any precision; Bulirsch's sequence
   makes no more than ten times as much of a round-off, and even numbers, of which more orders come as cheaply, so much
   that quadruple precision alone can spare it. */
#include <stddef.h>
#include <stdlib.h>

static const int PARTS[ROWS] = {SEQUENCE};
#define EACH for (ptrdiff_t i = 0; i < n; i++)
#define RATE(TIME, MOVED, TO) { \
  EACH x[i] = (y[i] + MOVED) * units[i]; \
  now = TIME, arg[0] = &now, arg[1] = x, arg[2] = values, res[0] = TO; \
  const int failed = FIELD(arg, res, iw, w, 0); \
  EACH (TO)[i] = failed ? NAN : (TO)[i] / units[i]; }

/* Take a state, the sum of two (n each), from at[0], by steps of which the next is at[1] long, towards at[2], each with
   an error of no more than `allowed`; at most `left` are tried. Returns whether there was no memory for it. */
int extrapolated(ptrdiff_t n, long double *state, long double *at, const double *units, const double *freed,
                 double allowed, ptrdiff_t left) {
  casadi_int args, results, whole, reals;
  FIELD_work(&args, &results, &whole, &reals);
  const size_t places = (args + results + 3) * sizeof(casadi_real *) + whole * sizeof(casadi_int) + 64;
  const casadi_real **arg = (const casadi_real **)malloc(places);
  casadi_real *w = (casadi_real *)malloc((reals + (ROWS + 6) * n + FREED + 1) * sizeof(casadi_real));
  if (!arg || !w) { free((void *)arg), free(w); return 1; }
  casadi_real **res = (casadi_real **)(arg + args + 3), *table = w + reals, *before = table + ROWS * n;
  casadi_real *here = before + n, *rate = here + n, *first = rate + n, *x = first + n, *y = x + n, *values = y + n;
  casadi_int *iw = (casadi_int *)(res + results);
  casadi_real t = at[0], h = at[1], now;
  for (int k = 0; k < FREED; k++) values[k] = freed[k];
  EACH y[i] = (state[i] + (casadi_real)state[n + i]) / units[i];
  RATE(t, 0, first)
  while (t < at[2] && left-- > 0) {
    const int last = t + 1.01L * h >= at[2];
    h = (last ? at[2] : t + h) - t; /* what the clock moves by, or passages shorter than its round-off are lost */
    for (int row = 0; row < ROWS; row++) {
      const int parts = PARTS[row];
      const casadi_real part = h / parts;
      EACH before[i] = 0, here[i] = part * first[i]; /* from y, or its round-off would count ten times */
      for (int k = 1; k < parts; k++) {
        RATE(t + k * part, here[i], rate)
        EACH { casadi_real next = before[i] + 2 * part * rate[i]; before[i] = here[i], here[i] = next; }
      }
      RATE(t + h, here[i], rate)
      EACH table[row * n + i] = (here[i] + before[i] + part * rate[i]) / 2;
    }
    long double off = 0; /* what the last order changes, in units or in sizes where these are larger */
    EACH for (int order = 1; order < ROWS; order++) for (int row = ROWS - 1; row >= order; row--) {
      const casadi_real ratio = PARTS[row] / (casadi_real)PARTS[row - order], *finer = table + row * n + i;
      const casadi_real change = (finer[0] - finer[-n]) / (ratio * ratio - 1);
      const long double share = fabsl((long double)change) / (1 + fabsl((long double)y[i]));
      table[row * n + i] += change;
      if (order == ROWS - 1 && !(share <= off)) off = share;
    }
    const long double factor = off == 0 ? 4 : 0.9L * powl(allowed / off, 1.0L / (2 * ROWS - 1));
    if (off <= allowed) {
      t = last ? at[2] : t + h;
      EACH y[i] += table[(ROWS - 1) * n + i];
      RATE(t, 0, first)
    }
    h *= factor > 4 ? 4 : factor > 0.1L ? factor : 0.1L;
  }
  at[0] = (long double)t, at[1] = (long double)h;
  EACH x[i] = y[i] * units[i], state[i] = (long double)x[i], state[n + i] = (long double)(x[i] - state[i]);
  free((void *)arg), free(w);
  return 0;
}
