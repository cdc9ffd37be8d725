"""The C code of `blocks.SymmetricBlocks`: product, diagonal, places, and rows in full.

Row i of n owned nodes has its block of the diagonal, those of owned nodes j > i, and those of all
nodes of other ranks, which are numbered from n on.  Blocks stand column by column, each entry as a
sum of two numbers of single precision: `high` is the entry rounded, `low` what is missing, so that
both have 48 digits of its 53.
"""

from __future__ import annotations

HALVES_DECLARATIONS = """
int64_t count_in_full(int64_t n, const int64_t* start, const int32_t* columns, int64_t* full);
int64_t columns_in_full(int64_t n, const int64_t* start, const int32_t* columns,
        const int64_t* full, int64_t* next, int32_t* full_columns, int32_t* source);
"""

DECLARATIONS = (
    HALVES_DECLARATIONS
    + """
int64_t product(int64_t n, const int64_t* start, const int32_t* columns, const float* high,
        const float* low, const double* x, double* y);
int64_t rounded_product(int64_t n, const int64_t* start, const int32_t* columns, const float* high,
        const double* x, double* y);
int64_t take_diagonal(int64_t n, const int64_t* start, const float* high, const float* low,
        double* diagonal);
int64_t put_diagonal(int64_t count, const int32_t* entries, const double* values,
        const int64_t* start, float* high, float* low);
int64_t add_blocks(int64_t count, const int64_t* places, const double* blocks, float* high,
        float* low);
int64_t rows_in_full(int64_t first, int64_t count, const int64_t* full,
        const int32_t* full_columns, const int32_t* source, const float* high, const float* low,
        double* blocks);
"""
)

ADDING = r"""
/* Adds an entry to one that is the sum of two of single precision. */
static inline void add_split(float* high, float* low, double value)
{
  const double sum = (double)*high + (double)*low + value;
  const float rounded = (float)sum;
  *high = rounded;
  *low = (float)(sum - (double)rounded);
}

typedef float floats __attribute__((vector_size(32), aligned(4)));
typedef double doubles __attribute__((vector_size(64), aligned(8)));

/* Adds eight entries in a row. */
static inline __attribute__((always_inline)) void add_eight(float* high, float* low, doubles values)
{
  const doubles sum = __builtin_convertvector(*(const floats*)high, doubles)
                      + __builtin_convertvector(*(const floats*)low, doubles) + values;
  const floats rounded = __builtin_convertvector(sum, floats);
  *(floats*)high = rounded;
  *(floats*)low
      = __builtin_convertvector(sum - __builtin_convertvector(rounded, doubles), floats);
}
"""

HALVES = r"""
#define INLINE static inline __attribute__((always_inline))

typedef float float4 __attribute__((vector_size(16), aligned(4)));
typedef double double2 __attribute__((vector_size(16), aligned(8)));
typedef double double4 __attribute__((vector_size(32), aligned(8)));
typedef int64_t long4 __attribute__((vector_size(32)));

INLINE double4 column(const int both, const float* high, const float* low)
{
  const double4 a = __builtin_convertvector(*(const float4*)high, double4);
  return both ? a + __builtin_convertvector(*(const float4*)low, double4) : a;
}

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

/* y += A x with blocks of 3x3.  Columns are read as four: behind the last block one more is
   there. */
INLINE void multiply_three(const int both, int64_t n, const int64_t* start, const int32_t* columns,
                           const float* high, const float* low, const double* x, double* y)
{
  for (int64_t i = 0; i < n; i++)
  {
    const double4 own = {x[3 * i], x[3 * i + 1], x[3 * i + 2], 0.0};
    double4 s[3] = {{0.0}, {0.0}, {0.0}};
    for (int64_t k = start[i]; k < start[i + 1]; k++)
    {
      const int64_t j = columns[k];
      const float *h = high + k * 9, *l = both ? low + k * 9 : h;
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
}

/* Where rows of all blocks begin. */
int64_t count_in_full(int64_t n, const int64_t* start, const int32_t* columns, int64_t* full)
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
int64_t columns_in_full(int64_t n, const int64_t* start, const int32_t* columns,
                        const int64_t* full, int64_t* next, int32_t* full_columns, int32_t* source)
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
"""
"""What any matrix by the half of its blocks needs."""

