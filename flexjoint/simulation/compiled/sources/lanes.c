/* The numbers of a step, fj_real: a double, or, where FJ_MANY is defined, as many doubles as the processor's
   registers hold, each (a lane) of a rollout of its own. No lane sees another one. Generated code and the other
   files are written in fj_real; what C has for doubles only, comparisons and functions, is here by lanes.

   A logical value is 1.0 or 0.0 in generated code, as CasADi has it; elsewhere a fj_mask, of a lane all bits or
   none. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#define casadi_real fj_real

#ifndef FJ_MANY
#define FJ_LANES 1
#define FJ_AT(x, i, lane) ((x)[i])
#define FJ_HAS(mask, lane) (mask)
typedef double fj_real;
typedef int fj_mask;
#define FJ_NOT(mask) (!(mask))
static inline double fj_all(double x) { return x; }
static inline double fj_pick(fj_mask mask, double yes, double no) { return mask ? yes : no; }
static inline int fj_any(fj_mask mask) { return mask; }
static inline double fj_abs(double x) { return fabs(x); }
#else

#if defined(__AVX512F__)
#define FJ_LANES 8
#elif defined(__AVX__)
#define FJ_LANES 4
#else
#define FJ_LANES 2
#endif
#define FJ_AT(x, i, lane) ((x)[i][lane])
#define FJ_HAS(mask, lane) ((mask)[lane] != 0)
typedef double fj_real __attribute__((vector_size(8 * FJ_LANES)));
typedef long long fj_mask __attribute__((vector_size(8 * FJ_LANES)));
#define FJ_NOT(mask) (~(mask))

static inline fj_real fj_all(double x) { return (fj_real){0.0} + x; }
static inline fj_mask fj_bits(fj_real x) {
  fj_mask bits;
  memcpy(&bits, &x, sizeof bits);
  return bits;
}
static inline fj_real fj_number(fj_mask bits) {
  fj_real x;
  memcpy(&x, &bits, sizeof x);
  return x;
}
static inline fj_real fj_pick(fj_mask mask, fj_real yes, fj_real no) {
  return fj_number((mask & fj_bits(yes)) | (~mask & fj_bits(no)));
}
static inline int fj_any(fj_mask mask) {
  long long any = 0;
  int lane;
  for (lane = 0; lane < FJ_LANES; lane++) any |= mask[lane];
  return any != 0;
}
static inline fj_real fj_abs(fj_real x) { return fj_number(fj_bits(x) & 0x7fffffffffffffffLL); }

/* ---- operators of generated code */
static inline fj_real fj_one_if(fj_mask mask) { return fj_number(mask & fj_bits(fj_all(1.0))); }
static inline fj_real fj_lt(fj_real a, fj_real b) { return fj_one_if(a < b); }
static inline fj_real fj_le(fj_real a, fj_real b) { return fj_one_if(a <= b); }
static inline fj_real fj_eq(fj_real a, fj_real b) { return fj_one_if(a == b); }
static inline fj_real fj_ne(fj_real a, fj_real b) { return fj_one_if(a != b); }
static inline fj_real fj_not(fj_real a) { return fj_one_if(a == 0.0); }
static inline fj_real fj_and(fj_real a, fj_real b) { return fj_one_if((a != 0.0) & (b != 0.0)); }
static inline fj_real fj_or(fj_real a, fj_real b) { return fj_one_if((a != 0.0) | (b != 0.0)); }
static inline fj_real fj_if(fj_real a, fj_real x) { return fj_number((a != 0.0) & fj_bits(x)); }

/* ---- functions of generated code; a NaN beside a number is left out of fmin and fmax, as in C */
static inline fj_real fj_sq(fj_real x) { return x * x; }
static inline fj_real fj_fabs(fj_real x) { return fj_abs(x); }
static inline fj_real fj_fmin(fj_real a, fj_real b) { return fj_pick((a < b) | (b != b), a, b); }
static inline fj_real fj_fmax(fj_real a, fj_real b) { return fj_pick((a > b) | (b != b), a, b); }
static inline fj_real fj_sign(fj_real x) {
  return fj_pick(x < 0.0, fj_all(-1.0), fj_pick(x > 0.0, fj_all(1.0), x));
}

