/* What any matrix by the half of its blocks needs.

   Row i of n owned nodes has its block of the diagonal, those of owned nodes j > i, and those of
   all nodes of other ranks, which are numbered from n on.  Blocks stand column by column. */

#include <stdint.h>
#include <string.h>

#include "split.h"

typedef double double2 __attribute__((vector_size(16), aligned(8)));
typedef int64_t long4 __attribute__((vector_size(32)));

INLINE double4 column(const int both, const float* high, const float* low)
{
  const double4 a = widened4(*(const float4*)high);
  return both ? a + widened4(*(const float4*)low) : a;
}

/* Entries ahead of those in use that are fetched from memory. */
#define AHEAD 512

/* Sums of the entries of a, of b and of c. */
INLINE double4 sums(double4 a, double4 b, double4 c)
{
  const double4 none = {0.0, 0.0, 0.0, 0.0};
  const double4 u = __builtin_shuffle(a, b, (long4){0, 4, 2, 6})
                    + __builtin_shuffle(a, b, (long4){1, 5, 3, 7});
  const double4 v = __builtin_shuffle(c, none, (long4){0, 4, 2, 6})
                    + __builtin_shuffle(c, none, (long4){1, 5, 3, 7});
  return __builtin_shuffle(u, v, (long4){0, 1, 4, 5})
         + __builtin_shuffle(u, v, (long4){2, 3, 6, 7});
}

/* What row i of A x adds to y, with blocks of 3x3.  Columns are read as four: behind the last block
   one more is there. */
INLINE void multiply_row_of_three(const int both, int64_t i, int64_t n, const int64_t* start,
                                  const int32_t* columns, const float* high, const float* low,
                                  const double* x, double* y)
{
  const double4 own = {x[3 * i], x[3 * i + 1], x[3 * i + 2], 0.0};
  double4 s[3] = {{0.0}, {0.0}, {0.0}};
  for (int64_t k = start[i]; k < start[i + 1]; k++)
  {
    const int64_t j = columns[k];
    const float *h = high + k * 9, *l = both ? low + k * 9 : h;
    __builtin_prefetch(h + AHEAD);
    if (both)
      __builtin_prefetch(l + AHEAD);
    const double4 a = column(both, h, l), b = column(both, h + 3, l + 3);
    const double4 c = column(both, h + 6, l + 6);
    s[0] += a * x[3 * j];
    s[1] += b * x[3 * j + 1];
    s[2] += c * x[3 * j + 2];
    if (j > i && j < n)
    {
      const double4 t = sums(a * own, b * own, c * own);
      *(double2*)(y + 3 * j) += __builtin_shufflevector(t, t, 0, 1);
      y[3 * j + 2] += t[2];
    }
  }
  s[0] += s[1] + s[2];
  for (int r = 0; r < 3; r++)
    y[3 * i + r] += s[0][r];
}

/* Vectors, one below the other, side by side; those that are missing are zero. */
#define PUT_SIDE_BY_SIDE(count, n, vectors, eight)                                                 \
  for (int64_t first = 0; first < n; first += 8)                                                   \
    for (int64_t v = 0; v < 8; v++)                                                                \
      for (int64_t k = first; k < n && k < first + 8; k++)                                         \
        eight[8 * k + v] = v < count ? vectors[v * n + k] : 0.0

/* The other way round. */
#define PUT_ONE_BELOW_THE_OTHER(count, n, eight, vectors)                                          \
  for (int64_t first = 0; first < n; first += 8)                                                   \
    for (int64_t v = 0; v < count; v++)                                                            \
      for (int64_t k = first; k < n && k < first + 8; k++)                                         \
        vectors[v * n + k] = eight[8 * k + v]

/* Where rows of all blocks begin. */
int64_t count_in_full(int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
                      int64_t full[n + 1])
{
  memset(full, 0, sizeof(int64_t) * (n + 1));
  for (int64_t i = 0; i < n; i++)
  {
    full[i + 1] += start[i + 1] - start[i];
    for (int64_t k = start[i]; k < start[i + 1]; k++)
      if (columns[k] > i && columns[k] < n)
        full[columns[k] + 1]++;
  }
  for (int64_t i = 0; i < n; i++)
    full[i + 1] += full[i];
  return 0;
}

/* Their columns, sorted, and where their blocks stand; `next` is room for n. */
int64_t columns_in_full(int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
                        const int64_t full[n + 1], int64_t next[n], int32_t full_columns[full[n]],
                        int32_t source[full[n]])
{
  memcpy(next, full, sizeof(int64_t) * n);
  for (int64_t i = 0; i < n; i++)
    for (int64_t k = start[i]; k < start[i + 1]; k++)
    {
      const int32_t j = columns[k];
      const int64_t own = full[i + 1] - (start[i + 1] - k);
      full_columns[own] = j;
      source[own] = (int32_t)k;
      if (j > i && j < n)
      {
        full_columns[next[j]] = (int32_t)i;
        source[next[j]++] = (int32_t)k;
      }
    }
  return 0;
}
