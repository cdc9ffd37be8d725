/* Multigrid in blocks: products of matrices, aggregates, and the cycle.

   Sizes of blocks are macros: DIM components of a node's displacement and MODES rigid-body modes of
   an aggregate.  Matrices are as in `block_rows.BlockRows`; in the cycle their blocks have single
   precision, which halves what is read from memory, and vectors double. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "halves.h"

/* Sizes of blocks are constants of the inlined functions. */
#define DISPATCH(R, C, f, ...)                                                                     \
  do                                                                                               \
  {                                                                                                \
    if (R == DIM && C == DIM)                                                                      \
      f(DIM, DIM, __VA_ARGS__);                                                                    \
    else if (R == DIM && C == MODES)                                                               \
      f(DIM, MODES, __VA_ARGS__);                                                                  \
    else if (R == MODES && C == MODES)                                                             \
      f(MODES, MODES, __VA_ARGS__);                                                                \
    else                                                                                           \
      return -1;                                                                                   \
  } while (0)

/* Blocks of each node's rows.  Of own and of other columns `node` is that of each column. */
int64_t count_blocks(int64_t n, int64_t R, const int64_t start[n * R + 1],
                     const int32_t columns[start[n * R]], const int64_t far_start[n * R + 1],
                     const int32_t far_columns[far_start[n * R]], int64_t own,
                     const int32_t node[own], int64_t far, const int32_t far_node[far],
                     int64_t size, int32_t mark[size], int64_t block_start[n + 1])
{
  block_start[0] = 0;
  for (int64_t i = 0; i < n; i++)
  {
    int64_t count = 0;
    for (int64_t e = start[i * R]; e < start[(i + 1) * R]; e++)
      if (mark[node[columns[e]]] != i)
      {
        mark[node[columns[e]]] = (int32_t)i;
        count++;
      }
    for (int64_t e = far_start[i * R]; e < far_start[(i + 1) * R]; e++)
      if (mark[far_node[far_columns[e]]] != i)
      {
        mark[far_node[far_columns[e]]] = (int32_t)i;
        count++;
      }
    block_start[i + 1] = block_start[i] + count;
  }
  return 0;
}

INLINE int64_t put(int64_t r, int64_t R, int64_t C, int64_t first, int64_t last,
                   const int32_t* columns, const double* values, const int32_t* node,
                   const int8_t* component, int64_t* place, int64_t begin, int64_t next,
                   int32_t* block_columns, double* blocks)
{
  for (int64_t e = first; e < last; e++)
  {
    const int32_t j = node[columns[e]];
    int64_t k = place[j];
    if (k < begin || k >= next || block_columns[k] != j)
    {
      k = place[j] = next++;
      block_columns[k] = j;
      memset(blocks + k * R * C, 0, sizeof(double) * R * C);
    }
    blocks[(k * R + r) * C + component[columns[e]]] += values[e];
  }
  return next;
}

/* The same blocks, of some rows.  Of own and of other columns `component` is the one of each
   column.  Rows are counted from the first of these, entries and columns of blocks from that of
   all, and blocks from their first. */
int64_t fill_blocks(int64_t n, int64_t R, int64_t C, const int64_t start[n * R + 1],
                    const int32_t columns[start[n * R]], const double values[start[n * R]],
                    const int64_t far_start[n * R + 1],
                    const int32_t far_columns[far_start[n * R]],
                    const double far_values[far_start[n * R]], int64_t own,
                    const int32_t node[own], int64_t far, const int32_t far_node[far],
                    const int8_t component[own], const int8_t far_component[far], int64_t size,
                    int64_t place[size], const int64_t block_start[n + 1],
                    int32_t block_columns[block_start[n]],
                    double blocks[R * C * (block_start[n] - block_start[0])])
{
  blocks -= block_start[0] * R * C;
  for (int64_t i = 0; i < n; i++)
  {
    int64_t next = block_start[i];
    for (int64_t r = 0; r < R; r++)
    {
      const int64_t row = i * R + r;
      next = put(r, R, C, start[row], start[row + 1], columns, values, node, component, place,
                 block_start[i], next, block_columns, blocks);
      next = put(r, R, C, far_start[row], far_start[row + 1], far_columns, far_values, far_node,
                 far_component, place, block_start[i], next, block_columns, blocks);
    }
  }
  return 0;
}

/* Loops that need the blocks of a matrix take n rows from `first` on, and their blocks alone. */

/* Blocks of the diagonal. */
int64_t take_diagonal(int64_t first, int64_t n, int64_t R, const int64_t start[first + n + 1],
                      const int32_t columns[start[first + n]],
                      const double blocks[R * R * (start[first + n] - start[first])],
                      double diagonal[R * R * (first + n)])
{
  blocks -= start[first] * R * R;
  for (int64_t i = first; i < first + n; i++)
    for (int64_t k = start[i]; k < start[i + 1]; k++)
      if (columns[k] == i)
        memcpy(diagonal + i * R * R, blocks + k * R * R, sizeof(double) * R * R);
  return 0;
}

/* Their inverses; a direction without stiffness is left alone. */
INLINE void invert_blocks_(const int R, const int C, int64_t n, double* blocks)
{
  (void)C;
  for (int64_t i = 0; i < n; i++)
  {
    double a[R][R], *b = blocks + i * R * R;
    memcpy(a, b, sizeof(a));
    double largest = 0.0;
    for (int r = 0; r < R; r++)
      largest = fmax(largest, fabs(a[r][r]));
    for (int r = 0; r < R; r++)
      for (int c = 0; c < R; c++)
        b[r * R + c] = r == c;
    for (int p = 0; p < R; p++)
    {
      if (!(fabs(a[p][p]) > 1e-13 * largest))
      {
        for (int c = 0; c < R; c++)
        {
          a[p][c] = p == c;
          b[p * R + c] = 0.0;
        }
        for (int r = 0; r < R; r++)
          if (r != p)
            a[r][p] = 0.0;
        continue;
      }
      const double f = 1.0 / a[p][p];
      for (int c = 0; c < R; c++)
      {
        a[p][c] *= f;
        b[p * R + c] *= f;
      }
      for (int r = 0; r < R; r++)
      {
        if (r == p)
          continue;
        const double g = a[r][p];
        for (int c = 0; c < R; c++)
        {
          a[r][c] -= g * a[p][c];
          b[r * R + c] -= g * b[p * R + c];
        }
      }
    }
  }
}
int64_t invert_blocks(int64_t R, int64_t n, double blocks[R * R * n])
{
  DISPATCH(R, R, invert_blocks_, n, blocks);
  return 0;
}

/* y = D x, of blocks of the diagonal */
INLINE void times_diagonal_(const int R, const int C, int64_t n, const double* blocks,
                            const double* x, double* y)
{
  for (int64_t i = 0; i < n; i++)
    for (int r = 0; r < R; r++)
    {
      double s = 0.0;
      for (int c = 0; c < C; c++)
        s += blocks[(i * R + r) * C + c] * x[i * C + c];
      y[i * R + r] = s;
    }
}
int64_t times_diagonal(int64_t R, int64_t n, const double blocks[R * R * n], const double x[R * n],
                       double y[R * n])
{
  DISPATCH(R, R, times_diagonal_, n, blocks, x, y);
  return 0;
}