#define FJ_EACH(name)                                                 \
  static fj_real fj_##name(fj_real x) {                               \
    int lane;                                                         \
    for (lane = 0; lane < FJ_LANES; lane++) x[lane] = name(x[lane]); \
    return x;                                                         \
  }
#define FJ_EACH_OF_TWO(name)                                                   \
  static fj_real fj_##name(fj_real x, fj_real y) {                            \
    int lane;                                                                  \
    for (lane = 0; lane < FJ_LANES; lane++) x[lane] = name(x[lane], y[lane]); \
    return x;                                                                  \
  }
FJ_EACH(sqrt)
FJ_EACH(exp)
FJ_EACH(log)
FJ_EACH(expm1)
FJ_EACH(log1p)
FJ_EACH(tan)
FJ_EACH(asin)
FJ_EACH(acos)
FJ_EACH(atan)
FJ_EACH(sinh)
FJ_EACH(cosh)
FJ_EACH(tanh)
FJ_EACH(asinh)
FJ_EACH(acosh)
FJ_EACH(atanh)
FJ_EACH(erf)
FJ_EACH(floor)
FJ_EACH(ceil)
FJ_EACH_OF_TWO(pow)
FJ_EACH_OF_TWO(atan2)
FJ_EACH_OF_TWO(fmod)
FJ_EACH_OF_TWO(hypot)
FJ_EACH_OF_TWO(copysign)

/* Sine and cosine, a joint's most frequent functions, in all lanes at once: x less the nearest multiple k of
   pi/2, of which three parts are subtracted (Cody and Waite, 1980), and the polynomials of Sun's fdlibm
   (k_sin.c, k_cos.c, 1993) for the rest y0 + y1, below 1 unit in the last place. k times the first two parts
   is exact up to 1e5; lanes beyond it, or not finite, take the C library's. */
static __attribute__((noinline)) void fj_sincos(fj_real x, fj_real *sine, fj_real *cosine) {
  const double round = 0x1.8p52; /* added, it leaves the nearest whole number in the last bits */
  fj_real shifted = x * 0x1.45f306dc9c883p-1 + round, k = shifted - round;
  fj_mask turn = fj_bits(shifted), odd = -(turn & 1), beyond = ~(fj_abs(x) <= 1e5);
  fj_real less = x - k * 0x1.921fb544p+0, second = k * 0x1.0b4611a6p-34, rest = less - second;
  fj_real third = k * 0x1.3198a2e037073p-69 - ((less - rest) - second);
  fj_real y0 = rest - third, y1 = (rest - y0) - third, z = y0 * y0, z2 = z * z, v = z * y0, half = 0.5 * z;
  fj_real s = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * 2.75573137070700676789e-06) +
              z * z2 * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10);
  fj_real c =
      z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * 2.48015872894767294178e-05)) +
      z2 * z2 *
          (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11));
  fj_real near = 1.0 - half;
  s = y0 - ((z * (0.5 * y1 - v * s) - y1) + v * 1.66666666666666324348e-01);
  c = near + (((1.0 - near) - half) + (z * c - y0 * y1));
  *sine = fj_number(fj_bits(fj_pick(odd, c, s)) ^ ((turn & 2) << 62));
  *cosine = fj_number(fj_bits(fj_pick(odd, s, c)) ^ (((turn + 1) & 2) << 62));
  if (fj_any(beyond)) {
    int lane;
    for (lane = 0; lane < FJ_LANES; lane++)
      if (beyond[lane]) {
        (*sine)[lane] = sin(x[lane]);
        (*cosine)[lane] = cos(x[lane]);
      }
  }
}
static inline fj_real fj_sin(fj_real x) {
  fj_real sine, cosine;
  fj_sincos(x, &sine, &cosine);
  return sine;
}
static inline fj_real fj_cos(fj_real x) {
  fj_real sine, cosine;
  fj_sincos(x, &sine, &cosine);
  return cosine;
}
#endif
