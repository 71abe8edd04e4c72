/* Marches of y' = f(t, y, s, free), one call for all segments: t and OWN numbers y, the first STATE of which f sees.

   With COLUMNS, y = (x, S) and beside it stand the columns of Y' = df/dx Y + [0 | forcing], TOGETHER at a time: the
   stages of x come first, with df/dx at each, so that no more than a few columns need be near at once. Those that move
   together stand together, number by number, from place AHEAD of HELD on. */
#define STAGES 13
#ifdef COLUMNS
#define ROWS (1 + OWN + STATE * COLUMNS)
#define AHEAD ((OWN + 8) / 8 * 8)
#define HELD (AHEAD + (COLUMNS + BESIDE - 1) / BESIDE * BESIDE * STATE)
#define ROOM (STAGES * (OWN + SLOPES + FORCING) + OWN + (MOVING * STAGES + BLOCK + INNER * TOGETHER) * (sizeof(W) / sizeof(V)))
#else
#define ROWS (1 + OWN)
#define HELD ROWS
#define ROOM ((STAGES + 1) * OWN)
#endif
#define GIVEN (1 + UNFOLDING + FREE)

#ifdef COLUMNS
/* rate = df/dx y + forcing for TOGETHER vectors of columns that stand side by side, from column `first` on; behind y
   there is room for what the factors of df/dx make of it (see `factors.py`). */
static void product(W *restrict rate, const V *restrict slope, const V *restrict forcing, W *restrict y, int first) {
  for (int r = 0, k = 0; r < INNER + STATE - PLACED; r++) {
    W sum[TOGETHER] = {{0.0}}, *to = r < INNER ? y + (STATE + r) * TOGETHER : rate + (r - INNER) * TOGETHER;
    for (; k < BEGIN[r + 1]; k++) {
      const W slant = SPREAD(slope[k]), *row = y + COLUMN[k] * TOGETHER;
#pragma GCC unroll 4
      for (int j = 0; j < TOGETHER; j++) sum[j] += slant * row[j];
    }
    for (int j = 0; j < TOGETHER; j++) to[j] = sum[j];
  }
  for (int c = first < STATE ? STATE : first; c < first + BESIDE && c < COLUMNS; c++)
    for (int i = PLACED; i < STATE; i++) COLUMN_OF(rate, i - PLACED, c - first) += NUMBER(forcing[(c - STATE) * STATE + i]);
}
#endif

/* A step of z = (t, y, Y) by p = (h, s, free); in `error`, where there is such, in the same places what it is wrong by. */
static void step(V *z, const V *p, V *work, V *error) {
  const V h = p[0], *s = p + 1, *freed = s + UNFOLDING;
#ifdef COLUMNS
  W *y = (W *)work, (*d)[MOVING] = (W (*)[MOVING])(y + BLOCK + INNER * TOGETHER);
  V (*slope)[SLOPES] = (V (*)[SLOPES])(d + STAGES), (*forcing)[FORCING] = (V (*)[FORCING])(slope + STAGES);
  V (*k)[OWN] = (V (*)[OWN])(forcing + STAGES);
  states(z + 1, h, z[0], k[STAGES], k, error ? error + 1 : 0, s, freed, slope, forcing);
  for (int first = 0; first < COLUMNS; first += BESIDE) {
    const ptrdiff_t at = AHEAD + first * STATE;
    columns((W *)(z + at), SPREAD(h), SPREAD(z[0]), y, d, error ? (W *)(error + at) : 0, slope, forcing, first);
  }
#else
  states(z + 1, h, z[0], work, (V (*)[OWN])(work + OWN), error ? error + 1 : 0, s, freed);
#endif
  z[0] += h;
}

/* Where number i of (t, x, vec Y, S), as callers have them, stands in z. */
INLINE int within(int i) {
#ifdef COLUMNS
  if (i <= STATE || i > STATE * (1 + COLUMNS)) return i <= STATE ? i : i - STATE * COLUMNS;
  const int c = (i - 1) / STATE - 1;
  return AHEAD + (c / BESIDE * STATE + (i - 1) % STATE) * BESIDE + c % BESIDE;
#else
  return i;
#endif
}

/* (t, y) of `count` segments in `starts`, (h, s, free) of the steps of each, one after another, in `given`, from number
   begins[i] to begins[i + 1] for segment i; where the segments end in `ends`, of each step the first `kept` numbers of its
   end in `path`; in `errors`, where there is such, estimates for the last step of each. A lane whose segment has ended goes
   on with the next in `order`, without any it rests, unread. Returns whether there was no memory for it. */
int march(ptrdiff_t count, const ptrdiff_t *begins, const ptrdiff_t *order, const double *starts, const double *given,
          double *ends, double *path, ptrdiff_t kept, double *errors) {
  void *memory = calloc((2 * HELD + ROOM) * sizeof(V) + 64, 1);
  if (!memory) return 1;
  V *z = (V *)(((uintptr_t)memory + 63) & ~(uintptr_t)63), *error = z + HELD, *work = error + HELD, p[GIVEN];
  ptrdiff_t segment[LANES], row[LANES], next = 0, left = count;
  for (int l = 0; l < LANES; l++) segment[l] = -1, row[l] = 0;
  for (int i = 0; i < ROWS; i++) z[within(i)] = all(starts[i]);
  while (left) {
    for (int l = 0; l < LANES; l++) {
      if (segment[l] < 0 && next < count) {
        segment[l] = order[next++], row[l] = begins[segment[l]];
        for (int i = 0; i < ROWS; i++) z[within(i)][l] = starts[segment[l] * ROWS + i];
      }
      for (int i = 0; i < GIVEN; i++) p[i][l] = segment[l] < 0 && !i ? 0.0 : given[row[l] * GIVEN + i];
    }
    step(z, p, work, errors ? error : 0);
    for (int l = 0; l < LANES; l++) if (segment[l] >= 0) {
      for (ptrdiff_t i = 0; i < kept; i++) path[row[l] * kept + i] = z[i][l];
      if (row[l] + 1 < begins[segment[l] + 1]) { row[l]++; continue; }
      for (int i = 0; i < ROWS; i++) {
        ends[segment[l] * ROWS + i] = z[within(i)][l];
        if (errors && i) errors[segment[l] * (ROWS - 1) + i - 1] = error[within(i)][l];
      }
      segment[l] = -1, left--;
    }
  }
  free(memory);
  return 0;
}

#ifndef COLUMNS
/* Rates (k x OWN) at times and states of which `one` tells whether all have the first of `given` (s, free). */
void evaluated(ptrdiff_t count, int one, const double *times, const double *at, const double *given, double *out) {
  for (ptrdiff_t first = 0; first < count; first += LANES) {
    V t, y[STATE], p[GIVEN], r[OWN];
    for (int l = 0; l < LANES; l++) {
      ptrdiff_t k = first + l < count ? first + l : count - 1;
      t[l] = times[k];
      for (int i = 0; i < STATE; i++) y[i][l] = at[k * STATE + i];
      for (int i = 0; i < GIVEN - 1; i++) p[i][l] = given[(one ? 0 : k) * (GIVEN - 1) + i];
    }
    rates(&t, y, p, p + UNFOLDING, r);
    for (int l = 0; l < LANES && first + l < count; l++) for (int i = 0; i < OWN; i++) out[(first + l) * OWN + i] = r[i][l];
  }
}
#endif
