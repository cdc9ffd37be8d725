/* Half of a symmetric tangent, see halves.h and split.h: product, diagonal, places, rows in full.

   And a mass of one number for each pair of nodes: the block of nodes i and j is m_ij times the
   identity.  Its rows are those of all n nodes of a rank, owned and ghosts, with the nodes j >= i,
   sorted; numbers are of this rank's cells, as other ranks have theirs.

   DIM: components of a node. */

#include <stdint.h>
#include <string.h>

#include "halves.h"
#include "split.h"

#define SQUARE (DIM * DIM)

INLINE void multiply(const int both, int64_t n, const int64_t* start, const int32_t* columns,
                     const float* high, const float* low, const double* x, double* y)
{
  memset(y, 0, sizeof(double) * DIM * n);
#if DIM == 3
  for (int64_t i = 0; i < n; i++)
    multiply_row_of_three(both, i, n, start, columns, high, low, x, y);
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

int64_t product(int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
                const float high[SQUARE * start[n] + 1], const float low[SQUARE * start[n] + 1],
                int64_t nodes, const double x[DIM * nodes], double y[DIM * n])
{
  multiply(1, n, start, columns, high, low, x, y);
  return 0;
}

int64_t rounded_product(int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
                        const float high[SQUARE * start[n] + 1], int64_t nodes,
                        const double x[DIM * nodes], double y[DIM * n])
{
  multiply(0, n, start, columns, high, high, x, y);
  return 0;
}

/* --- Eight vectors at once: in place of each number of a vector there are those of eight, side by
   side, in as many parts as registers need.  Loops take one part of all numbers, from its first
   on; gcc's vectors of more than a register are slower than single numbers. --- */

#ifdef __AVX512F__
#define PARTS 1
#else
#define PARTS 2
#endif
typedef double part __attribute__((vector_size(64 / PARTS), aligned(8)));

/* What row i of A x adds to y. */
INLINE void multiply_row_eight(const int R, int64_t i, int64_t n,
                               const int64_t* start, const int32_t* columns, const float* high,
                               const float* low, const part* x, part* y)
{
  part own[R], s[R];
  for (int r = 0; r < R; r++)
  {
    own[r] = x[PARTS * (i * R + r)];
    s[r] = (part){0.0};
  }
  for (int64_t k = start[i]; k < start[i + 1]; k++)
  {
    const int64_t j = columns[k];
    const int turned = j > i && j < n;
    const float *h = high + k * R * R, *l = low + k * R * R;
    double a[R * R];
    int e = 0;
    for (; e + 4 <= R * R; e += 4)
      *(double4*)(a + e) = column(1, h + e, l + e);
    for (; e < R * R; e++)
      a[e] = (double)h[e] + (double)l[e];
    for (int c = 0; c < R; c++)
    {
      part t = {0.0};
      for (int r = 0; r < R; r++)
      {
        s[r] += a[c * R + r] * x[PARTS * (j * R + c)];
        t += a[c * R + r] * own[r];
      }
      if (turned)
        y[PARTS * (j * R + c)] += t;
    }
  }
  for (int r = 0; r < R; r++)
    y[PARTS * (i * R + r)] += s[r];
}

/* See halves.h. */
int64_t side_by_side(int64_t count, int64_t n, const double vectors[count * n], double eight[8 * n])
{
  PUT_SIDE_BY_SIDE(count, n, vectors, eight);
  return 0;
}
int64_t one_below_the_other(int64_t count, int64_t n, const double eight[8 * n],
                            double vectors[count * n])
{
  PUT_ONE_BELOW_THE_OTHER(count, n, eight, vectors);
  return 0;
}

/* y = A x, of eight vectors side by side. */
int64_t product_eight(int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
                      const float high[SQUARE * start[n] + 1],
                      const float low[SQUARE * start[n] + 1], int64_t nodes,
                      const double x[8 * DIM * nodes], double y[8 * DIM * n])
{
  memset(y, 0, sizeof(double) * 8 * DIM * n);
  for (int h = 0; h < PARTS; h++)
    for (int64_t i = 0; i < n; i++)
      multiply_row_eight(DIM, i, n, start, columns, high, low, (const part*)x + h,
                         (part*)y + h);
  return 0;
}

int64_t take_diagonal(int64_t n, const int64_t start[n + 1],
                      const float high[SQUARE * start[n] + 1],
                      const float low[SQUARE * start[n] + 1], double diagonal[DIM * n])
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
int64_t put_diagonal(int64_t count, const int32_t entries[count], const double values[count],
                     int64_t n, const int64_t start[n + 1], float high[SQUARE * start[n] + 1],
                     float low[SQUARE * start[n] + 1])
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
int64_t add_blocks(int64_t count, const int64_t places[count], const double blocks[SQUARE * count],
                   int64_t stored, float high[SQUARE * stored + 1], float low[SQUARE * stored + 1])
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
int64_t rows_in_full(int64_t first, int64_t count, const int64_t full[first + count + 1],
                     const int32_t full_columns[full[first + count]],
                     const int32_t source[full[first + count]], int64_t stored,
                     const float high[SQUARE * stored + 1], const float low[SQUARE * stored + 1],
                     double blocks[SQUARE * (full[first + count] - full[first])])
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

/* --- mass --- */

/* y += M x */
int64_t add_mass_product(int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
                         const double m[start[n]], const double x[DIM * n], double y[DIM * n])
{
  for (int64_t i = 0; i < n; i++)
  {
    double sum[DIM] = {0.0};
    for (int64_t k = start[i]; k < start[i + 1]; k++)
    {
      const int64_t j = columns[k];
      for (int c = 0; c < DIM; c++)
        sum[c] += m[k] * x[DIM * j + c];
      if (j != i)
        for (int c = 0; c < DIM; c++)
          y[DIM * j + c] += m[k] * x[DIM * i + c];
    }
    for (int c = 0; c < DIM; c++)
      y[DIM * i + c] += sum[c];
  }
  return -1;
}

/* The same for eight vectors, side by side. */
int64_t add_mass_product_eight(int64_t n, const int64_t start[n + 1],
                               const int32_t columns[start[n]], const double m[start[n]],
                               const double x[8 * DIM * n], double y[8 * DIM * n])
{
  for (int h = 0; h < PARTS; h++)
  {
    const part* from = (const part*)x + h;
    part* to = (part*)y + h;
    for (int64_t i = 0; i < n; i++)
      for (int c = 0; c < DIM; c++)
      {
        const int64_t e = PARTS * (DIM * i + c);
        const part own = from[e];
        part sum = {0.0};
        for (int64_t k = start[i]; k < start[i + 1]; k++)
        {
          const int64_t f = PARTS * (DIM * (int64_t)columns[k] + c);
          sum += m[k] * from[f];
          if (f != e)
            to[f] += m[k] * own;
        }
        to[e] += sum;
      }
  }
  return -1;
}

/* Adds `factor` M to half of a tangent, see halves.h, and to rows of ghosts, see `OffProcessRows`:
   but for fixed unknowns.  Returns a node for which there is no place, or -1. */
int64_t add_mass_to_half(int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
                         const double m[start[n]], const double factor[1],
                         const int8_t fixed[DIM * n], int64_t owned, const int64_t half[owned + 1],
                         const int32_t half_columns[half[owned]],
                         float high[DIM * DIM * half[owned] + 1],
                         float low[DIM * DIM * half[owned] + 1], int64_t ghosts,
                         const int64_t far[ghosts + 1], const int32_t far_columns[far[ghosts]],
                         double far_blocks[DIM * DIM * far[ghosts]])
{
  for (int64_t i = 0; i < n; i++)
  {
    int64_t place = i < owned ? half[i] : 0;
    for (int64_t k = start[i]; k < start[i + 1]; k++)
    {
      const int64_t j = columns[k];
      const double value = factor[0] * m[k];
      if (i < owned)
      {
        while (place < half[i + 1] && half_columns[place] != j)
          place++;
        if (place == half[i + 1])
          return i;
        for (int c = 0; c < DIM; c++)
          if (!fixed[DIM * i + c] && !fixed[DIM * j + c])
          {
            const int64_t e = DIM * DIM * place + (DIM + 1) * c;
            add_split(high + e, low + e, value);
          }
      }
      for (int other = 0; other < 2; other++)
      {
        const int64_t row = (other ? j : i) - owned, column = other ? i : j;
        if (row < 0 || (other && i == j))
          continue;
        int64_t f = far[row];
        while (f < far[row + 1] && far_columns[f] != column)
          f++;
        if (f == far[row + 1])
          return i;
        for (int c = 0; c < DIM; c++)
          if (!fixed[DIM * i + c] && !fixed[DIM * j + c])
            far_blocks[DIM * DIM * f + (DIM + 1) * c] += value;
      }
    }
  }
  return -1;
}

/* Adds `factor` M to rows of entries, whose columns are sorted, but for fixed ones; `entries` are
   those of the nodes.  Returns a node for which there is no place, or -1. */
int64_t add_mass_to_rows(int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
                         const double m[start[n]], const double factor[1],
                         const int32_t entries[DIM * n], int64_t rows, const int8_t fixed[rows],
                         const int64_t begins[rows + 1], const int32_t numbers[begins[rows]],
                         double values[begins[rows]])
{
  for (int64_t i = 0; i < n; i++)
    for (int64_t k = start[i]; k < start[i + 1]; k++)
      for (int c = 0; c < 2 * DIM; c++)
      {
        const int64_t j = columns[k], a = entries[DIM * i + c % DIM];
        const int64_t b = entries[DIM * j + c % DIM], row = c < DIM ? a : b;
        const int32_t column = c < DIM ? b : a;
        if (fixed[a] || fixed[b] || (c >= DIM && i == j))
          continue;
        int64_t lower = begins[row], upper = begins[row + 1];
        while (lower < upper)
        {
          const int64_t middle = (lower + upper) / 2;
          if (numbers[middle] < column)
            lower = middle + 1;
          else
            upper = middle;
        }
        if (lower == begins[row + 1] || numbers[lower] != column)
          return i;
        values[lower] += factor[0] * m[k];
      }
  return -1;
}