/* strong[k] = |A_ij|^2 / (|A_ii| |A_jj|) where that is above threshold^2, else minus that; 0 on the
   diagonal.  The diagonal of nodes of other ranks is taken to be that of node i. */
INLINE void connections_(const int R, const int C, int64_t first, int64_t n, const int64_t* start,
                         const int32_t* columns, const double* blocks, int64_t owned,
                         const double* sizes, float* strong, double threshold)
{
  blocks -= start[first] * R * C;
  for (int64_t i = first; i < first + n; i++)
    for (int64_t k = start[i]; k < start[i + 1]; k++)
    {
      const int32_t j = columns[k];
      double square = 0.0, size = sizes[i] * sizes[j < owned ? j : i];
      for (int e = 0; e < R * C; e++)
        square += blocks[k * R * C + e] * blocks[k * R * C + e];
      const int weak = !(square > threshold * threshold * size);
      strong[k] = j == i ? 0.0f : (float)(weak ? -square / size : square / size);
    }
}
int64_t connections(int64_t first, int64_t n, int64_t R, const int64_t start[first + n + 1],
                    const int32_t columns[start[first + n]],
                    const double blocks[R * R * (start[first + n] - start[first])], int64_t owned,
                    const double sizes[owned], float strong[start[first + n]],
                    const double threshold[1])
{
  DISPATCH(R, R, connections_, first, n, start, columns, blocks, owned, sizes, strong,
           threshold[0]);
  return 0;
}

/* Aggregates of strongly connected owned nodes: Vanek, Mandel & Brezina (1996), Algorithm 2.
   Nodes without any connection get -1. Returns the number of aggregates. */
int64_t aggregate(int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
                  const float strong[start[n]], int32_t member[n])
{
  int32_t count = 0;
  const int32_t FREE = -2;
  for (int64_t i = 0; i < n; i++)
  {
    int alone = 1;
    for (int64_t k = start[i]; k < start[i + 1]; k++)
      alone = alone && strong[k] == 0.0f;
    member[i] = alone ? -1 : FREE;
  }
  for (int64_t i = 0; i < n; i++)
  {
    int all = member[i] == FREE;
    for (int64_t k = start[i]; all && k < start[i + 1]; k++)
      if (strong[k] > 0.0f && columns[k] < n && member[columns[k]] >= 0)
        all = 0;
    if (!all)
      continue;
    member[i] = count;
    for (int64_t k = start[i]; k < start[i + 1]; k++)
      if (strong[k] > 0.0f && columns[k] < n)
        member[columns[k]] = count;
    count++;
  }
  /* The rest joins the neighbour of the strongest connection, strong or weak; marked by
     -3 - aggregate. */
  for (int64_t i = 0; i < n; i++)
  {
    if (member[i] != FREE)
      continue;
    float best = 0.0f;
    int32_t found = -1;
    for (int64_t k = start[i]; k < start[i + 1]; k++)
      if (fabsf(strong[k]) > best && columns[k] < n && member[columns[k]] >= 0)
      {
        best = fabsf(strong[k]);
        found = member[columns[k]];
      }
    if (found >= 0)
      member[i] = -3 - found;
  }
  for (int64_t i = 0; i < n; i++)
    if (member[i] <= -3)
      member[i] = -3 - member[i];
  for (int64_t i = 0; i < n; i++)
  {
    if (member[i] != FREE)
      continue;
    member[i] = count;
    for (int64_t k = start[i]; k < start[i + 1]; k++)
      if (strong[k] > 0.0f && columns[k] < n && member[columns[k]] == FREE)
        member[columns[k]] = count;
    count++;
  }
  return count;
}

/* Modes move no prescribed component: one whose row has no entry but on the diagonal. */
int64_t hold_fixed(int64_t first, int64_t n, int64_t R, int64_t C,
                   const int64_t start[first + n + 1], const int32_t columns[start[first + n]],
                   const double blocks[R * R * (start[first + n] - start[first])],
                   double modes[R * C * (first + n)])
{
  blocks -= start[first] * R * R;
  for (int64_t i = first; i < first + n; i++)
    for (int64_t r = 0; r < R; r++)
    {
      int fixed = 1;
      for (int64_t k = start[i]; fixed && k < start[i + 1]; k++)
        for (int64_t c = 0; c < R; c++)
          if ((columns[k] != i || c != r) && blocks[(k * R + r) * R + c] != 0.0)
            fixed = 0;
      if (fixed)
        memset(modes + (i * R + r) * C, 0, sizeof(double) * C);
    }
  return 0;
}

/* Orthonormal modes of each aggregate: modes (n, R, C) become the tentative interpolation, factors
   (aggregates, C, C) the modes of the coarse level. */
int64_t orthonormalise(int64_t n, int64_t R, int64_t C, int64_t aggregates,
                       const int32_t member[n], double modes[R * C * n],
                       double factors[C * C * aggregates], double work[2 * aggregates])
{
  memset(factors, 0, sizeof(double) * aggregates * C * C);
  double* before = work;            /* (aggregates) squares */
  double* dot = work + aggregates;  /* (aggregates) */
  for (int64_t c = 0; c < C; c++)
  {
    memset(before, 0, sizeof(double) * aggregates);
    for (int64_t i = 0; i < n; i++)
      if (member[i] >= 0)
        for (int64_t r = 0; r < R; r++)
        {
          const double x = modes[(i * R + r) * C + c];
          before[member[i]] += x * x;
        }
    for (int repeat = 0; repeat < 2; repeat++)
      for (int64_t p = 0; p < c; p++)
      {
        memset(dot, 0, sizeof(double) * aggregates);
        for (int64_t i = 0; i < n; i++)
          if (member[i] >= 0)
            for (int64_t r = 0; r < R; r++)
              dot[member[i]] += modes[(i * R + r) * C + p] * modes[(i * R + r) * C + c];
        for (int64_t i = 0; i < n; i++)
          if (member[i] >= 0)
            for (int64_t r = 0; r < R; r++)
              modes[(i * R + r) * C + c] -= dot[member[i]] * modes[(i * R + r) * C + p];
        for (int64_t g = 0; g < aggregates; g++)
          factors[(g * C + p) * C + c] += dot[g];
      }
    memset(dot, 0, sizeof(double) * aggregates);
    for (int64_t i = 0; i < n; i++)
      if (member[i] >= 0)
        for (int64_t r = 0; r < R; r++)
        {
          const double x = modes[(i * R + r) * C + c];
          dot[member[i]] += x * x;
        }
    for (int64_t g = 0; g < aggregates; g++)
    {
      /* dependent on the modes before it: no column */
      const int none = !(dot[g] > 1e-12 * before[g]);
      factors[(g * C + c) * C + c] = none ? 0.0 : sqrt(dot[g]);
      dot[g] = none ? 0.0 : 1.0 / sqrt(dot[g]);
    }
    for (int64_t i = 0; i < n; i++)
      if (member[i] >= 0)
        for (int64_t r = 0; r < R; r++)
          modes[(i * R + r) * C + c] *= dot[member[i]];
  }
  return 0;
}

/* Rows of C entries as vectors of L lanes.  Those behind the C are zero where the row has double
   precision; its last one is read from before it, as nothing may stand behind it.  Where it has
   single precision they hold anything: two more entries stand behind the last row of all. */
