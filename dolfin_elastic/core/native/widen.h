/* Several numbers of single precision in double precision, and back.

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
