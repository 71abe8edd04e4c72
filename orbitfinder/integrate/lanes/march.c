/* Marches of y' = f(t, y, s, free), one call for all segments: t and OWN numbers y, the first STATE of which f sees.

   With COLUMNS, y = (x, S) and beside it stand the columns of Y' = df/dx Y + [0 | forcing], TOGETHER at a time: the
   stages of x come first, with df/dx at each, so that no more than a few columns need be near at once. */
#define STAGES 13
#ifdef COLUMNS
#define ROWS (1 + OWN + STATE * COLUMNS)
#define BLOCK (STATE * TOGETHER)
#define ROOM (STAGES * (OWN + SLOPES + FORCING) + OWN + BLOCK * (STAGES + 3))
#else
#define ROWS (1 + OWN)
#define ROOM ((STAGES + 1) * OWN)
#endif
#define GIVEN (1 + UNFOLDING + FREE)

#ifdef COLUMNS
/* rate = df/dx y + forcing for TOGETHER columns that stand side by side, of which column `first` is the first. */
static void product(V *rate, const V *slope, const V *forcing, const V *y, int first) {
  for (int i = 0; i < STATE; i++) {
    V a = all(0.0), b = a, c = a, d = a;
    for (int k = BEGIN[i]; k < BEGIN[i + 1]; k++) {
      const V slant = slope[k], *row = y + COLUMN[k] * TOGETHER;
      a += slant * row[0]; b += slant * row[1]; c += slant * row[2]; d += slant * row[3];
    }
    V *to = rate + i * TOGETHER;
    to[0] = a; to[1] = b; to[2] = c; to[3] = d;
    for (int j = 0; j < TOGETHER; j++)
      if (first + j >= STATE && first + j < COLUMNS) to[j] += forcing[(first + j - STATE) * STATE + i];
  }
}
#endif

/* A step of z = (t, y, Y) by p = (h, s, free); in `error`, where there is such, what y and Y are wrong by. */
static void step(V *z, const V *p, V *work, V *error) {
  const V h = p[0], *s = p + 1, *freed = s + UNFOLDING;
#ifdef COLUMNS
  V (*k)[OWN] = (V (*)[OWN])work, (*slope)[SLOPES] = (V (*)[SLOPES])(k + STAGES);
  V (*forcing)[FORCING] = (V (*)[FORCING])(slope + STAGES), *y = (V *)(forcing + STAGES);
  states(z + 1, h, z, y, k, error, s, freed, slope, forcing);
  V *base = y + OWN, *place = base + BLOCK, *wrong = place + BLOCK, (*d)[BLOCK] = (V (*)[BLOCK])(wrong + BLOCK);
  for (int first = 0; first < COLUMNS; first += TOGETHER) {
    V *to = z + 1 + OWN + first * STATE, *lost = error ? error + OWN + first * STATE : 0;
    for (int j = 0; j < TOGETHER; j++) for (int i = 0; i < STATE; i++)
      base[i * TOGETHER + j] = first + j < COLUMNS ? to[j * STATE + i] : all(0.0);
    columns(base, h, z, place, d, error ? wrong : 0, slope, forcing, first);
    for (int j = 0; j < TOGETHER && first + j < COLUMNS; j++) for (int i = 0; i < STATE; i++) {
      to[j * STATE + i] = base[i * TOGETHER + j];
      if (error) lost[j * STATE + i] = wrong[i * TOGETHER + j];
    }
  }
#else
  states(z + 1, h, z, work, (V (*)[OWN])(work + OWN), error, s, freed);
#endif
  z[0] += h;
}

/* Where number i of (t, x, vec Y, S), as callers have them, stands in z. */
INLINE int within(int i) {
#ifdef COLUMNS
  return i <= STATE ? i : i <= STATE * (1 + COLUMNS) ? i + OWN - STATE : i - STATE * COLUMNS;
#else
  return i;
#endif
}

INLINE void gathered(V *to, const double *from, const ptrdiff_t *rows, int width) {
  for (int i = 0; i < width; i++) for (int l = 0; l < LANES; l++) to[i][l] = from[rows[l] * width + i];
}

/* (t, y) of `count` segments in `starts`, (h, s, free) of `steps` steps of each, one after another, in `given`; where
   the segments end in `ends`, of each step the first `kept` numbers of its end in `path`; in `errors`, where there is
   such, estimates for the last step of each. Returns whether there was no memory for it. */
int march(ptrdiff_t count, ptrdiff_t steps, const double *starts, const double *given, double *ends, double *path,
          ptrdiff_t kept, double *errors) {
  void *memory = malloc((2 * ROWS + ROOM) * sizeof(V) + 64);
  if (!memory) return 1;
  V *z = (V *)(((uintptr_t)memory + 63) & ~(uintptr_t)63), *error = z + ROWS, *work = error + ROWS, p[GIVEN];
  for (ptrdiff_t first = 0; first < count; first += LANES) {
    ptrdiff_t segment[LANES], row[LANES];
    for (int l = 0; l < LANES; l++) segment[l] = first + l < count ? first + l : count - 1;
    for (int i = 0; i < ROWS; i++) for (int l = 0; l < LANES; l++) z[within(i)][l] = starts[segment[l] * ROWS + i];
    for (ptrdiff_t k = 0; k < steps; k++) {
      for (int l = 0; l < LANES; l++) row[l] = segment[l] * steps + k;
      gathered(p, given, row, GIVEN);
      step(z, p, work, errors && k == steps - 1 ? error : 0);
      for (int l = 0; l < LANES; l++) for (ptrdiff_t i = 0; i < kept; i++) path[row[l] * kept + i] = z[i][l];
    }
    for (int l = 0; l < LANES; l++) for (int i = 0; i < ROWS; i++) {
      ends[segment[l] * ROWS + i] = z[within(i)][l];
      if (errors && i) errors[segment[l] * (ROWS - 1) + i - 1] = error[within(i) - 1][l];
    }
  }
  free(memory);
  return 0;
}