#define ROWS_AS_LANES(L, integers, lanes)                                                          \
  typedef double lanes __attribute__((vector_size(8 * L), aligned(8)));                            \
  typedef int64_t integers __attribute__((vector_size(8 * L)));                                    \
  INLINE integers turned_##lanes(int by)                                                           \
  {                                                                                                \
    integers from;                                                                                 \
    for (int c = 0; c < L; c++)                                                                    \
      from[c] = (c + by) % L;                                                                      \
    return from;                                                                                   \
  }                                                                                                \
  INLINE lanes inside_##lanes(const int C, lanes row)                                              \
  {                                                                                                \
    integers inside;                                                                               \
    for (int c = 0; c < L; c++)                                                                    \
      inside[c] = c < C ? -1 : 0;                                                                  \
    return (lanes)((integers)row & inside);                                                        \
  }                                                                                                \
  INLINE lanes row_of_##lanes(const int C, const double* rows, int row, int last)                  \
  {                                                                                                \
    const double* at = rows + row * C - (row == last ? L - C : 0);                                 \
    lanes read = *(const lanes*)at;                                                                \
    if (row == last)                                                                               \
      read = __builtin_shuffle(read, turned_##lanes(L - C));                                       \
    return inside_##lanes(C, read);                                                                \
  }                                                                                                \
  /* w += a p, of which w has rows of L entries, and a K entries in rows S apart */                \
  INLINE void add_product_##lanes(const int R, const int K, const int S, const int C,              \
                                  const double* a, const double* p, double* w)                     \
  {                                                                                                \
    lanes sum[R];                                                                                  \
    for (int r = 0; r < R; r++)                                                                    \
      sum[r] = *(lanes*)(w + r * L);                                                               \
    for (int q = 0; q < K; q++)                                                                    \
    {                                                                                              \
      const lanes row = row_of_##lanes(C, p, q, K - 1);                                            \
      for (int r = 0; r < R; r++)                                                                  \
        sum[r] += a[r * S + q] * row;                                                              \
    }                                                                                              \
    for (int r = 0; r < R; r++)                                                                    \
      *(lanes*)(w + r * L) = sum[r];                                                               \
  }                                                                                                \
  /* The same with p in single precision, and a of R columns */                                    \
  INLINE void add_rounded_##lanes(const int R, const int C, const double* a, const float* p,       \
                                  double* w)                                                       \
  {                                                                                                \
    lanes sum[R];                                                                                  \
    for (int r = 0; r < R; r++)                                                                    \
      sum[r] = *(lanes*)(w + r * L);                                                               \
    for (int q = 0; q < R; q++)                                                                    \
    {                                                                                              \
      const lanes row = widened##L(*(const float##L*)(p + q * C));                                 \
      for (int r = 0; r < R; r++)                                                                  \
        sum[r] += a[r * R + q] * row;                                                              \
    }                                                                                              \
    for (int r = 0; r < R; r++)                                                                    \
      *(lanes*)(w + r * L) = sum[r];                                                               \
  }                                                                                                \
  /* p = t + a w, rounded, of which w has rows of L entries; each row writes over what the one     \
     before has written behind its end */                                                          \
  INLINE void round_product_##lanes(const int R, const int C, const double* a, const double* w,    \
                                    const double* t, float* p)                                     \
  {                                                                                                \
    for (int r = 0; r < R; r++)                                                                    \
    {                                                                                              \
      lanes sum = {0.0};                                                                           \
      if (t)                                                                                       \
        sum = row_of_##lanes(C, t, r, R - 1);                                                      \
      for (int q = 0; q < R; q++)                                                                  \
        sum += a[r * R + q] * *(const lanes*)(w + q * L);                                          \
      *(float##L*)(p + r * C) = rounded##L(sum);                                                   \
    }                                                                                              \
  }                                                                                                \
  /* Rows of L entries in double precision */                                                      \
  INLINE void in_lanes_##lanes(const int R, const int C, const float* p, double* q)                \
  {                                                                                                \
    for (int r = 0; r < R; r++)                                                                    \
      *(lanes*)(q + r * L) = widened##L(*(const float##L*)(p + r * C));                            \
  }                                                                                                \
  /* out += p^T w, of which p and w have rows of L entries; each row writes over what the one      \
     before has written behind its end */                                                          \
  INLINE void add_transposed_##lanes(const int R, const int C, const double* p, const double* w,   \
                                     double* out)                                                  \
  {                                                                                                \
    lanes sum[C], row[R];                                                                          \
    for (int r = 0; r < R; r++)                                                                    \
      row[r] = *(const lanes*)(w + r * L);                                                         \
    for (int a = 0; a < C; a++)                                                                    \
    {                                                                                              \
      sum[a] = row_of_##lanes(C, out, a, C - 1);                                                   \
      for (int r = 0; r < R; r++)                                                                  \
        sum[a] += p[r * L + a] * row[r];                                                           \
    }                                                                                              \
    for (int a = 0; a < C - 1; a++)                                                                \
      *(lanes*)(out + a * C) = sum[a];                                                             \
    integers both;                                                                                 \
    for (int c = 0; c < L; c++)                                                                    \
      both[c] = c < L - C ? c + 2 * C - L : L + c - (L - C);                                       \
    *(lanes*)(out + C * C - L) = __builtin_shuffle(sum[C - 2], sum[C - 1], both);                  \
  }
ROWS_AS_LANES(4, integers4, lanes4)
ROWS_AS_LANES(8, integers8, lanes8)

/* The one of these that rows of C entries need. */
#define AS_LANES(C, f, ...) ((C) > 4 ? f##_lanes8(__VA_ARGS__) : f##_lanes4(__VA_ARGS__))

/* Smoothed interpolation, P = (1 - omega D^-1 A) P0: Vanek, Mandel & Brezina (1996).  A node of
   a weak connection counts as if it moved with the aggregate of node i, as a rigid body: its modes
   times `turned`, the inverse factors of that aggregate.  So P stays sparse, and rigid motions are
   still interpolated. */
int64_t count_smoothed(int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
                       const float strong[start[n]], int64_t nodes, const int32_t member[nodes],
                       int64_t groups, int32_t mark[groups], int64_t p_start[n + 1])
{
  p_start[0] = 0;
  for (int64_t i = 0; i < n; i++)
  {
    int64_t count = 0;
    for (int64_t k = start[i]; k < start[i + 1]; k++)
    {
      const int32_t g = member[strong[k] > 0.0f ? columns[k] : i];
      if (member[i] >= 0 && g >= 0 && mark[g] != i)
      {
        mark[g] = i;
        count++;
      }
    }
    p_start[i + 1] = p_start[i] + count;
  }
  return 0;
}

