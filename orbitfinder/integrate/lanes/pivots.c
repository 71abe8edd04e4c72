/* Gaussian elimination by the largest pivot of each column. */
#include <math.h>
#include <stddef.h>

/* The first columns of some rows eliminated, shares kept in their place, and which row each pivot came from; 0 where there
   is none. */
static int eliminated(double *a, ptrdiff_t *order, ptrdiff_t rows, ptrdiff_t columns, ptrdiff_t width) {
  for (ptrdiff_t c = 0; c < columns; c++) {
    ptrdiff_t best = c;
    for (ptrdiff_t r = c + 1; r < rows; r++) if (fabs(a[r * width + c]) > fabs(a[best * width + c])) best = r;
    order[c] = best;
    if (!(fabs(a[best * width + c]) > 0)) return 0;
    if (best != c) for (ptrdiff_t k = 0; k < width; k++) {
      double x = a[c * width + k]; a[c * width + k] = a[best * width + k]; a[best * width + k] = x;
    }
    double inverse = 1.0 / a[c * width + c];
    for (ptrdiff_t r = c + 1; r < rows; r++) {
      double share = a[r * width + c];
      if (share == 0.0) continue;
      share *= inverse;
      a[r * width + c] = share;
      for (ptrdiff_t k = c + 1; k < width; k++) a[r * width + k] -= share * a[c * width + k];
    }
  }
  return 1;
}
