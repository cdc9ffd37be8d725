/* The loops over cells of the patch recovery and of the estimated error.

   Formulas: see `patches` and `error`.  Sums over the cells of a patch are added up in place, so
   that no array has a row for each corner of each cell.

   DIM, DEGREE, NG geometry nodes and ND nodes of a cell, NS sampling points, NM monomials, and at
   most WIDEST columns. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#define NC (DIM + 1)

/* Places of points of a cell, by the shape functions of its geometry there. */
static inline void places(const int32_t* nodes, const double* x, const double* restrict shape,
                          int points, double X[][DIM])
{
  for (int s = 0; s < points; s++)
    for (int d = 0; d < DIM; d++)
    {
      double sum = 0.0;
      for (int n = 0; n < NG; n++)
        sum += shape[s * NG + n] * x[3 * (int64_t)nodes[n] + d];
      X[s][d] = sum;
    }
}

/* Monomials about a vertex; returns the square of the distance over the size of the patch. */
static inline double monomials(const double X[DIM], const double* restrict centre, double size,
                               double p[NM])
{
  double square = 0.0;
  p[0] = 1.0;
  for (int d = 0; d < DIM; d++)
  {
    p[1 + d] = (X[d] - centre[d]) / size;
    square += p[1 + d] * p[1 + d];
  }
#if DEGREE > 1
  int m = DIM + 1;
  for (int i = 0; i < DIM; i++)
    for (int j = i; j < DIM; j++)
      p[m++] = p[1 + i] * p[1 + j];
#endif
  return square;
}

int64_t add_spread(int64_t count, const int32_t cells[count], int64_t every,
                   const int32_t geometry[NG * every], int64_t nodes, const double x[3 * nodes],
                   const double samples[NS * NG], const int32_t corners[NC * count],
                   int64_t vertices, const double centres[DIM * vertices],
                   double sums[2 * vertices])
{
  double X[NS][DIM];
  for (int64_t n = 0; n < count; n++)
  {
    places(geometry + (int64_t)cells[n] * NG, x, samples, NS, X);
    for (int k = 0; k < NC; k++)
    {
      const int64_t v = corners[n * NC + k];
      sums[2 * v] += NS;
      for (int s = 0; s < NS; s++)
        for (int d = 0; d < DIM; d++)
        {
          const double y = X[s][d] - centres[v * DIM + d];
          sums[2 * v + 1] += y * y;
        }
    }
  }
  return 0;
}

int64_t add_products(int64_t count, const int32_t cells[count], int64_t every,
                     const int32_t geometry[NG * every], int64_t nodes, const double x[3 * nodes],
                     const double samples[NS * NG], const int32_t corners[NC * count],
                     int64_t vertices, const double centres[DIM * vertices],
                     const double size[vertices], double sums[NM * NM * vertices])
{
  double X[NS][DIM], p[NM];
  for (int64_t n = 0; n < count; n++)
  {
    places(geometry + (int64_t)cells[n] * NG, x, samples, NS, X);
    for (int k = 0; k < NC; k++)
    {
      const int64_t v = corners[n * NC + k];
      double* sum = sums + v * NM * NM;
      for (int s = 0; s < NS; s++)
      {
        const double weight = exp(-monomials(X[s], centres + v * DIM, size[v], p));
        for (int i = 0; i < NM; i++)
          for (int j = 0; j < NM; j++)
            sum[i * NM + j] += weight * p[i] * p[j];
      }
    }
  }
  return 0;
}

/* Inverse of the leading block of a symmetric matrix by A = L L^T, in the leading block of
   `inverse`; whether the traces of both have a product below the limit. */
static inline int invert_leading(int kept, double limit, const double* restrict A,
                                 double* restrict inverse)
{
  double L[NM][NM], M[NM][NM] = {{0.0}}, trace = 0.0, of_inverse = 0.0;
  for (int i = 0; i < kept; i++)
  {
    trace += A[i * NM + i];
    for (int j = 0; j <= i; j++)
    {
      double sum = A[i * NM + j];
      for (int k = 0; k < j; k++)
        sum -= L[i][k] * L[j][k];
      if (i == j && !(sum > 0.0))
        return 0;
      L[i][j] = i == j ? sqrt(sum) : sum / L[j][j];
    }
    M[i][i] = 1.0 / L[i][i]; /* M = 1 / L */
    for (int j = 0; j < i; j++)
    {
      double sum = 0.0;
      for (int k = j; k < i; k++)
        sum -= L[i][k] * M[k][j];
      M[i][j] = sum * M[i][i];
    }
    for (int j = 0; j <= i; j++)
      of_inverse += M[i][j] * M[i][j];
  }
  if (!(trace * of_inverse < limit))
    return 0;
  for (int i = 0; i < kept; i++)
    for (int j = 0; j < kept; j++)
    {
      double sum = 0.0;
      for (int k = i > j ? i : j; k < kept; k++)
        sum += M[k][i] * M[k][j];
      inverse[i * NM + j] = sum;
    }
  return 1;
}

