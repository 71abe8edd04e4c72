/* A bordered chain of blocks, factorised and solved: unknowns x_0 .. x_{N-1} (d each) and y (m), rows

     Phi_k x_k - x_{k+1} + C_k y = r_k    (k < N - 1),        A x_0 + B x_{N-1} + G y = r    (d + m of these)

   x_1, x_2, ... are eliminated one after another between the two blocks of rows that hold them, by the largest pivot of
   both: what grows and what decays along the chain keep their digits alike. Source: S. Wright, SIAM Journal on
   Scientific and Statistical Computing 13 (1992) 742-764 (structured LU). What is left is of x_0, x_{N-1} and y. */
#include <string.h>

typedef struct {
  ptrdiff_t n, d, m;
  const double *phi, *columns, *first, *last, *tail, *states, *tails; /* the last two: what x and y are measured in */
} Chain;

#define WIDTH (3 * d + m)            /* of a row: x_k, x_0, x_{k+1}, y */
#define CLOSING (d + m)
#define LEFT (2 * d + m)             /* unknowns that are left at last */
#define PIECE (2 * d * WIDTH)        /* numbers kept of an elimination */

static void swapped(double *b, const ptrdiff_t *order, ptrdiff_t columns) {
  for (ptrdiff_t c = 0; c < columns; c++) if (order[c] != c) { double x = b[c]; b[c] = b[order[c]]; b[order[c]] = x; }
}

/* Into `kept` (N - 2 pieces, the last rows, what closing rows are measured in), `order`; whether there is a pivot
   everywhere. `now` has d WIDTH numbers. */
int factored(const Chain *o, double *kept, ptrdiff_t *order, double *now) {
  const ptrdiff_t n = o->n, d = o->d, m = o->m;
  const double *u = o->states, *v = o->tails;
  double *last = kept + (n - 2) * PIECE, *sizes = last + LEFT * LEFT;
  memset(now, 0, d * WIDTH * sizeof *now);
  for (ptrdiff_t i = 0; i < d; i++) {
    double *row = now + i * WIDTH;
    row[i] = -1.0;
    for (ptrdiff_t j = 0; j < d; j++) row[d + j] = o->phi[i * d + j] * u[j] / u[i];
    for (ptrdiff_t j = 0; j < m; j++) row[3 * d + j] = o->columns[i * m + j] * v[j] / u[i];
  }
  for (ptrdiff_t k = 1; k < n - 1; k++) {
    double *piece = kept + (k - 1) * PIECE;
    memcpy(piece, now, d * WIDTH * sizeof *now);
    for (ptrdiff_t i = 0; i < d; i++) {
      double *row = piece + (d + i) * WIDTH;
      memset(row, 0, WIDTH * sizeof *row);
      for (ptrdiff_t j = 0; j < d; j++) row[j] = o->phi[(k * d + i) * d + j] * u[j] / u[i];
      row[2 * d + i] = -1.0;
      for (ptrdiff_t j = 0; j < m; j++) row[3 * d + j] = o->columns[(k * d + i) * m + j] * v[j] / u[i];
    }
    if (!eliminated(piece, order + (k - 1) * d, 2 * d, d, WIDTH)) return 0;
    for (ptrdiff_t i = 0; i < d; i++) { /* the rows that are left hold x_0 and x_{k+1} */
      double *row = now + i * WIDTH, *from = piece + (d + i) * WIDTH;
      memcpy(row, from + 2 * d, d * sizeof *row);
      memcpy(row + d, from + d, d * sizeof *row);
      memcpy(row + 3 * d, from + 3 * d, m * sizeof *row);
    }
  }
  for (ptrdiff_t i = 0; i < d; i++) {
    memcpy(last + i * LEFT, now + i * WIDTH, 2 * d * sizeof *last);
    memcpy(last + i * LEFT + 2 * d, now + i * WIDTH + 3 * d, m * sizeof *last);
  }
  for (ptrdiff_t r = 0; r < CLOSING; r++) {
    double *row = last + (d + r) * LEFT, largest = 0;
    for (ptrdiff_t j = 0; j < d; j++) row[j] = o->last[r * d + j] * u[j];
    for (ptrdiff_t j = 0; j < d; j++) row[d + j] = o->first[r * d + j] * u[j];
    for (ptrdiff_t j = 0; j < m; j++) row[2 * d + j] = o->tail[r * m + j] * v[j];
    for (ptrdiff_t j = 0; j < LEFT; j++) largest = fmax(largest, fabs(row[j]));
    sizes[r] = largest > 0 ? largest : 1.0;
    for (ptrdiff_t j = 0; j < LEFT; j++) row[j] /= sizes[r];
  }
  return eliminated(last, order + (n - 2) * d, LEFT, LEFT, LEFT);
}

