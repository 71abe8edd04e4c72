/* A family of loops of one smooth arc, point after point: predict, correct, tangent, scales, length of the next step.

   What `families.follow` does where nothing happens, in one call; it stops before a point of which the driver must know
   more: a refused step, a sharp turn, a stretched period, a mesh that no longer fits. w = (nodes, T, s, free); rows are
   defects, boundary, phase, conditions and the aim (see `loops/loop.py`), all linear but for the flow and conditions. */
#include <string.h>

#define MORE (UNFOLDING + FREE)
#define TAILS (1 + MORE)            /* T, s and free */
#define VARIED (D * (1 + D + MORE)) /* numbers of x and its variations; the integral follows */

typedef struct {
  ptrdiff_t segments, steps, closing, phase, images, forced, first_order;
  const double *mesh, *first, *last, *aimed, *maps, *lengths, *angular, *values, *units;
  double ready, floor, contraction, stall, iterations, sharpest, stretch, longest, prediction, stale, allowed,
    spare, sampled, steepest, least_share, still, unfelt, stepped;
} Frame;

/* One accepted point, and what the next begins with. */
typedef struct { double *w, *tangent, *bend, *scales, *normals, *length; } Standing;
/* What was met on the way there. */
typedef struct { double *raw, *marched, *ends, *phi, *columns, *states, *jacobian, *facts; } Passage;

typedef struct {
  const Frame *f;
  ptrdiff_t n, cut, rows; /* unknowns, those of the nodes, rows without the aim */
  double *matrix, *kept, *right, *guess, *units, *lost, *metric, *scaled, *errors, *normal, *shares;
  ptrdiff_t *order;
  V *z, *work;
} Work;

static double norm2(const double *a, const double *b, ptrdiff_t n) {
  double sum = 0;
  for (ptrdiff_t i = 0; i < n; i++) sum += a[i] * b[i] * a[i] * b[i];
  return sqrt(sum);
}

static void solved(const double *a, const ptrdiff_t *order, double *b, ptrdiff_t n) {
  for (ptrdiff_t c = 0; c < n; c++) {
    double x = b[order[c]]; b[order[c]] = b[c]; b[c] = x;
  }
  for (ptrdiff_t r = 0; r < n; r++) { double sum = b[r]; for (ptrdiff_t k = 0; k < r; k++) sum -= a[r * n + k] * b[k]; b[r] = sum; }
  for (ptrdiff_t r = n - 1; r >= 0; r--) {
    double sum = b[r];
    for (ptrdiff_t k = r + 1; k < n; k++) sum -= a[r * n + k] * b[k];
    b[r] = sum / a[r * n + r];
  }
}

static void rates_at(const double *x, const double *times, const double *tail, ptrdiff_t count, double *out) {
  for (ptrdiff_t first = 0; first < count; first += LANES) {
    V t, y[D], p[MORE + 1] = {{0}}, r[D];
    for (int l = 0; l < LANES; l++) {
      ptrdiff_t k = first + l < count ? first + l : count - 1;
      t[l] = times[k];
      for (int i = 0; i < D; i++) y[i][l] = x[k * D + i];
    }
    for (int i = 0; i < MORE; i++) p[i] = all(tail[1 + i]);
    flow(&t, y, p, p + UNFOLDING, r);
    for (int l = 0; l < LANES && first + l < count; l++) for (int i = 0; i < D; i++) out[(first + l) * D + i] = r[i][l];
  }
}

