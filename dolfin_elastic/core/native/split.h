/* Numbers of single precision, several in a row, in double precision and back; and entries as a sum
   of two of them: `high` is the entry rounded, `low` what is missing, so that both have 48 digits
   of its 53.

   gcc's `__builtin_convertvector` converts halves of a vector and puts them together, in up to five
   instructions; processors have one. */

#ifdef __AVX__
#include <immintrin.h>
#endif

#define INLINE static inline __attribute__((always_inline))

typedef float float4 __attribute__((vector_size(16), aligned(4)));
typedef float float8 __attribute__((vector_size(32), aligned(4)));
typedef double double4 __attribute__((vector_size(32), aligned(8)));
typedef double double8 __attribute__((vector_size(64), aligned(8)));

#ifdef __AVX__
INLINE double4 widened4(float4 x) { return (double4)_mm256_cvtps_pd((__m128)x); }
INLINE float4 rounded4(double4 x) { return (float4)_mm256_cvtpd_ps((__m256d)x); }
#else
INLINE double4 widened4(float4 x) { return __builtin_convertvector(x, double4); }
INLINE float4 rounded4(double4 x) { return __builtin_convertvector(x, float4); }
#endif
#ifdef __AVX512F__
INLINE double8 widened8(float8 x) { return (double8)_mm512_cvtps_pd((__m256)x); }
INLINE float8 rounded8(double8 x) { return (float8)_mm512_cvtpd_ps((__m512d)x); }
#else
INLINE double8 widened8(float8 x) { return __builtin_convertvector(x, double8); }
INLINE float8 rounded8(double8 x) { return __builtin_convertvector(x, float8); }
#endif

/* Adds an entry to one that is the sum of two of single precision. */
static inline void add_split(float* high, float* low, double value)
{
  const double sum = (double)*high + (double)*low + value;
  const float rounded = (float)sum;
  *high = rounded;
  *low = (float)(sum - (double)rounded);
}

/* Adds eight entries in a row. */
INLINE void add_eight(float* high, float* low, double8 values)
{
  const double8 sum = widened8(*(const float8*)high) + widened8(*(const float8*)low) + values;
  const float8 rounded = rounded8(sum);
  *(float8*)high = rounded;
  *(float8*)low = rounded8(sum - widened8(rounded));
}
