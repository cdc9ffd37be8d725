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
#include "elementary.h"
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
#endif