/* All segments of w with their variations; the integral. */
static double marched(const Work *o, const double *w, const Passage *q) {
  const Frame *f = o->f;
  const ptrdiff_t N = f->segments, each = f->steps;
  const double *tail = w + o->cut;
  double integral = 0, starts[N], ends[N], late[N * D], early[N * D];
  memcpy(q->states, w, D * sizeof(double));
  for (ptrdiff_t first = 0; first < N; first += LANES) {
    V *z = o->z, *error = z + HELD, p[GIVEN];
    ptrdiff_t segment[LANES];
    for (int i = 0; i < HELD; i++) z[i] = all(0.0);
    for (int l = 0; l < LANES; l++) {
      segment[l] = first + l < N ? first + l : N - 1;
      z[0][l] = f->forced ? tail[0] * f->mesh[segment[l] * each] : 0.0;
      for (int i = 0; i < D; i++) z[1 + i][l] = w[segment[l] * D + i];
    }
    for (int i = 0; i < D; i++) z[within(1 + D + i * D + i)] = all(1.0);
    for (int i = 0; i < MORE; i++) p[1 + i] = all(tail[1 + i]);
    for (ptrdiff_t k = 0; k < each; k++) {
      for (int l = 0; l < LANES; l++) p[0][l] = tail[0] * (f->mesh[segment[l] * each + k + 1] - f->mesh[segment[l] * each + k]);
      step(z, p, o->work, error);
      for (int l = 0; l < LANES && first + l < N; l++) {
        ptrdiff_t row = (first + l) * each + k;
        for (int i = 0; i < D; i++) { q->states[(row + 1) * D + i] = z[1 + i][l]; o->errors[row * D + i] = error[1 + i][l]; }
      }
    }
    for (int l = 0; l < LANES && first + l < N; l++) {
      ptrdiff_t k = first + l;
      for (int i = 0; i < D; i++) {
        q->ends[k * D + i] = z[1 + i][l];
        for (int j = 0; j < D; j++) q->phi[(k * D + i) * D + j] = z[within(1 + D + j * D + i)][l];
        for (int j = 0; j < MORE; j++) q->columns[(k * D + i) * TAILS + 1 + j] = z[within(1 + D + (D + j) * D + i)][l];
      }
      for (int i = 1 + VARIED; i < ROWS; i++) integral += z[within(i)][l];
    }
  }
  for (ptrdiff_t k = 0; k < N; k++) { starts[k] = tail[0] * f->mesh[k * each]; ends[k] = tail[0] * f->mesh[(k + 1) * each]; }
  rates_at(q->ends, ends, tail, N, late);
  if (f->forced && N > 1) rates_at(w, starts, tail, N, early);
  for (ptrdiff_t k = 0; k < N; k++) {
    double begins = f->mesh[k * each], lasts = f->mesh[(k + 1) * each] - begins;
    for (int i = 0; i < D; i++) {
      double value = late[k * D + i] * lasts;
      if (f->forced && N > 1) {
        double carried = 0;
        for (int j = 0; j < D; j++) carried += q->phi[(k * D + i) * D + j] * early[k * D + j];
        value += (late[k * D + i] - carried) * begins;
      }
      q->columns[(k * D + i) * TAILS] = value;
    }
  }
  return integral;
}

/* The conditions at w and their slopes (named x D + 1 + FREE) by (x(0), T, free). */
static void conditioned(const Work *o, const double *w, double *values, double *slopes) {
  V x[D], period = all(w[o->cut]), chosen[FREE + 1] = {{0}}, r[CONDITIONS + 1], s[(CONDITIONS + 1) * (D + 1 + FREE)];
  for (int i = 0; i < D; i++) x[i] = all(w[i]);
  for (int i = 0; i < FREE; i++) chosen[i] = all(w[o->cut + 1 + UNFOLDING + i]);
  conditions(x, &period, chosen, r, s);
  for (int k = 0; k < CONDITIONS; k++) {
    values[k] = r[k][0] - o->f->values[k];
    for (int j = 0; j < D + 1 + FREE; j++) slopes[k * (D + 1 + FREE) + j] = s[k + j * CONDITIONS][0]; /* columns first */
  }
}

static ptrdiff_t column_of(const Work *o, int j) { return j < D ? j : j == D ? o->cut : o->cut + UNFOLDING + j - D; }