/* Of each patch, by all monomials, or else by those of the highest degree that can be; the rest of
   `inverses` is zero. */
int64_t invert_products(int64_t count, const double limit[1],
                        const double products[NM * NM * count], double inverses[NM * NM * count],
                        int8_t whole[count])
{
  for (int64_t v = 0; v < count; v++)
  {
    const double* A = products + v * NM * NM;
    double* inverse = inverses + v * NM * NM;
    whole[v] = (int8_t)invert_leading(NM, *limit, A, inverse);
    if (!whole[v] && !(DEGREE > 1 && invert_leading(1 + DIM, *limit, A, inverse)))
      invert_leading(1, *limit, A, inverse);
  }
  return 0;
}

int64_t add_gains(int64_t count, const int32_t cells[count], int64_t every,
                  const int32_t geometry[NG * every], int64_t nodes, const double x[3 * nodes],
                  const double samples[NS * NG], const int32_t corners[NC * count],
                  int64_t vertices, const double centres[DIM * vertices],
                  const double size[vertices], const double solve[NM * NM * vertices],
                  double sums[vertices])
{
  double X[NS][DIM], p[NM];
  for (int64_t n = 0; n < count; n++)
  {
    places(geometry + (int64_t)cells[n] * NG, x, samples, NS, X);
    for (int k = 0; k < NC; k++)
    {
      const int64_t v = corners[n * NC + k];
      const double* first = solve + v * NM * NM;
      for (int s = 0; s < NS; s++)
      {
        const double weight = exp(-monomials(X[s], centres + v * DIM, size[v], p));
        double share = 0.0;
        for (int i = 0; i < NM; i++)
          share += weight * p[i] * first[i];
        sums[v] += fabs(share);
      }
    }
  }
  return 0;
}

int64_t add_moments(int64_t count, const int32_t cells[count], int64_t every,
                    const int32_t geometry[NG * every], int64_t nodes, const double x[3 * nodes],
                    const double samples[NS * NG], const int32_t corners[NC * count],
                    int64_t vertices, const double centres[DIM * vertices],
                    const double size[vertices], int64_t width,
                    const double values[NS * width * count], double sums[NM * width * vertices])
{
  double X[NS][DIM], p[NM];
  for (int64_t n = 0; n < count; n++)
  {
    places(geometry + (int64_t)cells[n] * NG, x, samples, NS, X);
    for (int k = 0; k < NC; k++)
    {
      const int64_t v = corners[n * NC + k];
      double* restrict sum = sums + v * NM * width;
      for (int s = 0; s < NS; s++)
      {
        const double* restrict value = values + (n * NS + s) * width;
        const double weight = exp(-monomials(X[s], centres + v * DIM, size[v], p));
        for (int i = 0; i < NM; i++)
        {
          const double factor = weight * p[i];
          for (int64_t w = 0; w < width; w++)
            sum[i * width + w] += factor * value[w];
        }
      }
    }
  }
  return 0;
}

/* Values of the polynomials at corners, and in the middle of edges the mean of those of both ends;
   for each cell, node and column. */
int64_t take_nodal(int64_t count, const int32_t cells[count], int64_t every,
                   const int32_t geometry[NG * every], int64_t nodes, const double x[3 * nodes],
                   const double shape[ND * NG], const int32_t corners[NC * count],
                   int64_t vertices, const double centres[DIM * vertices],
                   const double size[vertices], const int32_t edges[2 * (ND - NC)], int64_t width,
                   const double fitted[NM * width * vertices], double values[ND * width * count])
{
  double X[ND][DIM], p[NM];
  for (int64_t n = 0; n < count; n++)
  {
    double* cell = values + n * ND * width;
    for (int k = 0; k < NC; k++)
      memcpy(cell + k * width, fitted + corners[n * NC + k] * NM * width, sizeof(double) * width);
    if (ND == NC)
      continue;
    places(geometry + (int64_t)cells[n] * NG, x, shape, ND, X);
    memset(cell + NC * width, 0, sizeof(double) * (ND - NC) * width);
    for (int k = NC; k < ND; k++)
      for (int end = 0; end < 2; end++)
      {
        const int64_t v = corners[n * NC + edges[2 * (k - NC) + end]];
        const double* restrict polynomial = fitted + v * NM * width;
        double* restrict value = cell + k * width;
        monomials(X[k], centres + v * DIM, size[v], p);
        for (int i = 0; i < NM; i++)
        {
          const double factor = 0.5 * p[i];
          for (int64_t w = 0; w < width; w++)
            value[w] += factor * polynomial[i * width + w];
        }
      }
  }
  return 0;
}

