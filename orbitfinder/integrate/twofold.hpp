/* casadi_real as the sum of two doubles: operations lose some 2^-104, three to four times as fast as _Float128, whose
   functions are used where there is no operation. Source: T. J. Dekker,
   A floating-point technique for extending the available precision, Numerische Mathematik 18 (1971) 224-242. */
#include <math.h>

struct Twofold {
  double high, low;
  Twofold() = default;
  Twofold(double x) : high(x), low(0) {}
  Twofold(double x, double rest) : high(x), low(rest) {}
  template <class T> Twofold(T x) : high((double)x), low((double)(x - (T)high)) {}
  explicit operator bool() const { return high != 0; }
  explicit operator long double() const { return (long double)high + low; }
  __float128 whole() const { return (__float128)high + low; }
  Twofold operator-() const { return {-high, -low}; }
};
static inline Twofold joined(double x, double rest) { const double sum = x + rest; return {sum, rest - (sum - x)}; }
static inline Twofold operator+(Twofold a, Twofold b) {
  const double sum = a.high + b.high, part = sum - a.high, lows = a.low + b.low, other = lows - a.low;
  const Twofold both = joined(sum, (a.high - (sum - part)) + (b.high - part) + lows);
  return joined(both.high, both.low + ((a.low - (lows - other)) + (b.low - other)));
}
static inline Twofold operator-(Twofold a, Twofold b) { return a + -b; }
static inline Twofold operator*(Twofold a, Twofold b) {
  const double product = a.high * b.high;
  return joined(product, __builtin_fma(a.high, b.high, -product) + (a.high * b.low + a.low * b.high));
}
static inline Twofold operator/(Twofold a, Twofold b) {
  const double first = a.high / b.high;
  const Twofold rest = a - b * Twofold(first);
  const double second = rest.high / b.high;
  return joined(first, second) + Twofold((rest - b * Twofold(second)).high / b.high);
}
static inline Twofold sqrt(Twofold a) {
  const double root = sqrt(a.high);
  return a.high > 0 ? joined(root, (a - Twofold(root) * Twofold(root)).high / (2 * root)) : Twofold(root);
}
static inline Twofold fabs(Twofold a) { return a.high < 0 ? -a : a; }
#define COMPARED(OP) static inline bool operator OP(Twofold a, Twofold b) { return (a - b).high OP 0; }
COMPARED(<) COMPARED(<=) COMPARED(>) COMPARED(>=) COMPARED(==) COMPARED(!=)
#define CHANGED(OP) static inline Twofold &operator OP##=(Twofold &a, Twofold b) { return a = a OP b; }
CHANGED(+) CHANGED(-) CHANGED(*) CHANGED(/)
#define WHOLE(NAME) static inline Twofold NAME(Twofold a) { return NAME##f128(a.whole()); }
WHOLE(sin) WHOLE(cos) WHOLE(tan) WHOLE(asin) WHOLE(acos) WHOLE(atan) WHOLE(sinh) WHOLE(cosh) WHOLE(tanh) WHOLE(asinh)
WHOLE(acosh) WHOLE(atanh) WHOLE(exp) WHOLE(expm1) WHOLE(log) WHOLE(log1p) WHOLE(erf) WHOLE(floor) WHOLE(ceil)
#define WHOLES(NAME) static inline Twofold NAME(Twofold a, Twofold b) { return NAME##f128(a.whole(), b.whole()); }
WHOLES(pow) WHOLES(atan2) WHOLES(fmod) WHOLES(fmin) WHOLES(fmax) WHOLES(hypot) WHOLES(copysign)
#define casadi_real Twofold