static void rows_of(const Work *o, const double *w, const Standing *from, const Passage *q, double level, double *right) {
  const Frame *f = o->f;
  const ptrdiff_t N = f->segments;
  double *row = right, slopes[(CONDITIONS + 1) * (D + 1 + FREE)];
  for (ptrdiff_t k = 0; k + 1 < N; k++) for (int i = 0; i < D; i++) *row++ = q->ends[k * D + i] - w[(k + 1) * D + i];
  for (ptrdiff_t r = 0; r < f->closing; r++) {
    double sum = -f->aimed[r];
    for (int j = 0; j < D; j++) sum += f->first[r * D + j] * w[j] + f->last[r * D + j] * q->ends[(N - 1) * D + j];
    *row++ = sum;
  }
  if (f->phase) {
    double sum = 0;
    for (ptrdiff_t j = 0; j < o->cut; j++) sum += from->normals[j] * (w[j] - from->w[j]);
    *row++ = sum;
  }
  conditioned(o, w, row, slopes);
  row += CONDITIONS;
  *row = -level;
  for (ptrdiff_t j = 0; j < o->n; j++) *row += o->normal[j] * w[j];
  for (ptrdiff_t k = 0; k < o->n; k++) if (fabs(right[k]) <= o->lost[k]) right[k] = 0.0;
}

/* The Jacobian of all rows but the aim into `kept`. */
static void linearised(const Work *o, const double *w, const double *normals, const Passage *q) {
  const Frame *f = o->f;
  const ptrdiff_t N = f->segments, n = o->n;
  double *a = o->kept, values[CONDITIONS + 1], slopes[(CONDITIONS + 1) * (D + 1 + FREE)];
  memset(a, 0, n * o->rows * sizeof(double));
  for (ptrdiff_t k = 0; k + 1 < N; k++) for (int i = 0; i < D; i++, a += n) {
    memcpy(a + k * D, q->phi + (k * D + i) * D, D * sizeof(double));
    a[(k + 1) * D + i] = -1.0;
    memcpy(a + o->cut, q->columns + (k * D + i) * TAILS, TAILS * sizeof(double));
  }
  for (ptrdiff_t r = 0; r < f->closing; r++, a += n) {
    const double *phi = q->phi + (N - 1) * D * D, *by = q->columns + (N - 1) * D * TAILS;
    for (int i = 0; i < D; i++) {
      double share = f->last[r * D + i];
      if (share == 0.0) continue;
      for (int j = 0; j < D; j++) a[(N - 1) * D + j] += share * phi[i * D + j];
      for (int j = 0; j < TAILS; j++) a[o->cut + j] += share * by[i * TAILS + j];
    }
    for (int j = 0; j < D; j++) a[j] += f->first[r * D + j];
  }
  if (f->phase) { memcpy(a, normals, o->cut * sizeof(double)); a += n; }
  conditioned(o, w, values, slopes);
  for (int k = 0; k < CONDITIONS; k++, a += n)
    for (int j = 0; j < D + 1 + FREE; j++) a[column_of(o, j)] = slopes[k * (D + 1 + FREE) + j];
}

static void measured(const Work *o, const double *scales) { /* columns into `scaled`, and the metric */
  const double *freed = scales + D + 1;
  for (ptrdiff_t k = 0; k < o->cut; k++) o->scaled[k] = scales[k % D];
  o->scaled[o->cut] = scales[D];
  for (int j = 0; j < UNFOLDING; j++) o->scaled[o->cut + 1 + j] = 1.0 / scales[D];
  for (int j = 0; j < FREE; j++) o->scaled[o->cut + 1 + UNFOLDING + j] = freed[j];
  for (ptrdiff_t k = 0; k < o->n; k++) o->metric[k] = 1.0 / (o->scaled[k] * o->scaled[k]);
  for (ptrdiff_t k = 0; k < o->cut; k++) o->metric[k] *= o->shares[k / D];
  for (int j = 0; j < UNFOLDING; j++) o->metric[o->cut + 1 + j] = 0.0;
}

static double apart(const Work *o, const double *a, const double *b) {
  double sum = 0;
  for (ptrdiff_t k = 0; k < o->n; k++) sum += o->metric[k] * (a[k] - b[k]) * (a[k] - b[k]);
  return sqrt(sum);
}

static double inner(const Work *o, const double *a, const double *b) {
  double sum = 0;
  for (ptrdiff_t k = 0; k < o->n; k++) sum += o->metric[k] * a[k] * b[k];
  return sum;
}

