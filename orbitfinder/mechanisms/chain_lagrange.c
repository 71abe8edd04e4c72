/* Lagrange's equations of an open chain in absolute angles, and their variations, as a field for dop853.c.

   Off its diagonal OWN the coupling is m_ij = SHORT_i HEAVY_j for i < j: with it products with m and the solution of
   M a = r, M_ij = m_ij cos(q_i - q_j), take a number of operations that is proportional to LINKS. M is semiseparable of
   rank 2, its factors L D L^T those of D. Foreman-Mackey, E. Agol, S. Ambikasaran, R. Angus, Astronomical Journal 154
   (2017) 220. Above this stand LINKS, LANES, GROUP (of so many columns that are varied, 0 of none), OWN, SHORT, HEAVY and WEIGHTS. */
#include <math.h>
#include <stddef.h>
#define casadi_int long long int
#define LINK(K) for (int K = 0; K < LINKS; K++)
#define UP(K) for (int K = LINKS - 1; K >= 0; K--)

typedef double Row __attribute__((vector_size(8 * LANES), aligned(8)));

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

#if GROUP
/* Y' of Y (2 LINKS rows): the slopes of M a + h at fixed a are s m (alpha Y_q + beta Y_v) - c m (gamma Y_q + delta Y_v) +
   own Y_q. */
#define EVERY for (int g = 0; g < GROUP; g++)
static void varied(const Factors *f, const double *v, const double *a, const Row *q, Row *rate) {
  const Row *w = q + LINKS * GROUP;
  Row *r = rate + LINKS * GROUP;
  double alpha[LINKS], beta[LINKS], gamma[LINKS], delta[LINKS], ma[LINKS], mg[LINKS];
  LINK(i) {
    double c = f->c[i], s = f->s[i], square = v[i] * v[i];
    alpha[i] = c * a[i] - s * square, gamma[i] = s * a[i] + c * square;
    beta[i] = 2.0 * c * v[i], delta[i] = 2.0 * s * v[i];
  }
  coupled(alpha, gamma, ma, mg);
  const Row none = {0};
  Row s1[GROUP], s2[GROUP], s3[GROUP], s4[GROUP];
  EVERY s1[g] = s2[g] = none;
  UP(i) {  /* what is farther out */
    double own = f->c[i] * (WEIGHTS[i] + mg[i]) - f->s[i] * ma[i] - OWN[i] * v[i] * v[i];
    double sine = SHORT[i] * f->s[i], cosine = SHORT[i] * f->c[i];
    EVERY {
      const Row p = q[i * GROUP + g], u = w[i * GROUP + g];
      r[i * GROUP + g] = own * p + (sine * s1[g] - cosine * s2[g]);
      s1[g] += HEAVY[i] * (alpha[i] * p + beta[i] * u), s2[g] += HEAVY[i] * (gamma[i] * p + delta[i] * u);
    }
  }
  EVERY s1[g] = s2[g] = s3[g] = s4[g] = none;
  LINK(i) {  /* what is nearer, and L z = -r */
    double sine = HEAVY[i] * f->s[i], cosine = HEAVY[i] * f->c[i];
    EVERY {
      const Row p = q[i * GROUP + g], u = w[i * GROUP + g];
      const Row z = cosine * (s2[g] - s3[g]) - sine * (s1[g] + s4[g]) - r[i * GROUP + g];
      s1[g] += SHORT[i] * (alpha[i] * p + beta[i] * u), s2[g] += SHORT[i] * (gamma[i] * p + delta[i] * u);
      s3[g] += f->along[i] * z, s4[g] += f->across[i] * z;
      r[i * GROUP + g] = z;
    }
  }
  EVERY s3[g] = s4[g] = none;
  UP(i) {
    double part = 1.0 / f->d[i], sine = HEAVY[i] * f->s[i], cosine = HEAVY[i] * f->c[i];
    EVERY {
      const Row z = r[i * GROUP + g] * part - (f->along[i] * s3[g] + f->across[i] * s4[g]);
      s3[g] += cosine * z, s4[g] += sine * z;
      r[i * GROUP + g] = z, rate[i * GROUP + g] = w[i * GROUP + g];
    }
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
#if GROUP
  varied(&f, v, rate + LINKS, (const Row *)(v + LINKS), (Row *)(rate + 2 * LINKS));
#endif
  return 0;
}

static int evaluated_work(casadi_int *arg, casadi_int *res, casadi_int *iw, casadi_int *w) {
  *arg = 2, *res = 1, *iw = 0, *w = 0;
  return 0;
}