INLINE void fill_smoothed_(const int R, const int C, int64_t first, int64_t n,
                           const int64_t* start,
                           const int32_t* columns, const double* blocks, const float* strong,
                           const double* inverse, const double* modes, const double* turned,
                           const double* tentative, const int32_t* member, double omega,
                           const int64_t* p_start, int32_t* p_columns, float* p_blocks,
                           int32_t* place, double* w)
{
  const int L = C > 4 ? 8 : 4, size = R * L;
  blocks -= start[first] * R * R;
  for (int64_t i = first; i < first + n; i++)
  {
    if (member[i] < 0)
      continue;
    int count = 0, any = 0;
    int32_t* list = p_columns + p_start[i];
    double scaled[R * R], weak[size];
    memset(weak, 0, sizeof(weak));
    for (int r = 0; r < R * R; r++)
      scaled[r] = -omega * inverse[i * R * R + r];
    for (int64_t k = start[i]; k < start[i + 1]; k++)
    {
      const int64_t j = columns[k];
      const int is_weak = j != i && !(strong[k] > 0.0f);
      const int32_t g = member[is_weak ? i : j];
      if (g < 0)
        continue;
      if (place[g] < 0)
      {
        place[g] = count;
        list[count] = g;
        memset(w + count * size, 0, sizeof(double) * size);
        count++;
      }
      const double *a = blocks + k * R * R, *t = (is_weak ? modes : tentative) + j * R * C;
      AS_LANES(C, add_product, R, R, R, C, a, t, is_weak ? weak : w + place[g] * size);
      any = any || is_weak;
    }
    if (any)
      AS_LANES(C, add_product, R, C, L, C, weak, turned + (int64_t)member[i] * C * C,
               w + place[member[i]] * size);
    for (int s = 0; s < count; s++)
    {
      const double* t = list[s] == member[i] ? tentative + i * R * C : NULL;
      float* p = p_blocks + (p_start[i] + s) * R * C;
      AS_LANES(C, round_product, R, C, scaled, w + s * size, t, p);
      place[list[s]] = -1;
    }
  }
}
int64_t fill_smoothed(int64_t R, int64_t C, int64_t first, int64_t n,
                      const int64_t start[first + n + 1], const int32_t columns[start[first + n]],
                      const double blocks[R * R * (start[first + n] - start[first])],
                      const float strong[start[first + n]],
                      const double inverse[R * R * (first + n)], int64_t nodes,
                      const double modes[R * C * nodes], const double tentative[R * C * nodes],
                      const int32_t member[nodes], int64_t own, const double turned[C * C * own],
                      const double omega[1], const int64_t p_start[first + n + 1],
                      int32_t p_columns[p_start[first + n]],
                      float p_blocks[R * C * p_start[first + n] + 2], int64_t groups,
                      int32_t place[groups], int64_t most, double w[8 * R * most])
{
  DISPATCH(R, C, fill_smoothed_, first, n, start, columns, blocks, strong, inverse, modes, turned,
           tentative, member, omega[0], p_start, p_columns, p_blocks, place, w);
  return 0;
}

/* Rows that each of `size` columns has entries in, sorted; `next` is room for as many. */
int64_t transpose(int64_t n, int64_t size, const int64_t start[n + 1],
                  const int32_t columns[start[n]], int64_t t_start[size + 1],
                  int32_t t_columns[start[n]], int64_t next[size])
{
  memset(t_start, 0, sizeof(int64_t) * (size + 1));
  for (int64_t k = 0; k < start[n]; k++)
    t_start[columns[k] + 1]++;
  for (int64_t c = 0; c < size; c++)
    t_start[c + 1] += t_start[c];
  memcpy(next, t_start, sizeof(int64_t) * size);
  for (int64_t i = 0; i < n; i++)
    for (int64_t k = start[i]; k < start[i + 1]; k++)
      t_columns[next[columns[k]]++] = (int32_t)i;
  return 0;
}

/* The most entries that a product A B may have. */
int64_t most_of_product(int64_t n, const int64_t a_start[n + 1],
                        const int32_t a_columns[a_start[n]], int64_t rows,
                        const int64_t b_start[rows + 1])
{
  int64_t count = 0;
  for (int64_t k = 0; k < a_start[n]; k++)
    count += b_start[a_columns[k] + 1] - b_start[a_columns[k]];
  return count;
}

/* Where rows of a product A B begin, and their columns, row by row.  Where they are `halved`, only
   those from the diagonal on of two nodes of the same `side`. */
int64_t product_pattern(int64_t n, const int64_t a_start[n + 1],
                        const int32_t a_columns[a_start[n]], int64_t rows,
                        const int64_t b_start[rows + 1], const int32_t b_columns[b_start[rows]],
                        int64_t size, int64_t halved, const int32_t side[halved * size],
                        const int64_t numbers[halved * size], int32_t mark[size],
                        int64_t start[n + 1], int64_t most, int32_t columns[most])
{
  start[0] = 0;
  for (int64_t i = 0; i < n; i++)
  {
    int64_t next = start[i];
    for (int64_t k = a_start[i]; k < a_start[i + 1]; k++)
      for (int64_t l = b_start[a_columns[k]]; l < b_start[a_columns[k] + 1]; l++)
      {
        const int32_t c = b_columns[l];
        if (mark[c] == i)
          continue;
        mark[c] = (int32_t)i;
        if (halved && side[c] == side[i] && numbers[c] < numbers[i])
          continue;
        columns[next++] = c;
      }
    start[i + 1] = next;
  }
  return 0;
}

/* P^T A P, row by row of A: a row of A P first, then its part of each coarse row.  Between nodes
   of the same rank, which are those of the same `side`, only the blocks from the diagonal on. */
INLINE void galerkin_(const int R, const int C, int64_t first, int64_t n, const int64_t* start,
                      const int32_t* columns, const double* blocks, const int64_t* p_start,
                      const int32_t* p_columns, const float* p_blocks, const int64_t* c_start,
                      const int32_t* c_columns, double* coarse, const int32_t* side,
                      const int64_t* numbers, int32_t* place, int32_t* list, double* w)
{
  const int L = C > 4 ? 8 : 4, size = R * L;
  blocks -= start[first] * R * R;
  for (int64_t i = first; i < first + n; i++)
  {
    int count = 0;
    if (p_start[i] == p_start[i + 1])
      continue;
    for (int64_t k = start[i]; k < start[i + 1]; k++)
    {
      const double* a = blocks + k * R * R;
      for (int64_t l = p_start[columns[k]]; l < p_start[columns[k] + 1]; l++)
      {
        const int32_t g = p_columns[l];
        if (place[g] < 0)
        {
          place[g] = count;
          list[count] = g;
          memset(w + count * size, 0, sizeof(double) * size);
          count++;
        }
        AS_LANES(C, add_rounded, R, C, a, p_blocks + l * R * C, w + place[g] * size);
      }
    }
    for (int64_t l = p_start[i]; l < p_start[i + 1]; l++)
    {
      const int32_t g = p_columns[l];
      double p[size];
      AS_LANES(C, in_lanes, R, C, p_blocks + l * R * C, p);
      for (int s = 0; s < count; s++)
      {
        const int32_t column = list[s], *at = c_columns + c_start[g];
        if (side[column] == side[g] && numbers[column] < numbers[g])
          continue;
        for (int64_t left = c_start[g + 1] - c_start[g]; left > 1; left -= left / 2)
          at += at[left / 2] <= column ? left / 2 : 0;
        AS_LANES(C, add_transposed, R, C, p, w + s * size, coarse + (at - c_columns) * C * C);
      }
    }
    for (int s = 0; s < count; s++)
      place[list[s]] = -1;
  }
}
int64_t galerkin(int64_t R, int64_t C, int64_t first, int64_t n,
                 const int64_t start[first + n + 1], const int32_t columns[start[first + n]],
                 const double blocks[R * R * (start[first + n] - start[first])], int64_t nodes,
                 const int64_t p_start[nodes + 1], const int32_t p_columns[p_start[nodes]],
                 const float p_blocks[R * C * p_start[nodes] + 2], int64_t groups,
                 const int64_t c_start[groups + 1], const int32_t c_columns[c_start[groups]],
                 double coarse[C * C * c_start[groups]], int64_t size, const int32_t side[size],
                 const int64_t numbers[size], int32_t place[size], int64_t most,
                 int32_t list[most], double w[8 * R * most])
{
  DISPATCH(R, C, galerkin_, first, n, start, columns, blocks, p_start, p_columns, p_blocks, c_start,
           c_columns, coarse, side, numbers, place, list, w);
  return 0;
}