/* What rows are measured in, and what of them may be round-off, at the guess. */
static void row_units(const Work *o, const Standing *from, double level) {
  const Frame *f = o->f;
  double *unit = o->units, *lost = o->lost, values[CONDITIONS + 1], slopes[(CONDITIONS + 1) * (D + 1 + FREE)];
  memset(lost, 0, o->n * sizeof(double));
  for (ptrdiff_t k = 0; k < (f->segments - 1) * D; k++) *unit++ = o->scaled[k % D];
  for (ptrdiff_t r = 0; r < f->closing; r++) {
    double most = 0;
    for (int j = 0; j < D; j++) most = fmax(most, fmax(fabs(f->first[r * D + j]), fabs(f->last[r * D + j])) * o->scaled[j]);
    *unit++ = most;
  }
  if (f->phase) *unit++ = norm2(from->normals, o->scaled, o->cut);
  conditioned(o, o->guess, values, slopes);
  for (int k = 0; k < CONDITIONS; k++) {
    double sum = 0, size = 2 * fabs(f->values[k]);
    for (int j = 0; j < D + 1 + FREE; j++) {
      double slope = slopes[k * (D + 1 + FREE) + j];
      sum += slope * slope * o->scaled[column_of(o, j)] * o->scaled[column_of(o, j)];
      size += fabs(slope * o->guess[column_of(o, j)]);
    }
    lost[unit - o->units] = 2.220446049250313e-16 * size;
    *unit++ = sqrt(sum);
  }
  double size = 2 * fabs(level);
  for (ptrdiff_t k = 0; k < o->n; k++) size += fabs(o->normal[k] * o->guess[k]);
  lost[unit - o->units] = 2.220446049250313e-16 * size;
  *unit = norm2(o->normal, o->scaled, o->n);
  for (ptrdiff_t k = 0; k < o->n; k++) if (!(o->units[k] > 0)) o->units[k] = 1.0;
}

static int factored_with(const Work *o, const double *aim) {
  memcpy(o->matrix, o->kept, o->n * o->rows * sizeof(double));
  memcpy(o->matrix + o->n * o->rows, aim, o->n * sizeof(double));
  return eliminated(o->matrix, o->order, o->n, o->n, o->n);
}

/* Whether the mesh serves: no segment is steep; 2 where a step's error is stale, or the steps may be far too many. */
static int serves(const Work *o, const Passage *q, const double *scales) {
  const Frame *f = o->f;
  const ptrdiff_t M = f->segments * f->steps, every = (ptrdiff_t)f->sampled;
  double extent[D], most = 0, worst = 0, needed = 0, count = 0, steep = 0;
  for (int i = 0; i < D; i++) {
    extent[i] = 0;
    for (ptrdiff_t k = 0; k <= M; k++) extent[i] = fmax(extent[i], fabs(q->states[k * D + i]));
    extent[i] /= f->units[i];
    most = fmax(most, extent[i]);
  }
  for (ptrdiff_t k = 0; k < M; k++) {
    double error = 0;
    for (int i = 0; i < D; i++)
      error = fmax(error, fabs(o->errors[k * D + i]) / (f->units[i] * fmax(extent[i], most * 1e-2)));
    worst = fmax(worst, error);
    if (k % every == 0) { needed += pow(error / f->allowed, 0.125); count++; }
  }
  for (ptrdiff_t k = 0; k < f->segments * D * D; k++)
    steep = fmax(steep, fabs(q->phi[k]) * scales[k % D] / scales[k / D % D]);
  if (!(D * steep <= f->steepest) || !isfinite(worst)) return 0;
  return worst < f->stale * f->allowed && needed * f->spare >= count ? 1 : 2;
}

