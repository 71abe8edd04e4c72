/* What every march in lanes needs: vectors of doubles, their functions, and Dormand and Prince's steps of order 8.

   Segments come in eights. A register holds 8, 4, 2 or 1 of them; each lane computes the same numbers, whatever stands
   beside it and however wide the register is: every operation is IEEE's on that lane alone, nothing is contracted. */
#include <math.h>
#include <stdint.h>
#include <stddef.h>
#include <stdlib.h>

#ifndef LANES
#if defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#elif defined(__SSE2__) || defined(__ARM_NEON)
#define LANES 2
#else
#define LANES 1
#endif
#endif

typedef double V __attribute__((vector_size(8 * LANES)));
typedef int64_t I __attribute__((vector_size(8 * LANES)));
#ifdef __OPTIMIZE__
#define INLINE static inline __attribute__((always_inline))
#else /* as at -O0 a sine would be written out 26 times for what takes as long */
#define INLINE static inline
#endif

INLINE V all(double x) { V v; for (int l = 0; l < LANES; l++) v[l] = x; return v; }
INLINE V kept(I mask, V x) { return (V)(mask & (I)x); }
INLINE V truth(I mask) { return kept(mask, all(1.0)); }
INLINE V chosen(I mask, V x, V y) { return (V)((mask & (I)x) | (~mask & (I)y)); }
INLINE V absolute(V x) { return (V)((I)x & INT64_MAX); }

#define EACH1(NAME, FUNCTION) INLINE V NAME(V x) { V v; for (int l = 0; l < LANES; l++) v[l] = FUNCTION(x[l]); return v; }
#define EACH2(NAME, FUNCTION) \
  INLINE V NAME(V x, V y) { V v; for (int l = 0; l < LANES; l++) v[l] = FUNCTION(x[l], y[l]); return v; }
static double sign(double x) { return x < 0 ? -1 : x > 0 ? 1 : x; }
EACH1(v_sqrt, sqrt) EACH1(v_exp, exp) EACH1(v_log, log) EACH1(v_tan, tan) EACH1(v_asin, asin) EACH1(v_acos, acos)
EACH1(v_atan, atan) EACH1(v_floor, floor) EACH1(v_ceil, ceil) EACH1(v_erf, erf) EACH1(v_sinh, sinh)
EACH1(v_cosh, cosh) EACH1(v_tanh, tanh) EACH1(v_asinh, asinh) EACH1(v_acosh, acosh) EACH1(v_atanh, atanh)
EACH1(v_sign, sign) EACH1(v_log1p, log1p) EACH1(v_expm1, expm1)
EACH2(v_pow, pow) EACH2(v_fmod, fmod) EACH2(v_copysign, copysign) EACH2(v_fmin, fmin) EACH2(v_fmax, fmax)
EACH2(v_atan2, atan2) EACH2(v_hypot, hypot) EACH2(v_remainder, remainder)

/* sin and cos: x = k pi/2 + r, |r| <= pi/4, with pi/2 in three parts, and the minimax polynomials of fdlibm
   (e_rem_pio2.c, k_sin.c, k_cos.c; Sun Microsystems, 1993: free to use with this notice). Good to 1.5 ulp up to FAR;
   beyond, libm's, lane by lane. */
#define FAR 1e5

INLINE V reduced(V x, I *quadrant) {
  const V magic = all(6755399441055744.0);
  V k = x * 6.36619772367581382433e-01 + magic;
  *quadrant = (I)k;
  k -= magic;
  V r = x - k * 1.57079632673412561417e+00, w = k * 6.07710050630396597660e-11, s = r - w;
  return s + (((r - s) - w) - k * 2.02226624879595063154e-21);
}

INLINE V sine(V r) {
  V z = r * r;
  return r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04
    + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
}

INLINE V cosine(V r) {
  V z = r * r, h = 0.5 * z, w = 1.0 - h;
  return w + ((1.0 - w) - h + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03
    + z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09
    + z * -1.13596475577881948265e-11))))));
}

INLINE V turned(V x, int64_t quarter) {
  I q;
  V r = reduced(x, &q);
  q += quarter;
  return (V)((I)chosen(-(q & 1), cosine(r), sine(r)) ^ ((q & 2) << 62));
}

INLINE int beyond(V x) {
  I far = absolute(x) > FAR;
  int64_t any = 0;
  for (int l = 0; l < LANES; l++) any |= far[l];
  return any != 0;
}

#define TURNING(NAME, FUNCTION, QUARTER) \
  static __attribute__((noinline, cold)) V NAME##_far(V x, V v) { \
    for (int l = 0; l < LANES; l++) if (fabs(x[l]) > FAR) v[l] = FUNCTION(x[l]); \
    return v; \
  } \
  INLINE V NAME(V x) { \
    V v = turned(x, QUARTER); \
    return __builtin_expect(beyond(x), 0) ? NAME##_far(x, v) : v; \
  }
TURNING(v_sin, sin, 0)
TURNING(v_cos, cos, 1)

/* What a step is wrong by, from its errors of fifth and third order. */
#define ESTIMATE(KIND) INLINE KIND estimate_##KIND(KIND fifth, KIND third) { \
    KIND square = fifth * fifth, v = square + 0.01 * (third * third) + LEAST; \
    for (unsigned l = 0; l < sizeof(KIND) / 8; l++) v[l] = sqrt(v[l]); \
    return square / v; \
  }
ESTIMATE(V)

/* Columns that a march of variations moves at a time: BESIDE of them in TOGETHER registers W, each of a column of LANES
   segments, or of one segment's eight columns. COLUMN_OF and NUMBER are the numbers of one column. */
#if LANES == 1
typedef double W __attribute__((vector_size(64)));
#ifndef ABREAST
#define ABREAST 1
#endif
INLINE W spread(double x) { return (W){x, x, x, x, x, x, x, x}; }
#define TOGETHER ABREAST
#define BESIDE (8 * TOGETHER)
#define SPREAD(v) spread((v)[0])
#define COLUMN_OF(w, i, c) (w)[(i) * TOGETHER + (c) / 8][(c) % 8]
#define NUMBER(v) (v)[0]
ESTIMATE(W)
#else
typedef V W;
#define TOGETHER 4
#define BESIDE 4
#define SPREAD(v) (v)
#define COLUMN_OF(w, i, c) (w)[(i) * TOGETHER + (c)]
#define NUMBER(v) (v)
#define estimate_W estimate_V
#endif
#define BLOCK (STATE * TOGETHER)
#define MOVING ((STATE - PLACED) * TOGETHER)
#define FORCING (1 + STATE * (COLUMNS - STATE))
static void product(W *restrict, const V *restrict, const V *restrict, W *restrict, int);