/* y = A x */
INLINE void product_(const int R, const int C, int64_t n, const int64_t* start,
                     const int32_t* columns, const double* blocks, const double* x, double* y)
{
  for (int64_t i = 0; i < n; i++)
  {
    double z[R];
    for (int r = 0; r < R; r++)
      z[r] = 0.0;
    for (int64_t k = start[i]; k < start[i + 1]; k++)
      for (int r = 0; r < R; r++)
        for (int c = 0; c < C; c++)
          z[r] += blocks[(k * R + r) * C + c] * x[(int64_t)C * columns[k] + c];
    for (int r = 0; r < R; r++)
      y[i * R + r] = z[r];
  }
}
int64_t product(int64_t R, int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
                const double blocks[R * R * start[n]], int64_t nodes, const double x[R * nodes],
                double y[R * n])
{
  DISPATCH(R, R, product_, n, start, columns, blocks, x, y);
  return 0;
}

/* Blocks of single precision, column by column. */
int64_t in_single_precision(int64_t count, int64_t R, int64_t C,
                            const double blocks[R * C * count], float out[R * C * count])
{
  for (int64_t k = 0; k < count; k++)
    for (int64_t c = 0; c < C; c++)
      for (int64_t r = 0; r < R; r++)
        out[(k * C + c) * R + r] = (float)blocks[(k * R + r) * C + c];
  return 0;
}

/* The same in the first half of the memory of the blocks. */
int64_t into_single_precision(int64_t count, int64_t R, int64_t C, double blocks[R * C * count])
{
  double a[MODES * MODES];
  float out[MODES * MODES];
  if (R > MODES || C > MODES)
    return -1;
  for (int64_t k = 0; k < count; k++)
  {
    memcpy(a, blocks + k * R * C, R * C * sizeof(double));
    for (int64_t c = 0; c < C; c++)
      for (int64_t r = 0; r < R; r++)
        out[c * R + r] = (float)a[r * C + c];
    memcpy((char*)blocks + k * R * C * sizeof(float), out, R * C * sizeof(float));
  }
  return 0;
}

/* y += sum of the blocks of a row times x.  Columns of three entries are read as four: behind the
   last block one more entry is there. */
INLINE void row_times(const int R, int64_t first, int64_t last, const int32_t* columns,
                      const float* a, const double* x, double* y)
{
  const int C = R;
  if (R == 3)
  {
    double4 s[C];
    for (int c = 0; c < C; c++)
      s[c] = (double4){0.0, 0.0, 0.0, 0.0};
    for (int64_t k = first; k < last; k++)
    {
      const double* v = x + (int64_t)C * columns[k];
      for (int c = 0; c < C; c++)
        s[c] += widened4(*(const float4*)(a + (k * C + c) * 3)) * v[c];
    }
    for (int c = 1; c < C; c++)
      s[0] += s[c];
    for (int r = 0; r < 3; r++)
      y[r] += s[0][r];
  }
  else
  {
    double s[R];
    for (int r = 0; r < R; r++)
      s[r] = 0.0;
    for (int64_t k = first; k < last; k++)
    {
      const double* v = x + (int64_t)C * columns[k];
      for (int c = 0; c < C; c++)
        for (int r = 0; r < R; r++)
          s[r] += (double)a[(k * C + c) * R + r] * v[c];
    }
    for (int r = 0; r < R; r++)
      y[r] += s[r];
  }
}

/* r = b - A x, of one node */
INLINE void residual(const int R, int64_t i, const int64_t* start, const int32_t* columns,
                     const float* a, const double* x, const double* b, double* r)
{
  for (int k = 0; k < R; k++)
    r[k] = 0.0;
  row_times(R, start[i], start[i + 1], columns, a, x, r);
  for (int k = 0; k < R; k++)
    r[k] = b[i * R + k] - r[k];
}

/* z + S r */
INLINE void add_scaled(const int R, const float* inverse, const double* r, double* z)
{
  for (int c = 0; c < R; c++)
    for (int k = 0; k < R; k++)
      z[k] += inverse[c * R + k] * r[c];
}

/* y = x + S (b - y), of one node, where y is A x */
INLINE void correct(const int R, const float* inverse, const double* x, const double* b, double* y)
{
  double r[R], z[R];
  for (int k = 0; k < R; k++)
  {
    r[k] = b[k] - y[k];
    z[k] = x[k];
  }
  add_scaled(R, inverse, r, z);
  for (int k = 0; k < R; k++)
    y[k] = z[k];
}

/* y = x + S (b - A x) */
INLINE void smooth_(const int R, const int C, int64_t n, const int64_t* start,
                    const int32_t* columns, const float* a, const float* inverse, const double* x,
                    const double* b, double* y)
{
  (void)C;
  for (int64_t i = 0; i < n; i++)
  {
    double r[R], z[R];
    residual(R, i, start, columns, a, x, b, r);
    for (int k = 0; k < R; k++)
      z[k] = 0.0;
    add_scaled(R, inverse + i * R * R, r, z);
    for (int k = 0; k < R; k++)
      y[i * R + k] = x[i * R + k] + z[k];
  }
}
int64_t smooth(int64_t R, int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
               const float a[R * R * start[n] + 1], const float inverse[R * R * n], int64_t nodes,
               const double x[R * nodes], const double b[R * n], double y[R * n])
{
  DISPATCH(R, R, smooth_, n, start, columns, a, inverse, x, b, y);
  return 0;
}

/* y = S b */
INLINE void smooth_first_(const int R, const int C, int64_t n, const float* inverse,
                          const double* b, double* y)
{
  (void)C;
  for (int64_t i = 0; i < n; i++)
  {
    double z[R];
    for (int k = 0; k < R; k++)
      z[k] = 0.0;
    add_scaled(R, inverse + i * R * R, b + i * R, z);
    for (int k = 0; k < R; k++)
      y[i * R + k] = z[k];
  }
}
int64_t smooth_first(int64_t R, int64_t n, const float inverse[R * R * n], const double b[R * n],
                     double y[R * n])
{
  DISPATCH(R, R, smooth_first_, n, inverse, b, y);
  return 0;
}

/* Interpolations have their blocks row by row.  They and vectors of the coarse level have room for
   two entries behind their last ones, which are read as part of four; rows of six are their first
   four and their last four entries. */

/* coarse += P^T r, of one node */
INLINE void restrict_node(const int R, const int C, int64_t first, int64_t last,
                          const int32_t* p_columns, const float* p, const double* r,
                          double* coarse)
{
  for (int64_t l = first; l < last; l++)
  {
    double* at = coarse + (int64_t)C * p_columns[l];
    double4 sum = {0.0}, rest = {0.0};
    for (int k = 0; k < R; k++)
    {
      const float* row = p + (l * R + k) * C;
      __builtin_prefetch(row + AHEAD);
      sum += widened4(*(const float4*)row) * r[k];
      if (C == 6)
        rest += widened4(*(const float4*)(row + 2)) * r[k];
    }
    if (C == 6)
    {
      *(double4*)at += sum;
      *(double2*)(at + 4) += __builtin_shufflevector(rest, rest, 2, 3);
      continue;
    }
    *(double2*)at += __builtin_shufflevector(sum, sum, 0, 1);
    if (C == 3)
      at[2] += sum[2];
  }
}