/* The sizes of the whole motion (see `loops.scales.sizes`). */
static void sized(const Work *o, const Passage *q, double period, double *sizes) {
  const Frame *f = o->f;
  const ptrdiff_t M = f->segments * f->steps, n = f->first_order ? D : D / 2;
  double low[D], high[D];
  for (int i = 0; i < D; i++) { low[i] = INFINITY; high[i] = -INFINITY; }
  for (ptrdiff_t m = 0; m < f->images; m++) {
    const double *map = f->maps + m * D * (D + 1), *moved = map + D * D;
    for (ptrdiff_t k = 0; k <= M; k++) for (int i = 0; i < D; i++) {
      double x = moved[i];
      for (int j = 0; j < D; j++) x += map[i * D + j] * q->states[k * D + j];
      low[i] = fmin(low[i], x); high[i] = fmax(high[i], x);
    }
  }
  for (int i = 0; i < D; i++) sizes[i] = (high[i] - low[i]) / sqrt(8.0);
  if (f->first_order) {
    double turning = 0, others = 0;
    for (int i = 0; i < D; i++) {
      high[i] = fmax(fabs(high[i]), fabs(low[i]));
      if (sizes[i] < f->unfelt * high[i]) sizes[i] = 0; else high[i] = 0; /* at round-off, or not */
      double size = sizes[i] / f->lengths[i];
      if (f->angular[i] != 0) turning = fmax(turning, size); else others = fmax(others, size);
    }
    for (int i = 0; i < D; i++) {
      double largest = f->angular[i] != 0 ? turning : others;
      if (high[i] > 0) sizes[i] = high[i];
      else if (!(largest > 0 && isfinite(largest))) sizes[i] = f->lengths[i];
      else if (!(sizes[i] / f->lengths[i] > f->still * largest)) sizes[i] = f->least_share * largest * f->lengths[i];
    }
    return;
  }
  double clock = period / 6.283185307179586, far = 0, fast = 0;
  for (ptrdiff_t i = 0; i < n; i++) { far = fmax(far, sizes[i] / f->lengths[i]); fast = fmax(fast, sizes[n + i] / f->lengths[i]); }
  double wide = fmax(far, f->least_share * fast * clock), quick = fmax(fast, f->least_share * far / clock);
  if (!(isfinite(wide) && wide > 0)) { wide = 1.0; quick = 1.0 / clock; }
  for (ptrdiff_t i = 0; i < n; i++) { sizes[i] = wide * f->lengths[i]; sizes[n + i] = quick * f->lengths[i]; }
}

/* (states D, period, free, largest D, lowest, highest, least) at the next motion; see `Scales.renewed`. */
static void renewed(const Work *o, const double *before, const double *sizes, const double *w, double *after) {
  const double *was = before + D + 1, *largest = was + FREE, *freed = w + o->cut + 1 + UNFOLDING;
  double *is = after + D + 1, *most = is + FREE;
  for (int i = 0; i < D; i++) {
    most[i] = fmax(largest[i], sizes[i]);
    after[i] = fmax(sizes[i], o->f->least_share * most[i]);
  }
  after[D] = w[o->cut];
  for (int j = 0; j < FREE; j++) {
    double low = fmin(largest[D + j], freed[j]), high = fmax(largest[D + FREE + j], freed[j]), least = largest[D + 2 * FREE + j];
    double size = fmax(fmax(fabs(freed[j]), high - low), least);
    most[D + j] = low; most[D + FREE + j] = high; most[D + 2 * FREE + j] = least;
    is[j] = size > 0 ? size : was[j];
  }
}

static void phased(const Work *o, const double *w, const double *scales, double *normals) {
  const Frame *f = o->f;
  double times[f->segments], sum = 0;
  if (!f->phase) return;
  memset(times, 0, sizeof times);
  rates_at(w, times, w + o->cut, f->segments, normals);
  for (ptrdiff_t k = 0; k < o->cut; k++) {
    normals[k] *= o->shares[k / D] / (scales[k % D] * scales[k % D]);
    sum += normals[k] * scales[k % D] * normals[k] * scales[k % D];
  }
  sum = sum > 0 ? sqrt(sum) : 1.0;
  for (ptrdiff_t k = 0; k < o->cut; k++) normals[k] /= sum;
}

