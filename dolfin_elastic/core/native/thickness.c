/* The loops over cells of the thickness of a body; formulas: see `thickness`.

   DIM.  Rows of vertices have the components of a symmetric tensor, column by column of its upper
   triangle, and are padded to whole vector registers.  Those of the boundary's density, which walk
   far, are of single precision: the walk is bound by their memory, and a thickness is wanted to two
   digits.  Those of the edges are not: across flat cells a component is a small difference. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#define NC (DIM + 1)
#define NT (DIM * (DIM + 1) / 2)
#define ROW (DIM == 3 ? 8 : 4)

/* Volumes of straight cells. */
int64_t take_volumes(int64_t count, int64_t width, const int32_t geometry[count * width],
                     int64_t points, const double x[3 * points], double volumes[count])
{
  for (int64_t c = 0; c < count; c++)
  {
    double e[DIM][DIM];
    const double* origin = x + 3 * (int64_t)geometry[c * width];
    for (int k = 0; k < DIM; k++)
      for (int d = 0; d < DIM; d++)
        e[k][d] = x[3 * (int64_t)geometry[c * width + k + 1] + d] - origin[d];
#if DIM == 3
    const double det = e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1])
                       + e[0][1] * (e[1][2] * e[2][0] - e[1][0] * e[2][2])
                       + e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0]);
    volumes[c] = fabs(det) / 6.0;
#else
    volumes[c] = fabs(e[0][0] * e[1][1] - e[0][1] * e[1][0]) / 2.0;
#endif
  }
  return 0;
}

/* Mean over the edges e of each cell of e e, times its volume, and the volume, to its vertices.
   The sum over the edges is DIM + 1 times that over the corners, taken from the barycentre. */
int64_t add_cells(int64_t count, int64_t width, const int32_t geometry[count * width],
                  int64_t points, const double x[3 * points], const int32_t vertices[NC * count],
                  const double volumes[count], int64_t rows, double sums[ROW * rows])
{
  for (int64_t c = 0; c < count; c++)
  {
    double arms[NC][DIM], middle[DIM] = {0}, found[ROW] = {0};
    for (int k = 0; k < NC; k++)
      for (int d = 0; d < DIM; d++)
      {
        arms[k][d] = x[3 * (int64_t)geometry[c * width + k] + d];
        middle[d] += arms[k][d] / NC;
      }
    int t = 0;
    for (int j = 0; j < DIM; j++)
      for (int i = 0; i <= j; i++, t++)
      {
        for (int k = 0; k < NC; k++)
          found[t] += (arms[k][i] - middle[i]) * (arms[k][j] - middle[j]);
        found[t] *= 2.0 / DIM * volumes[c];
      }
    found[NT] = volumes[c];
    for (int k = 0; k < NC; k++)
    {
      double* restrict sum = sums + (int64_t)vertices[c * NC + k] * ROW;
      for (int i = 0; i < ROW; i++)
        sum[i] += found[i];
    }
  }
  return 0;
}

/* The mean of the rows of each cell's vertices, times its volume, to its vertices. */
#define STEP(REAL)                                                                                \
  for (int64_t c = 0; c < count; c++)                                                             \
  {                                                                                               \
    REAL mean[ROW] = {0};                                                                         \
    for (int k = 0; k < NC; k++)                                                                  \
    {                                                                                             \
      const REAL* restrict row = before + (int64_t)vertices[c * NC + k] * ROW;                    \
      for (int i = 0; i < ROW; i++)                                                               \
        mean[i] += row[i];                                                                        \
    }                                                                                             \
    const REAL share = (REAL)(volumes[c] / NC);                                                   \
    for (int i = 0; i < ROW; i++)                                                                 \
      mean[i] *= share;                                                                           \
    for (int k = 0; k < NC; k++)                                                                  \
    {                                                                                             \
      REAL* restrict sum = sums + (int64_t)vertices[c * NC + k] * ROW;                            \
      for (int i = 0; i < ROW; i++)                                                               \
        sum[i] += mean[i];                                                                        \
    }                                                                                             \
  }                                                                                               \
  return 0;

int64_t step(int64_t count, const int32_t vertices[NC * count], const double volumes[count],
             int64_t rows, const double before[ROW * rows], double sums[ROW * rows])
{
  STEP(double)
}

int64_t rounded_step(int64_t count, const int32_t vertices[NC * count],
                     const double volumes[count], int64_t rows, const float before[ROW * rows],
                     float sums[ROW * rows])
{
  STEP(float)
}

/* Chebyshev polynomial of 2 S - 1 of some degree, 2 (2 S - 1) now - before, and what it adds to a
   sum with weights, where S now is the sums of a step by the inverse of each vertex's volume. */