/* x += P e, of one node */
INLINE void prolong_node(const int R, const int C, int64_t first, int64_t last,
                         const int32_t* p_columns, const float* p, const double* e, double* x)
{
  double4 sum[R], rest[R];
  for (int r = 0; r < R; r++)
    sum[r] = rest[r] = (double4){0.0};
  for (int64_t l = first; l < last; l++)
  {
    const double* at = e + (int64_t)C * p_columns[l];
    for (int r = 0; r < R; r++)
    {
      const float* row = p + (l * R + r) * C;
      __builtin_prefetch(row + AHEAD);
      sum[r] += widened4(*(const float4*)row) * *(const double4*)at;
      if (C == 6)
        rest[r] += widened4(*(const float4*)(row + 2)) * *(const double4*)(at + 2);
    }
  }
  for (int r = 0; r < R; r++)
  {
    x[r] += sum[r][0] + sum[r][1];
    x[r] += C > 2 ? sum[r][2] : 0.0;
    x[r] += C == 6 ? sum[r][3] + rest[r][2] + rest[r][3] : 0.0;
  }
}

/* coarse += P^T (b - A x) */
INLINE void restrict_residual_(const int R, const int C, int64_t n, const int64_t* start,
                      const int32_t* columns, const float* a, const double* x, const double* b,
                      const int64_t* p_start, const int32_t* p_columns, const float* p,
                      double* coarse)
{
  for (int64_t i = 0; i < n; i++)
  {
    double r[R];
    residual(R, i, start, columns, a, x, b, r);
    restrict_node(R, C, p_start[i], p_start[i + 1], p_columns, p, r, coarse);
  }
}
int64_t restrict_residual(int64_t R, int64_t C, int64_t n, const int64_t start[n + 1],
                          const int32_t columns[start[n]], const float a[R * R * start[n] + 1],
                          int64_t nodes, const double x[R * nodes], const double b[R * n],
                          const int64_t p_start[n + 1], const int32_t p_columns[p_start[n]],
                          const float p[R * C * p_start[n] + 2], int64_t groups,
                          double coarse[C * groups + 2])
{
  DISPATCH(R, C, restrict_residual_, n, start, columns, a, x, b, p_start, p_columns, p, coarse);
  return 0;
}

/* x += P e */
INLINE void prolong_(const int R, const int C, int64_t n, const int64_t* p_start,
                     const int32_t* p_columns, const float* p, const double* e, double* x)
{
  for (int64_t i = 0; i < n; i++)
    prolong_node(R, C, p_start[i], p_start[i + 1], p_columns, p, e, x + i * R);
}
int64_t prolong(int64_t R, int64_t C, int64_t n, const int64_t p_start[n + 1],
                const int32_t p_columns[p_start[n]], const float p[R * C * p_start[n] + 2],
                int64_t groups, const double e[C * groups + 2], double x[R * n])
{
  DISPATCH(R, C, prolong_, n, p_start, p_columns, p, e, x);
  return 0;
}

/* The blocks of some rows of a matrix by the half of its blocks, see halves.h. */
INLINE void rows_of_half_(const int R, const int C, int64_t first, int64_t count,
                          const int64_t* full, const int32_t* full_columns, const int32_t* source,
                          const double* half, double* blocks)
{
  for (int64_t i = first; i < first + count; i++)
    for (int64_t p = full[i]; p < full[i + 1]; p++, blocks += R * C)
    {
      const double* a = half + (int64_t)source[p] * R * C;
      if (full_columns[p] >= i)
        memcpy(blocks, a, sizeof(double) * R * C);
      else
        for (int r = 0; r < R; r++)
          for (int c = 0; c < C; c++)
            blocks[r * C + c] = a[c * R + r];
    }
}
int64_t rows_of_half(int64_t R, int64_t first, int64_t count,
                     const int64_t full[first + count + 1],
                     const int32_t full_columns[full[first + count]],
                     const int32_t source[full[first + count]], int64_t stored,
                     const double half[R * R * stored],
                     double blocks[R * R * (full[first + count] - full[first])])
{
  DISPATCH(R, R, rows_of_half_, first, count, full, full_columns, source, half, blocks);
  return 0;
}

/* y = A x with blocks in double precision, row by row. */
INLINE void product_of_half_(const int R, const int C, int64_t n, const int64_t* start,
                             const int32_t* columns, const double* half, const double* x,
                             double* y)
{
  (void)C;
  memset(y, 0, sizeof(double) * R * n);
  for (int64_t i = 0; i < n; i++)
    for (int64_t k = start[i]; k < start[i + 1]; k++)
    {
      const int64_t j = columns[k];
      const double* a = half + k * R * R;
      double t[R];
      for (int c = 0; c < R; c++)
        t[c] = 0.0;
      for (int r = 0; r < R; r++)
      {
        double s = 0.0;
        for (int c = 0; c < R; c++)
        {
          s += a[r * R + c] * x[j * R + c];
          t[c] += a[r * R + c] * x[i * R + r];
        }
        y[i * R + r] += s;
      }
      if (j > i && j < n)
        for (int c = 0; c < R; c++)
          y[j * R + c] += t[c];
    }
}
int64_t product_of_half(int64_t R, int64_t n, const int64_t start[n + 1],
                        const int32_t columns[start[n]], const double half[R * R * start[n]],
                        int64_t nodes, const double x[R * nodes], double y[R * n])
{
  DISPATCH(R, R, product_of_half_, n, start, columns, half, x, y);
  return 0;
}

/* What row i of A x adds to y, with blocks of 6x6, two columns of which are three vectors of
   four: the first four of one, its last two and the first two of the other, and the last four of
   that. */
INLINE void multiply_row_of_six(int64_t i, int64_t n, const int64_t* start, const int32_t* columns,
                                const float* half, const double* x, double* y)
{
  const double4 first = *(const double4*)(x + 6 * i), last = *(const double4*)(x + 6 * i + 2);
  const double4 middle = __builtin_shufflevector(last, first, 2, 3, 4, 5);
  double4 s[3] = {{0.0}, {0.0}, {0.0}};
  for (int64_t k = start[i]; k < start[i + 1]; k++)
  {
    const int64_t j = columns[k];
    const float* a = half + k * 36;
    double4 t[3];
    for (int l = 0; l < 3; l++, a += 12)
    {
      __builtin_prefetch(a + AHEAD);
      const double one = x[6 * j + 2 * l], two = x[6 * j + 2 * l + 1];
      const double4 p = widened4(*(const float4*)a), q = widened4(*(const float4*)(a + 4));
      const double4 r = widened4(*(const float4*)(a + 8)), u = p * first, v = r * last;
      s[0] += p * one;
      s[1] += q * (double4){one, one, two, two};
      s[2] += r * two;
      t[l] = q * middle + __builtin_shufflevector(u, v, 0, 1, 4, 5)
             + __builtin_shufflevector(u, v, 2, 3, 6, 7);
    }
    if (j > i && j < n)
    {
      *(double4*)(y + 6 * j) += __builtin_shufflevector(t[0], t[1], 0, 2, 4, 6)
                                + __builtin_shufflevector(t[0], t[1], 1, 3, 5, 7);
      *(double2*)(y + 6 * j + 4) += __builtin_shufflevector(t[2], t[2], 0, 2)
                                    + __builtin_shufflevector(t[2], t[2], 1, 3);
    }
  }
  *(double4*)(y + 6 * i) += s[0] + __builtin_shufflevector(s[1], s[2], 2, 3, 4, 5);
  *(double2*)(y + 6 * i + 4)
      += __builtin_shufflevector(s[1], s[1], 0, 1) + __builtin_shufflevector(s[2], s[2], 2, 3);
}