static int corrected(const Work *o, const Standing *from, const Standing *to, const Passage *q, double length, double level) {
  const Frame *f = o->f;
  double previous = INFINITY, *w = q->marched;
  int again = 0; /* a last step so long that what was integrated along w is not yet that of the orbit is followed by another */
  memcpy(w, o->guess, o->n * sizeof(double));
  for (int iteration = 0; iteration < f->iterations; iteration++) {
    q->facts[5] = marched(o, w, q);
    rows_of(o, w, from, q, level, o->right);
    double largest = 0;
    for (ptrdiff_t k = 0; k < o->n; k++) {
      double size = fabs(o->right[k] / o->units[k]);
      if (!(size <= largest)) largest = size;
    }
    int ready = again || largest < f->ready || (largest < f->floor && largest > f->contraction * previous);
    if (!isfinite(largest) || (iteration > 2 && largest > f->stall * previous && !ready)) return 0;
    linearised(o, w, from->normals, q);
    if (!factored_with(o, o->normal)) return 0;
    solved(o->matrix, o->order, o->right, o->n);
    for (ptrdiff_t k = 0; k < o->n; k++) { to->w[k] = w[k] - o->right[k]; if (!isfinite(to->w[k])) return 0; }
    if (ready) {
      q->facts[3] = largest;
      q->facts[4] = apart(o, to->w, w);
      if (again++ || q->facts[4] < f->stepped) return 1;
    }
    if (!(apart(o, to->w, o->guess) < 0.5 * length + 1e-9) || !(to->w[o->cut] > 0)) return 0;
    memcpy(w, to->w, o->n * sizeof(double));
    previous = largest;
  }
  return 0;
}

/* Scales, phase, Jacobian, tangent and bend at a point that was accepted. */
static int accepted(const Work *o, const Standing *from, const Standing *to, const Passage *q) {
  double sizes[D], unit, along;
  sized(o, q, to->w[o->cut], sizes);
  renewed(o, from->scales, sizes, to->w, to->scales);
  phased(o, to->w, to->scales, to->normals);
  measured(o, to->scales);
  linearised(o, to->w, to->normals, q);
  for (ptrdiff_t k = 0; k < o->n; k++) o->normal[k] = o->metric[k] * q->raw[k];
  if (!factored_with(o, o->normal)) return 0;
  memset(to->tangent, 0, o->n * sizeof(double));
  to->tangent[o->n - 1] = 1.0;
  solved(o->matrix, o->order, to->tangent, o->n);
  unit = 1.0 / sqrt(inner(o, to->tangent, to->tangent));
  for (ptrdiff_t k = 0; k < o->n; k++) { to->tangent[k] *= unit; to->bend[k] = from->w[k] - to->w[k]; }
  along = inner(o, to->tangent, to->bend);
  for (ptrdiff_t k = 0; k < o->n; k++)
    to->bend[k] = fabs(along) > 1e-9 ? (to->bend[k] - along * to->tangent[k]) / (along * along) : 0.0;
  return 1;
}

/* The point after one; 0 where the driver must see to it, 2 where to its mesh alone. */
static int stepped(const Work *o, const Standing *from, const Standing *to, const Passage *q) {
  const Frame *f = o->f;
  double length = *from->length, level, turn, stretch, missed;
  measured(o, from->scales);
  for (ptrdiff_t k = 0; k < o->n; k++) {
    o->guess[k] = from->w[k] + (length * from->tangent[k] + length * length * from->bend[k]);
    o->normal[k] = o->metric[k] * from->tangent[k];
  }
  level = length;
  for (ptrdiff_t k = 0; k < o->n; k++) level += o->normal[k] * from->w[k];
  row_units(o, from, level);
  if (!corrected(o, from, to, q, length, level)) return 0;
  memset(q->raw, 0, o->n * sizeof(double));
  q->raw[o->n - 1] = 1.0;
  solved(o->matrix, o->order, q->raw, o->n);
  double unit = 1.0 / sqrt(inner(o, q->raw, q->raw));
  for (ptrdiff_t k = 0; k < o->n; k++) { q->raw[k] *= unit; if (!isfinite(q->raw[k])) return 0; }
  memcpy(q->jacobian, o->kept, o->n * o->rows * sizeof(double));
  turn = acos(fmax(-1.0, fmin(1.0, inner(o, from->tangent, q->raw))));
  stretch = fabs(to->w[o->cut] / from->w[o->cut] - 1.0);
  if (!(turn <= f->sharpest) || (stretch > f->stretch && length > 1e-4)) return 0;
  int fits = serves(o, q, from->scales);
  if (!fits) return 0;
  missed = apart(o, o->guess, to->w);
  q->facts[0] = turn; q->facts[1] = stretch; q->facts[2] = missed;
  double bendable = fmin(0.4 * f->sharpest / fmax(turn, 1e-9), 0.6 * f->stretch / fmax(stretch, 1e-9));
  double ease = fmax(0.5, fmin(1.5, pow(f->prediction / fmax(missed, 1e-12), 1.0 / 3)));
  *to->length = fmin(f->longest, length * fmin(ease, fmax(0.5, bendable)));
  q->facts[6] = fits == 1;
  return accepted(o, from, to, q) ? fits : 0;
}

