/* Marches of y' = f(t, y, p): SIZE components, TAIL numbers p beside the step, one call for all segments. */
#define ROWS (1 + SIZE)

static void step(V *z, const V *p);

INLINE void gathered(V *to, const double *from, const ptrdiff_t *rows, int width) {
  for (int i = 0; i < width; i++) for (int l = 0; l < LANES; l++) to[i][l] = from[rows[l] * width + i];
}

/* (t, y) of `count` segments in `starts`, (h, p) of `steps` steps of each, one after another, in `steps_of`; where the
   segments end in `ends`, and of each step the first `kept` of its end in `path`. */
void march(ptrdiff_t count, ptrdiff_t steps, const double *starts, const double *steps_of, double *ends, double *path,
           ptrdiff_t kept) {
  for (ptrdiff_t first = 0; first < count; first += LANES) {
    V z[ROWS], p[1 + TAIL] = {{0}};
    ptrdiff_t segment[LANES], row[LANES];
    for (int l = 0; l < LANES; l++) segment[l] = first + l < count ? first + l : count - 1;
    gathered(z, starts, segment, ROWS);
    for (ptrdiff_t k = 0; k < steps; k++) {
      for (int l = 0; l < LANES; l++) row[l] = segment[l] * steps + k;
      gathered(p, steps_of, row, 1 + TAIL);
      step(z, p);
      for (int l = 0; l < LANES; l++) for (ptrdiff_t i = 0; i < kept; i++) path[row[l] * kept + i] = z[i][l];
    }
    for (int l = 0; l < LANES; l++) for (int i = 0; i < ROWS; i++) ends[segment[l] * ROWS + i] = z[i][l];
  }
}
