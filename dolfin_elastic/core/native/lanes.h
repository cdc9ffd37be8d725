/* Numbers of LANES cells at once; or of one cell, and then TABULATE of the kernel at `kernel`,
   which has so many ARGUMENTS. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define INLINE static inline __attribute__((always_inline))
/* Of eight numbers, as places, or true and false. */
typedef int64_t marks __attribute__((vector_size(64)));

#if LANES == 1
typedef double lanes;
#define fabs_lanes(x) fabs(x)
/* FFCx 0.10 and newer hand on a pointer to the user's data, too. */
#if ARGUMENTS == 7
typedef void (*tabulate)(double*, const double*, const double*, const double*, const int*,
                         const uint8_t*, void*);
#define TABULATE(...) ((tabulate)(intptr_t)kernel)(__VA_ARGS__, NULL, NULL, NULL)
#else
typedef void (*tabulate)(double*, const double*, const double*, const double*, const int*,
                         const uint8_t*);
#define TABULATE(...) ((tabulate)(intptr_t)kernel)(__VA_ARGS__, NULL, NULL)
#endif
#else
/* Its numbers are read and written one by one, too. */
typedef double lanes __attribute__((vector_size(8 * LANES), may_alias));
#define ZERO ((lanes){0})
/* The same in all lanes, where it is a number; a vector as it is: x - 0 is x, also for x = -0. */
#define SPREAD(x) ((x) - ZERO)
#define CHOOSE(mark, x, y) ((lanes)(((mark) & (marks)(x)) | (~(mark) & (marks)(y))))
#define OF_ONE(f)            \
  INLINE lanes each_##f(lanes x) \
  {                          \
    for (int l = 0; l < LANES; l++) \
      x[l] = f(x[l]);        \
    return x;                \
  }
#define OF_TWO(f)            \
  INLINE lanes each_##f(lanes x, lanes y) \
  {                          \
    for (int l = 0; l < LANES; l++) \
      x[l] = f(x[l], y[l]);  \
    return x;                \
  }

/* log, exp and pow of LANES numbers at once, from their series.

   A call of the C library's for each number costs several times as much as all other arithmetic of
   a law; some processors stop at each for a hundred cycles, because registers of 512 bits are in
   use.  Arguments that are not plain, among them all that have no finite result, are left to the C
   library.  Errors are below two units in the last place; of pow, |y log x| of them more.

   Source of the reduction of arguments: W. J. Cody and W. Waite, Software Manual for the Elementary
   Functions (1980), chapters 4 and 5. */

#define LN2_HIGH 0x1.62e42fefp-1 /* 33 bits: products with exponents are exact */
#define LN2_LOW 0x1.473de6af278edp-34

/* Whether a mark is missing. */
INLINE int not_all(marks plain)
{
  int64_t all = -1;
  for (int l = 0; l < LANES; l++)
    all &= plain[l];
  return all == 0;
}

/* 2^k m = x with m between sqrt(1/2) and sqrt(2); log m = 2 artanh s, s = (m - 1)/(m + 1), whose
   first term 2 s is (m - 1) (1 - s). */
INLINE lanes log_of_plain(lanes x)
{
  const marks k = ((marks)x - 0x3fe6a09e667f3bcd) >> 52;
  const lanes f = (lanes)((marks)x - (k << 52)) - 1.0, s = f / (f + 2.0), z = s * s;
  const lanes e = __builtin_convertvector(k, lanes);
  lanes sum = z * (2.0 / 25) + 2.0 / 23;
  for (int n = 21; n > 1; n -= 2)
    sum = sum * z + 2.0 / n;
  return e * LN2_HIGH + (f - (s * (f - z * sum) - e * LN2_LOW));
}

/* x = k log 2 + r, |r| < 0.35, and the series in r. */
INLINE lanes exp_of_plain(lanes x)
{
  const lanes magic = x * 0x1.71547652b82fep+0 + 0x1.8p52, k = magic - 0x1.8p52;
  const lanes r = (x - k * LN2_HIGH) - k * LN2_LOW;
  double factor[14] = {1.0};
  for (int n = 1; n < 14; n++)
    factor[n] = factor[n - 1] / n;
  lanes sum = r * factor[13] + factor[12];
  for (int n = 11; n >= 0; n--)
    sum = sum * r + factor[n];
  return (lanes)((marks)sum + ((marks)magic << 52));
}

static __attribute__((noinline)) lanes log_of_any(lanes x)
{
  for (int l = 0; l < LANES; l++)
    x[l] = log(x[l]);
  return x;
}

static __attribute__((noinline)) lanes exp_of_any(lanes x)
{
  for (int l = 0; l < LANES; l++)
    x[l] = exp(x[l]);
  return x;
}

static __attribute__((noinline)) lanes pow_of_any(lanes x, lanes y)
{
  for (int l = 0; l < LANES; l++)
    x[l] = pow(x[l], y[l]);
  return x;
}

static __attribute__((noinline, unused)) lanes each_log(lanes x)
{
  return not_all((x > 0x1p-1000) & (x < 0x1p1000)) ? log_of_any(x) : log_of_plain(x);
}

static __attribute__((noinline, unused)) lanes each_exp(lanes x)
{
  return not_all((x > -700.0) & (x < 700.0)) ? exp_of_any(x) : exp_of_plain(x);
}

static __attribute__((noinline, unused)) lanes each_pow(lanes x, lanes y)
{
  if (not_all((x > 0x1p-1000) & (x < 0x1p1000)))
    return pow_of_any(x, y);
  const lanes t = y * log_of_plain(x);
  return not_all((t > -2.0) & (t < 2.0)) ? pow_of_any(x, y) : exp_of_plain(t);
}

#endif