/* A point whose w, tangent and place of its march are known already. */
static int replayed(const Work *o, const Standing *from, const Standing *to, const Passage *q) {
  measured(o, from->scales);
  q->facts[3] = 0.0;
  q->facts[4] = apart(o, to->w, q->marched);
  q->facts[5] = marched(o, q->marched, q);
  if (!accepted(o, from, to, q)) return 0;
  memcpy(q->jacobian, o->kept, o->n * o->rows * sizeof(double));
  return 1;
}

/* Up to `count` points after the first row of `standing` (count + 1 rows each); how many there are. `known` are those
   of which w, tangent and march were given. */
ptrdiff_t advance(const Frame *f, ptrdiff_t count, int known, double *const *standing, double *const *passage) {
  const ptrdiff_t N = f->segments, M = N * f->steps, cut = N * D, n = cut + TAILS, rows = n - 1, wide = 2 * D + 1 + 4 * FREE;
  const ptrdiff_t before[] = {n, n, n, wide, cut, 1}, on[] = {n, n, N * D, N * D * D, N * D * TAILS, (M + 1) * D, rows * n, 7};
  ptrdiff_t made = 0, size = n * n + rows * n + 8 * n + M * D + N;
  double *space = malloc(size * sizeof(double)), *p = space;
  ptrdiff_t *order = malloc(n * sizeof(ptrdiff_t));
  void *memory = malloc((2 * HELD + ROOM) * sizeof(V) + 64);
  if (space && order && memory) {
    Work o = {f, n, cut, rows, 0};
    double **parts[] = {&o.right, &o.guess, &o.units, &o.lost, &o.metric, &o.scaled, &o.normal};
    o.order = order;
    o.z = (V *)(((uintptr_t)memory + 63) & ~(uintptr_t)63);
    o.work = o.z + 2 * HELD;
    o.matrix = p; p += n * n;
    o.kept = p; p += rows * n;
    for (int k = 0; k < 7; k++, p += n) *parts[k] = p;
    o.errors = p; p += M * D;
    o.shares = p;
    for (ptrdiff_t k = 0; k < N; k++) {
      ptrdiff_t last = (k + N - 1) % N;
      o.shares[k] = 0.5 * (f->mesh[(k + 1) * f->steps] - f->mesh[k * f->steps] + f->mesh[(last + 1) * f->steps]
        - f->mesh[last * f->steps]) / (f->mesh[M] - f->mesh[0]);
    }
    if (!known) phased(&o, standing[0], standing[3], standing[4]);
    for (; made < count; made++) {
      double *s[12], *q[8];
      for (int k = 0; k < 6; k++) { s[k] = standing[k] + made * before[k]; s[6 + k] = s[k] + before[k]; }
      for (int k = 0; k < 8; k++) q[k] = passage[k] + made * on[k];
      Standing from = {s[0], s[1], s[2], s[3], s[4], s[5]}, to = {s[6], s[7], s[8], s[9], s[10], s[11]};
      Passage way = {q[0], q[1], q[2], q[3], q[4], q[5], q[6], q[7]};
      int fits = (known ? replayed : stepped)(&o, &from, &to, &way);
      if (fits != 1) { made += fits == 2; break; }
    }
  }
  free(space);
  free(order);
  free(memory);
  return made;
}