/* Sums at the nodes of a space, and in a last column the number of summands. */
int64_t add_nodal(int64_t count, const int32_t cells[count], int64_t every,
                  const int32_t nodes[ND * every], int64_t width,
                  const double values[ND * width * count], int64_t rows,
                  double sums[rows * (width + 1)])
{
  for (int64_t n = 0; n < count; n++)
    for (int k = 0; k < ND; k++)
    {
      double* restrict sum = sums + nodes[(int64_t)cells[n] * ND + k] * (width + 1);
      const double* restrict value = values + (n * ND + k) * width;
      for (int64_t w = 0; w < width; w++)
        sum[w] += value[w];
      sum[width] += 1.0;
    }
  return 0;
}

static inline double determinant(const int32_t* nodes, const double* x,
                                 const double* restrict gradients)
{
  double j[DIM][DIM] = {{0}};
  for (int n = 0; n < NG; n++)
    for (int d = 0; d < DIM; d++)
      for (int m = 0; m < DIM; m++)
        j[d][m] += x[3 * (int64_t)nodes[n] + d] * gradients[n * DIM + m];
#if DIM == 3
  return j[0][0] * (j[1][1] * j[2][2] - j[1][2] * j[2][1])
         + j[0][1] * (j[1][2] * j[2][0] - j[1][0] * j[2][2])
         + j[0][2] * (j[1][0] * j[2][1] - j[1][1] * j[2][0]);
#else
  return j[0][0] * j[1][1] - j[0][1] * j[1][0];
#endif
}

static inline double work(int64_t pairs, const double* shares, const double* values)
{
  double sum = 0.0;
  for (int64_t i = 0; i < pairs; i++)
    sum += shares[i] * values[6 + i] * values[6 + pairs + i];
  return fabs(0.5 * sum);
}

/* Of each cell the energy of the error, the elastic one, the integral of the square of the error's
   von Mises stress, and the volume; and the recovered stress at nodes less that of the cell.
   The raw values of a cell are `stride` rows, of which those of its points begin with `first` and
   lie `step` apart: 0 where they are the same at all points. */
int64_t add_errors(int64_t count, const int32_t cells[count], int64_t every,
                   const int32_t geometry[NG * every], int64_t nodes, const double x[3 * nodes],
                   int64_t points, const double gradients[points * NG * DIM],
                   const double weights[points], const double shape[points * ND],
                   const double to_nodes[ND * points], int64_t width, int64_t pairs,
                   const double shares[pairs], int64_t weighted,
                   const double recovered[ND * width * count], int64_t stride, int64_t first,
                   int64_t step, const double raw[stride * width * count], double found[4 * count],
                   double difference[6 * ND * count])
{
  double off[WIDEST];
  for (int64_t n = 0; n < count; n++)
  {
    const double* at_nodes = recovered + n * ND * width;
    const double* values = raw + (n * stride + first) * width;
    double sums[4] = {0};
    for (int64_t q = 0; q < points; q++)
    {
      const double* restrict value = values + q * step * width;
      for (int64_t w = 0; w < width; w++)
        off[w] = -value[w];
      for (int k = 0; k < ND; k++)
      {
        const double factor = shape[q * ND + k];
        const double* restrict row = at_nodes + k * width;
        for (int64_t w = 0; w < width; w++)
          off[w] += factor * row[w];
      }
      double size = weights[q] * fabs(determinant(geometry + (int64_t)cells[n] * NG, x,
                                                  gradients + q * NG * DIM));
      const double a = off[0] - off[1], b = off[1] - off[2], c = off[2] - off[0];
      sums[2] += size * ((a * a + b * b + c * c) / 2
                         + 3 * (off[3] * off[3] + off[4] * off[4] + off[5] * off[5]));
      sums[3] += size;
      if (weighted)
        size *= value[width - 1];
      sums[0] += size * work(pairs, shares, off);
      sums[1] += size * work(pairs, shares, value);
    }
    memcpy(found + 4 * n, sums, sizeof(sums));
    for (int k = 0; k < ND; k++)
    {
      double* restrict left = difference + (n * ND + k) * 6;
      memcpy(left, at_nodes + k * width, 6 * sizeof(double));
      for (int64_t q = 0; q < points; q++)
        for (int w = 0; w < 6; w++)
          left[w] -= to_nodes[k * points + q] * values[q * step * width + w];
    }
  }
  return 0;
}