/* What row i of A x adds to y, of a matrix by the half of its blocks, in single precision, column
   by column.  With it y is complete at node i: rows before have added what they have for it. */
INLINE void multiply_row_of_half(const int R, int64_t i, int64_t n, const int64_t* start,
                                 const int32_t* columns, const float* half, const double* x,
                                 double* y)
{
  if (R == 6)
    multiply_row_of_six(i, n, start, columns, half, x, y);
  else if (R == 3)
    multiply_row_of_three(0, i, n, start, columns, half, half, x, y);
  else
    for (int64_t k = start[i]; k < start[i + 1]; k++)
    {
      const int64_t j = columns[k];
      for (int c = 0; c < R; c++)
        for (int r = 0; r < R; r++)
        {
          const double a = half[(k * R + c) * R + r];
          y[i * R + r] += a * x[j * R + c];
          if (j > i && j < n)
            y[j * R + c] += a * x[i * R + r];
        }
    }
}

/* y = x + S (b - A x) */
INLINE void smooth_of_half_(const int R, const int C, int64_t n, const int64_t* start,
                            const int32_t* columns, const float* half, const float* inverse,
                            const double* x, const double* b, double* y)
{
  (void)C;
  memset(y, 0, sizeof(double) * R * n);
  for (int64_t i = 0; i < n; i++)
  {
    multiply_row_of_half(R, i, n, start, columns, half, x, y);
    correct(R, inverse + i * R * R, x + i * R, b + i * R, y + i * R);
  }
}
int64_t smooth_of_half(int64_t R, int64_t n, const int64_t start[n + 1],
                       const int32_t columns[start[n]], const float half[R * R * start[n] + R / 3],
                       const float inverse[R * R * n], int64_t nodes, const double x[R * nodes],
                       const double b[R * n], double y[R * n])
{
  DISPATCH(R, R, smooth_of_half_, n, start, columns, half, inverse, x, b, y);
  return 0;
}

/* coarse += P^T (b - A x); y is room */
INLINE void restrict_residual_of_half_(const int R, const int C, int64_t n, const int64_t* start,
                                       const int32_t* columns, const float* half, const double* x,
                                       const double* b, const int64_t* p_start,
                                       const int32_t* p_columns, const float* p, double* coarse,
                                       double* y)
{
  memset(y, 0, sizeof(double) * R * n);
  for (int64_t i = 0; i < n; i++)
  {
    multiply_row_of_half(R, i, n, start, columns, half, x, y);
    double r[R];
    for (int k = 0; k < R; k++)
      r[k] = b[i * R + k] - y[i * R + k];
    restrict_node(R, C, p_start[i], p_start[i + 1], p_columns, p, r, coarse);
  }
}
int64_t restrict_residual_of_half(int64_t R, int64_t C, int64_t n, const int64_t start[n + 1],
                                  const int32_t columns[start[n]],
                                  const float half[R * R * start[n] + R / 3], int64_t nodes,
                                  const double x[R * nodes], const double b[R * n],
                                  const int64_t p_start[n + 1], const int32_t p_columns[p_start[n]],
                                  const float p[R * C * p_start[n] + 2], int64_t groups,
                                  double coarse[C * groups + 2], double y[R * n])
{
  DISPATCH(R, C, restrict_residual_of_half_, n, start, columns, half, x, b, p_start, p_columns, p,
           coarse, y);
  return 0;
}

/* --- The cycle for eight right-hand sides at once: in place of each number of a vector there are
   those of eight vectors, side by side.  In single precision: a cycle is an approximate inverse,
   and reads and writes its vectors more often than the matrix. --- */

/* See halves.h. */
int64_t side_by_side(int64_t count, int64_t n, const double vectors[count * n], float eight[8 * n])
{
  PUT_SIDE_BY_SIDE(count, n, vectors, eight);
  return 0;
}
int64_t one_below_the_other(int64_t count, int64_t n, const float eight[8 * n],
                            double vectors[count * n])
{
  PUT_ONE_BELOW_THE_OTHER(count, n, eight, vectors);
  return 0;
}

INLINE void row_times_eight(const int R, int64_t first, int64_t last, const int32_t* columns,
                            const float* a, const float8* x, float8* y)
{
  for (int64_t k = first; k < last; k++)
    for (int c = 0; c < R; c++)
    {
      const float8 v = x[((int64_t)R * columns[k] + c)];
      for (int r = 0; r < R; r++)
        y[r] += a[(k * R + c) * R + r] * v;
    }
}

/* z + S r */
INLINE void add_scaled_eight(const int R, const float* inverse, const float8* r, float8* z)
{
  for (int c = 0; c < R; c++)
    for (int k = 0; k < R; k++)
      z[k] += inverse[c * R + k] * r[c];
}

/* r = b - A x, of one node */
INLINE void residual_eight(const int R, int64_t i, const int64_t* start, const int32_t* columns,
                           const float* a, const float8* x, const float8* b, float8* r)
{
  for (int k = 0; k < R; k++)
    r[k] = (float8){0.0};
  row_times_eight(R, start[i], start[i + 1], columns, a, x, r);
  for (int k = 0; k < R; k++)
    r[k] = b[i * R + k] - r[k];
}

/* coarse += P^T r, of one node */
INLINE void restrict_node_eight(const int R, const int C, int64_t first, int64_t last,
                                const int32_t* p_columns, const float* p, const float8* r,
                                float8* coarse)
{
  for (int64_t l = first; l < last; l++)
    for (int c = 0; c < C; c++)
    {
      float8 sum = {0.0};
      for (int k = 0; k < R; k++)
        sum += p[(l * R + k) * C + c] * r[k];
      coarse[((int64_t)C * p_columns[l] + c)] += sum;
    }
}

/* y = S b */
INLINE void smooth_first_eight_(const int R, const int C, int64_t n, const float* inverse,
                                const float8* b, float8* y)
{
  (void)C;
  for (int64_t i = 0; i < n; i++)
  {
    float8 r[R];
    for (int k = 0; k < R; k++)
    {
      r[k] = b[i * R + k];
      y[i * R + k] = (float8){0.0};
    }
    add_scaled_eight(R, inverse + i * R * R, r, y + i * R);
  }
}
int64_t smooth_first_eight(int64_t R, int64_t n, const float inverse[R * R * n],
                           const float b[8 * R * n], float y[8 * R * n])
{
  DISPATCH(R, R, smooth_first_eight_, n, inverse, (const float8*)b, (float8*)y);
  return 0;
}

/* y = x + S (b - y), of one node, where y is A x */
INLINE void correct_eight(const int R, const float* inverse, const float8* x, const float8* b,
                          float8* y)
{
  float8 r[R];
  for (int k = 0; k < R; k++)
  {
    r[k] = b[k] - y[k];
    y[k] = x[k];
  }
  add_scaled_eight(R, inverse, r, y);
}