int64_t next_polynomial(int64_t count, const float inverse[count], const float sums[ROW * count],
                        int64_t degree, const float weights[degree + 1], float before[ROW * count],
                        float now[ROW * count], float found[ROW * count])
{
  const float weight = weights[degree];
  for (int64_t n = 0; n < count; n++)
  {
    const float four = 4 * inverse[n];
    for (int64_t i = ROW * n; i < ROW * (n + 1); i++)
    {
      const float new = four * sums[i] - 2 * now[i] - before[i];
      before[i] = now[i];
      now[i] = new;
      found[i] += weight * new;
    }
  }
  return 0;
}

#define CELL_MEAN(NAME, REAL)                                                                     \
  static inline void NAME(const int32_t* vertices, const REAL* rows, double mean[DIM][DIM])       \
  {                                                                                               \
    double sum[NT] = {0};                                                                         \
    int t = 0;                                                                                    \
    for (int k = 0; k < NC; k++)                                                                  \
      for (int i = 0; i < NT; i++)                                                                \
        sum[i] += rows[(int64_t)vertices[k] * ROW + i] / NC;                                      \
    for (int j = 0; j < DIM; j++)                                                                 \
      for (int i = 0; i <= j; i++, t++)                                                           \
        mean[i][j] = mean[j][i] = sum[t];                                                         \
  }

CELL_MEAN(cell_mean, double)
CELL_MEAN(rounded_cell_mean, float)

/* Eigenvalues on the diagonal and eigenvectors in columns, by cyclic rotations of Jacobi:
   G. H. Golub and C. F. Van Loan, Matrix Computations (2013), section 8.5. */
static inline void eigenvectors(double A[DIM][DIM], double V[DIM][DIM])
{
  for (int i = 0; i < DIM; i++)
    for (int j = 0; j < DIM; j++)
      V[i][j] = i == j;
  for (int sweep = 0; sweep < 12; sweep++)
  {
    double off = 0.0, diagonal = 0.0;
    for (int i = 0; i < DIM; i++)
    {
      diagonal += A[i][i] * A[i][i];
      for (int j = 0; j < i; j++)
        off += A[i][j] * A[i][j];
    }
    if (!(off > 1e-32 * diagonal))
      return;
    for (int p = 0; p < DIM; p++)
      for (int q = p + 1; q < DIM; q++)
      {
        if (A[p][q] == 0.0)
          continue;
        const double tau = (A[q][q] - A[p][p]) / (2.0 * A[p][q]);
        const double t = (tau >= 0 ? 1.0 : -1.0) / (fabs(tau) + sqrt(1.0 + tau * tau));
        const double c = 1.0 / sqrt(1.0 + t * t), s = t * c;
        for (int i = 0; i < DIM; i++)
        {
          const double a = A[i][p], b = A[i][q], v = V[i][p], w = V[i][q];
          A[i][p] = c * a - s * b;
          A[i][q] = s * a + c * b;
          V[i][p] = c * v - s * w;
          V[i][q] = s * v + c * w;
        }
        for (int i = 0; i < DIM; i++)
        {
          const double a = A[p][i], b = A[q][i];
          A[p][i] = c * a - s * b;
          A[q][i] = s * a + c * b;
        }
        A[p][q] = A[q][p] = 0.0;
      }
  }
}

/* Component of a tensor along two directions. */
static inline double component(double M[DIM][DIM], double V[DIM][DIM], int a, int b)
{
  double sum = 0.0;
  for (int i = 0; i < DIM; i++)
    for (int j = 0; j < DIM; j++)
      sum += V[i][a] * M[i][j] * V[j][b];
  return sum;
}

int64_t at_cells(int64_t count, const int32_t vertices[NC * count], int64_t rows,
                 const float density[ROW * rows], const double metric[ROW * rows],
                 double thickness[count], double across[count], double along[count])
{
  double A[DIM][DIM], M[DIM][DIM], V[DIM][DIM];
  for (int64_t c = 0; c < count; c++)
  {
    rounded_cell_mean(vertices + c * NC, density, A);
    cell_mean(vertices + c * NC, metric, M);
    eigenvectors(A, V);
    int top = 0;
    for (int i = 1; i < DIM; i++)
      if (A[i][i] >= A[top][top])
        top = i;
    thickness[c] = A[top][top] > 0 ? 2.0 / A[top][top] : INFINITY;
    across[c] = sqrt(component(M, V, top, top));
    const int a = (top + 1) % DIM, b = (top + 2) % DIM;
    const double aa = component(M, V, a, a), bb = component(M, V, b, b);
    const double ab = component(M, V, a, b), half = (aa - bb) / 2;
    along[c] = sqrt(DIM == 3 ? (aa + bb) / 2 + sqrt(half * half + ab * ab) : aa);
  }
  return 0;
}
