/* Lagrange's equations of an open chain in absolute angles, and their variations, as a field for dop853.c.

   Off its diagonal OWN the coupling is m_ij = SHORT_i HEAVY_j for i < j: with it products with m and the solution of
   M a = r, M_ij = m_ij cos(q_i - q_j), take a number of operations that is proportional to LINKS. M is semiseparable of
   rank 2, its factors L D L^T those of D. Foreman-Mackey, E. Agol, S. Ambikasaran, R. Angus, Astronomical Journal 154
   (2017) 220. Above this stand LINKS, COLUMNS (of variations, 0 or 2 LINKS), OWN, SHORT, HEAVY and WEIGHTS. */
#include <math.h>
#include <stddef.h>
#define casadi_int long long int
#define LANES 16
#define LINK(K) for (int K = 0; K < LINKS; K++)
#define UP(K) for (int K = LINKS - 1; K >= 0; K--)
#define LANE for (int l = 0; l < LANES; l++)

typedef double Row[LANES];

/* What solutions with M need: cos, sin, D, and the s2 columns that L is made of. */
typedef struct { double c[LINKS], s[LINKS], d[LINKS], along[LINKS], across[LINKS]; } Factors;

static void factorised(Factors *f, const double *q) {
  double aa = 0.0, ab = 0.0, bb = 0.0;
  LINK(i) {
    double c = f->c[i] = cos(q[i]), s = f->s[i] = sin(q[i]), u = HEAVY[i] * c, v = HEAVY[i] * s;
    double left = aa * u + ab * v, right = ab * u + bb * v, d = f->d[i] = OWN[i] - (u * left + v * right);
    double along = f->along[i] = (SHORT[i] * c - left) / d, across = f->across[i] = (SHORT[i] * s - right) / d;
    aa += d * along * along, ab += d * along * across, bb += d * across * across;
  }
}

/* m (x, y), for one column each. */
static void coupled(const double *x, const double *y, double *mx, double *my) {
  double a = 0.0, b = 0.0;
  LINK(i) {
    mx[i] = HEAVY[i] * a + OWN[i] * x[i], my[i] = HEAVY[i] * b + OWN[i] * y[i];
    a += SHORT[i] * x[i], b += SHORT[i] * y[i];
  }
  a = b = 0.0;
  UP(i) {
    mx[i] += SHORT[i] * a, my[i] += SHORT[i] * b;
    a += HEAVY[i] * x[i], b += HEAVY[i] * y[i];
  }
}

static void accelerations(const Factors *f, const double *v, double *a) {
  double x[LINKS], y[LINKS], mx[LINKS], my[LINKS];
  LINK(i) x[i] = f->c[i] * v[i] * v[i], y[i] = f->s[i] * v[i] * v[i];
  coupled(x, y, mx, my);
  double s1 = 0.0, s2 = 0.0;
  LINK(i) {
    double c = f->c[i], s = f->s[i];
    a[i] = c * my[i] - s * (mx[i] + WEIGHTS[i]) - HEAVY[i] * (c * s1 + s * s2);
    s1 += f->along[i] * a[i], s2 += f->across[i] * a[i];
  }
  s1 = s2 = 0.0;
  UP(i) {
    a[i] = a[i] / f->d[i] - (f->along[i] * s1 + f->across[i] * s2);
    s1 += HEAVY[i] * f->c[i] * a[i], s2 += HEAVY[i] * f->s[i] * a[i];
  }
}

#if COLUMNS
/* Y' of some columns (from `first` on) of Y, which are stored one after another: the slopes of M a + h at fixed a are
   s m (alpha Y_q + beta Y_v) - c m (gamma Y_q + delta Y_v) + own Y_q. */
static void varied(const Factors *f, const double *v, const double *a, const double *y, double *rate, int first) {
  Row q[LINKS], w[LINKS], r[LINKS];
  double alpha[LINKS], beta[LINKS], gamma[LINKS], delta[LINKS], ma[LINKS], mg[LINKS];
  const int count = COLUMNS - first < LANES ? COLUMNS - first : LANES;
  LINK(i) LANE {
    const double *column = y + (ptrdiff_t)(first + (l < count ? l : 0)) * 2 * LINKS;
    q[i][l] = column[i], w[i][l] = column[LINKS + i];
  }
  LINK(i) {
    double c = f->c[i], s = f->s[i], square = v[i] * v[i];
    alpha[i] = c * a[i] - s * square, gamma[i] = s * a[i] + c * square;
    beta[i] = 2.0 * c * v[i], delta[i] = 2.0 * s * v[i];
  }
  coupled(alpha, gamma, ma, mg);
  Row s1 = {0}, s2 = {0};
  UP(i) LANE {  /* what is farther out */
    double x = alpha[i] * q[i][l] + beta[i] * w[i][l], z = gamma[i] * q[i][l] + delta[i] * w[i][l];
    double own = f->c[i] * (WEIGHTS[i] + mg[i]) - f->s[i] * ma[i] - OWN[i] * v[i] * v[i];
    r[i][l] = own * q[i][l] + SHORT[i] * (f->s[i] * s1[l] - f->c[i] * s2[l]);
    s1[l] += HEAVY[i] * x, s2[l] += HEAVY[i] * z;
  }
  Row s3 = {0}, s4 = {0};
  LANE s1[l] = s2[l] = 0.0;
  LINK(i) LANE {  /* what is nearer, and L z = -r */
    double c = f->c[i], s = f->s[i];
    double x = alpha[i] * q[i][l] + beta[i] * w[i][l], z = gamma[i] * q[i][l] + delta[i] * w[i][l];
    r[i][l] = -r[i][l] - HEAVY[i] * (s * s1[l] - c * s2[l]) - HEAVY[i] * (c * s3[l] + s * s4[l]);
    s1[l] += SHORT[i] * x, s2[l] += SHORT[i] * z;
    s3[l] += f->along[i] * r[i][l], s4[l] += f->across[i] * r[i][l];
  }
  LANE s3[l] = s4[l] = 0.0;
  UP(i) LANE {
    r[i][l] = r[i][l] / f->d[i] - (f->along[i] * s3[l] + f->across[i] * s4[l]);
    s3[l] += HEAVY[i] * f->c[i] * r[i][l], s4[l] += HEAVY[i] * f->s[i] * r[i][l];
  }
  for (int l = 0; l < count; l++) LINK(i) {
    double *column = rate + (ptrdiff_t)(first + l) * 2 * LINKS;
    column[i] = w[i][l], column[LINKS + i] = r[i][l];
  }
}
#endif

static int evaluated(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  const double *q = arg[1], *v = q + LINKS;
  double *rate = res[0];
  Factors f;
  factorised(&f, q);
  LINK(i) rate[i] = v[i];
  accelerations(&f, v, rate + LINKS);
#if COLUMNS
  for (int k = 0; k < COLUMNS; k += LANES)
    varied(&f, v, rate + LINKS, q + 2 * LINKS, rate + 2 * LINKS, k);
#endif
  return 0;
}

static int evaluated_work(casadi_int *arg, casadi_int *res, casadi_int *iw, casadi_int *w) {
  *arg = 2, *res = 1, *iw = 0, *w = 0;
  return 0;
}