/* The solution of `right` (N d + m) in its place. */
void solved(const Chain *o, const double *kept, const ptrdiff_t *order, double *right, double *work) {
  const ptrdiff_t n = o->n, d = o->d, m = o->m;
  const double *u = o->states, *v = o->tails, *last = kept + (n - 2) * PIECE, *sizes = last + LEFT * LEFT;
  double *closing = right + (n - 1) * d, *b = work;
  for (ptrdiff_t k = 0; k < n - 1; k++) for (ptrdiff_t i = 0; i < d; i++) right[k * d + i] /= u[i];
  for (ptrdiff_t r = 0; r < CLOSING; r++) closing[r] /= sizes[r];
  for (ptrdiff_t k = 1; k < n - 1; k++) { /* rows k - 1 and k: the first become those of x_k's pivots */
    const double *piece = kept + (k - 1) * PIECE;
    double *rows = right + (k - 1) * d;
    swapped(rows, order + (k - 1) * d, d);
    for (ptrdiff_t c = 0; c < d; c++) for (ptrdiff_t r = c + 1; r < 2 * d; r++) rows[r] -= piece[r * WIDTH + c] * rows[c];
  }
  memcpy(b, right + (n - 2) * d, LEFT * sizeof *b);
  swapped(b, order + (n - 2) * d, LEFT);
  for (ptrdiff_t c = 0; c < LEFT; c++) for (ptrdiff_t r = c + 1; r < LEFT; r++) b[r] -= last[r * LEFT + c] * b[c];
  for (ptrdiff_t c = LEFT - 1; c >= 0; c--) {
    b[c] /= last[c * LEFT + c];
    for (ptrdiff_t r = 0; r < c; r++) b[r] -= last[r * LEFT + c] * b[c];
  }
  const double *next = b; /* b is x_{N-1}, x_0, y */
  for (ptrdiff_t k = n - 2; k > 0; k--) {
    const double *piece = kept + (k - 1) * PIECE;
    double *x = right + (k - 1) * d;
    for (ptrdiff_t c = d - 1; c >= 0; c--) {
      const double *row = piece + c * WIDTH;
      double sum = x[c];
      for (ptrdiff_t j = c + 1; j < d; j++) sum -= row[j] * x[j];
      for (ptrdiff_t j = 0; j < d; j++) sum -= row[d + j] * b[d + j] + row[2 * d + j] * next[j];
      for (ptrdiff_t j = 0; j < m; j++) sum -= row[3 * d + j] * b[2 * d + j];
      x[c] = sum / row[c];
    }
    next = x;
  }
  memmove(right + d, right, (n - 2) * d * sizeof *right);
  memcpy(right, b + d, d * sizeof *right);
  memcpy(right + (n - 1) * d, b, d * sizeof *right);
  memcpy(right + n * d, b + 2 * d, m * sizeof *right);
  for (ptrdiff_t i = 0; i < n * d; i++) right[i] *= u[i % d];
  for (ptrdiff_t j = 0; j < m; j++) right[n * d + j] *= v[j];
}