SOURCE = (
    r"""
#include <stdint.h>
#include <string.h>

#define SQUARE (DIM * DIM)
"""
    + HALVES
    + ADDING
    + r"""
INLINE void multiply(const int both, int64_t n, const int64_t* start, const int32_t* columns,
                     const float* high, const float* low, const double* x, double* y)
{
  memset(y, 0, sizeof(double) * DIM * n);
#if DIM == 3
  multiply_three(both, n, start, columns, high, low, x, y);
#else
  for (int64_t i = 0; i < n; i++)
  {
    double s[DIM] = {0.0};
    for (int64_t k = start[i]; k < start[i + 1]; k++)
    {
      const int64_t j = columns[k];
      for (int c = 0; c < DIM; c++)
      {
        double t = 0.0;
        for (int r = 0; r < DIM; r++)
        {
          const int64_t e = k * SQUARE + c * DIM + r;
          const double a = both ? (double)high[e] + (double)low[e] : (double)high[e];
          s[r] += a * x[DIM * j + c];
          t += a * x[DIM * i + r];
        }
        if (j > i && j < n)
          y[DIM * j + c] += t;
      }
    }
    for (int r = 0; r < DIM; r++)
      y[DIM * i + r] += s[r];
  }
#endif
}

int64_t product(int64_t n, const int64_t* start, const int32_t* columns, const float* high,
                const float* low, const double* x, double* y)
{
  multiply(1, n, start, columns, high, low, x, y);
  return 0;
}

int64_t rounded_product(int64_t n, const int64_t* start, const int32_t* columns, const float* high,
                        const double* x, double* y)
{
  multiply(0, n, start, columns, high, high, x, y);
  return 0;
}

int64_t take_diagonal(int64_t n, const int64_t* start, const float* high, const float* low,
                      double* diagonal)
{
  for (int64_t i = 0; i < n; i++)
    for (int r = 0; r < DIM; r++)
    {
      const int64_t e = start[i] * SQUARE + r * DIM + r;
      diagonal[i * DIM + r] = (double)high[e] + (double)low[e];
    }
  return 0;
}

/* Overwrites some entries of the diagonal. */
int64_t put_diagonal(int64_t count, const int32_t* entries, const double* values,
                     const int64_t* start, float* high, float* low)
{
  for (int64_t m = 0; m < count; m++)
  {
    const int64_t i = entries[m] / DIM, r = entries[m] % DIM, e = start[i] * SQUARE + r * DIM + r;
    high[e] = low[e] = 0.0f;
    add_split(high + e, low + e, values[m]);
  }
  return 0;
}

/* Adds blocks, row by row, at their places; those without a place are left out. */
int64_t add_blocks(int64_t count, const int64_t* places, const double* blocks, float* high,
                   float* low)
{
  for (int64_t m = 0; m < count; m++)
    for (int r = 0; places[m] >= 0 && r < DIM; r++)
      for (int c = 0; c < DIM; c++)
      {
        const int64_t e = places[m] * SQUARE + c * DIM + r;
        add_split(high + e, low + e, blocks[m * SQUARE + r * DIM + c]);
      }
  return 0;
}

/* The blocks of some rows, row by row. */
int64_t rows_in_full(int64_t first, int64_t count, const int64_t* full,
                     const int32_t* full_columns, const int32_t* source, const float* high,
                     const float* low, double* blocks)
{
  for (int64_t i = first; i < first + count; i++)
    for (int64_t p = full[i]; p < full[i + 1]; p++, blocks += SQUARE)
    {
      const float *h = high + (int64_t)source[p] * SQUARE, *l = low + (int64_t)source[p] * SQUARE;
      const int turned = full_columns[p] < i;
      for (int r = 0; r < DIM; r++)
        for (int c = 0; c < DIM; c++)
        {
          const int e = turned ? r * DIM + c : c * DIM + r;
          blocks[r * DIM + c] = (double)h[e] + (double)l[e];
        }
    }
  return 0;
}
"""
)