/* y = x + S (b - A x) */
INLINE void smooth_eight_(const int R, const int C, int64_t n, const int64_t* start,
                          const int32_t* columns, const float* a, const float* inverse,
                          const float8* x, const float8* b, float8* y)
{
  (void)C;
  for (int64_t i = 0; i < n; i++)
  {
    float8 r[R];
    residual_eight(R, i, start, columns, a, x, b, r);
    for (int k = 0; k < R; k++)
      y[i * R + k] = x[i * R + k];
    add_scaled_eight(R, inverse + i * R * R, r, y + i * R);
  }
}
int64_t smooth_eight(int64_t R, int64_t n, const int64_t start[n + 1],
                     const int32_t columns[start[n]], const float a[R * R * start[n] + 1],
                     const float inverse[R * R * n], int64_t nodes, const float x[8 * R * nodes],
                     const float b[8 * R * n], float y[8 * R * n])
{
  DISPATCH(R, R, smooth_eight_, n, start, columns, a, inverse, (const float8*)x,
           (const float8*)b, (float8*)y);
  return 0;
}

/* coarse += P^T (b - A x) */
INLINE void restrict_residual_eight_(const int R, const int C, int64_t n, const int64_t* start,
                                     const int32_t* columns, const float* a, const float8* x,
                                     const float8* b, const int64_t* p_start,
                                     const int32_t* p_columns, const float* p, float8* coarse)
{
  for (int64_t i = 0; i < n; i++)
  {
    float8 r[R];
    residual_eight(R, i, start, columns, a, x, b, r);
    restrict_node_eight(R, C, p_start[i], p_start[i + 1], p_columns, p, r, coarse);
  }
}
int64_t restrict_residual_eight(int64_t R, int64_t C, int64_t n, const int64_t start[n + 1],
                                const int32_t columns[start[n]],
                                const float a[R * R * start[n] + 1], int64_t nodes,
                                const float x[8 * R * nodes], const float b[8 * R * n],
                                const int64_t p_start[n + 1], const int32_t p_columns[p_start[n]],
                                const float p[R * C * p_start[n] + 2], int64_t groups,
                                float coarse[8 * C * groups])
{
  DISPATCH(R, C, restrict_residual_eight_, n, start, columns, a, (const float8*)x,
           (const float8*)b, p_start, p_columns, p, (float8*)coarse);
  return 0;
}

/* x += P e */
INLINE void prolong_eight_(const int R, const int C, int64_t n, const int64_t* p_start,
                           const int32_t* p_columns, const float* p, const float8* e, float8* x)
{
  for (int64_t i = 0; i < n; i++)
  {
    float8 sum[R];
    for (int k = 0; k < R; k++)
      sum[k] = x[i * R + k];
    for (int64_t l = p_start[i]; l < p_start[i + 1]; l++)
      for (int c = 0; c < C; c++)
      {
        const float8 v = e[((int64_t)C * p_columns[l] + c)];
        for (int k = 0; k < R; k++)
          sum[k] += p[(l * R + k) * C + c] * v;
      }
    for (int k = 0; k < R; k++)
      x[i * R + k] = sum[k];
  }
}
int64_t prolong_eight(int64_t R, int64_t C, int64_t n, const int64_t p_start[n + 1],
                      const int32_t p_columns[p_start[n]], const float p[R * C * p_start[n] + 2],
                      int64_t groups, const float e[8 * C * groups], float x[8 * R * n])
{
  DISPATCH(R, C, prolong_eight_, n, p_start, p_columns, p, (const float8*)e, (float8*)x);
  return 0;
}

/* What row i of A x adds to y, of a matrix by the half of its blocks. */
INLINE void multiply_row_of_half_eight(const int R, int64_t i, int64_t n, const int64_t* start,
                                       const int32_t* columns, const float* half, const float8* x,
                                       float8* y)
{
  float8 own[R], s[R];
  for (int r = 0; r < R; r++)
  {
    own[r] = x[i * R + r];
    s[r] = (float8){0.0};
  }
  for (int64_t k = start[i]; k < start[i + 1]; k++)
  {
    const int64_t j = columns[k];
    const int both = j > i && j < n;
    for (int c = 0; c < R; c++)
    {
      float8 t = {0.0};
      for (int r = 0; r < R; r++)
      {
        const float a = half[(k * R + c) * R + r];
        s[r] += a * x[j * R + c];
        t += a * own[r];
      }
      if (both)
        y[j * R + c] += t;
    }
  }
  for (int r = 0; r < R; r++)
    y[i * R + r] += s[r];
}

/* y = x + S (b - A x) */
INLINE void smooth_of_half_eight_(const int R, const int C, int64_t n, const int64_t* start,
                                  const int32_t* columns, const float* half, const float* inverse,
                                  const float8* x, const float8* b, float8* y)
{
  (void)C;
  for (int64_t i = 0; i < n; i++)
  {
    multiply_row_of_half_eight(R, i, n, start, columns, half, x, y);
    const int64_t at = i * R;
    correct_eight(R, inverse + i * R * R, x + at, b + at, y + at);
  }
}
int64_t smooth_of_half_eight(int64_t R, int64_t n, const int64_t start[n + 1],
                             const int32_t columns[start[n]],
                             const float half[R * R * start[n] + R / 3],
                             const float inverse[R * R * n], int64_t nodes,
                             const float x[8 * R * nodes], const float b[8 * R * n],
                             float y[8 * R * n])
{
  memset(y, 0, sizeof(float) * 8 * R * n);
  DISPATCH(R, R, smooth_of_half_eight_, n, start, columns, half, inverse, (const float8*)x,
           (const float8*)b, (float8*)y);
  return 0;
}

/* coarse += P^T (b - A x); y is room */
INLINE void restrict_residual_of_half_eight_(const int R, const int C, int64_t n,
                                             const int64_t* start, const int32_t* columns,
                                             const float* half, const float8* x, const float8* b,
                                             const int64_t* p_start, const int32_t* p_columns,
                                             const float* p, float8* coarse, float8* y)
{
  for (int64_t i = 0; i < n; i++)
  {
    multiply_row_of_half_eight(R, i, n, start, columns, half, x, y);
    float8 r[R];
    for (int k = 0; k < R; k++)
      r[k] = b[i * R + k] - y[i * R + k];
    restrict_node_eight(R, C, p_start[i], p_start[i + 1], p_columns, p, r, coarse);
  }
}
int64_t restrict_residual_of_half_eight(
    int64_t R, int64_t C, int64_t n, const int64_t start[n + 1], const int32_t columns[start[n]],
    const float half[R * R * start[n] + R / 3], int64_t nodes, const float x[8 * R * nodes],
    const float b[8 * R * n], const int64_t p_start[n + 1], const int32_t p_columns[p_start[n]],
    const float p[R * C * p_start[n] + 2], int64_t groups, float coarse[8 * C * groups],
    float y[8 * R * n])
{
  memset(y, 0, sizeof(float) * 8 * R * n);
  DISPATCH(R, C, restrict_residual_of_half_eight_, n, start, columns, half, (const float8*)x,
           (const float8*)b, p_start, p_columns, p, (float8*)coarse, (float8*)y);
  return 0;
}
