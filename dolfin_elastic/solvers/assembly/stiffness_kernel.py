"""The C code that turns elastic moduli at points into element stiffnesses and adds them up.

    K_ai,bk = sum over points  w |det dX/dxi|  dN_a/dX_J  A_iJkL  dN_b/dX_L

Source: Belytschko, Liu & Moran, Nonlinear Finite Elements (2000), (6.4.6), with A = dP/dF in place
of its material and geometric parts.
"""

from __future__ import annotations

DECLARATIONS = """
int64_t find_places(int64_t count, const int32_t* cells, const int32_t* nodes,
                    const int64_t* start, const int32_t* columns, uint16_t* places);
int64_t add_stiffness(int64_t count, const int32_t* cells, const int32_t* corners, const double* x,
                      const int32_t* nodes, const double* moduli, const double* tables,
                      const double* geometry_tables, const double* weights, const int8_t* fixed,
                      const int64_t* start, const uint16_t* places, double* values);
int64_t add_product(int64_t count, const int32_t* cells, const int32_t* corners, const double* x,
                    const int32_t* nodes, const double* moduli, const double* tables,
                    const double* geometry_tables, const double* weights, const double* direction,
                    double* product);
"""

# All sizes are known to the compiler, which unrolls and vectorises the innermost loops over b.
SOURCE = r"""
#include <math.h>
#include <stdint.h>
#include <string.h>

/* Place of node b's first column within the rows of node a, for all pairs of a cell's nodes.
   Columns are sorted within a row; the rows of a node have the same columns. */
int64_t find_places(int64_t count, const int32_t* cells, const int32_t* nodes,
                    const int64_t* start, const int32_t* columns, uint16_t* places)
{
  for (int64_t n = 0; n < count; n++)
    for (int a = 0; a < ND; a++)
    {
      const int64_t c = cells[n];
      const int64_t row = (int64_t)DIM * nodes[c * ND + a];
      for (int b = 0; b < ND; b++)
      {
        const int32_t column = DIM * nodes[c * ND + b];
        int64_t low = start[row], high = start[row + 1];
        while (low < high)
        {
          const int64_t middle = (low + high) / 2;
          if (columns[middle] < column)
            low = middle + 1;
          else
            high = middle;
        }
        if (low == start[row + 1] || columns[low] != column || low - start[row] > UINT16_MAX)
          return c;
        places[(c * ND + a) * ND + b] = (uint16_t)(low - start[row]);
      }
    }
  return -1;
}

/* Gradients dN_a/dX_J as g[J][a] at a point; returns |det dX/dxi|. */
static inline double gradients(const double corners[NG][3], const double* restrict geometry,
                               const double* restrict table, double g[DIM][NDP])
{
  double j[DIM][DIM] = {{0}}, k[DIM][DIM];
  for (int n = 0; n < NG; n++)
    for (int d = 0; d < DIM; d++)
      for (int m = 0; m < DIM; m++)
        j[d][m] += corners[n][d] * geometry[n * DIM + m];
#if DIM == 3
  const double c0 = j[1][1] * j[2][2] - j[1][2] * j[2][1];
  const double c1 = j[1][2] * j[2][0] - j[1][0] * j[2][2];
  const double c2 = j[1][0] * j[2][1] - j[1][1] * j[2][0];
  const double det = j[0][0] * c0 + j[0][1] * c1 + j[0][2] * c2, id = 1.0 / det;
  k[0][0] = c0 * id;
  k[1][0] = c1 * id;
  k[2][0] = c2 * id;
  k[0][1] = (j[0][2] * j[2][1] - j[0][1] * j[2][2]) * id;
  k[1][1] = (j[0][0] * j[2][2] - j[0][2] * j[2][0]) * id;
  k[2][1] = (j[0][1] * j[2][0] - j[0][0] * j[2][1]) * id;
  k[0][2] = (j[0][1] * j[1][2] - j[0][2] * j[1][1]) * id;
  k[1][2] = (j[0][2] * j[1][0] - j[0][0] * j[1][2]) * id;
  k[2][2] = (j[0][0] * j[1][1] - j[0][1] * j[1][0]) * id;
#else
  const double det = j[0][0] * j[1][1] - j[0][1] * j[1][0], id = 1.0 / det;
  k[0][0] = j[1][1] * id;
  k[0][1] = -j[0][1] * id;
  k[1][0] = -j[1][0] * id;
  k[1][1] = j[0][0] * id;
#endif
  for (int d = 0; d < DIM; d++)
    for (int a = 0; a < NDP; a++)
    {
      double sum = 0.0;
      for (int m = 0; m < DIM; m++)
        sum += table[m * NDP + a] * k[m][d];
      g[d][a] = sum;
    }
  return fabs(det);
}

static inline void element(const double corners[NG][3], const double* restrict moduli,
                           const double* restrict tables, const double* restrict geometry_tables,
                           const double* restrict weights, double K[DIM][DIM][ND][NDP])
{
  double g[DIM][NDP], volume = 0.0;
  memset(K, 0, sizeof(double) * DIM * DIM * ND * NDP);
  for (int q = 0; q < NQ; q++)
  {
    volume = weights[q] * gradients(corners, geometry_tables + q * NG * DIM,
                                    tables + q * DIM * NDP, g);
    const double* A = moduli + q * DIM * DIM * DIM * DIM;
    for (int i = 0; i < DIM; i++)
      for (int k = SYMMETRIC ? i : 0; k < DIM; k++)
      {
        double h[DIM][NDP];
        for (int J = 0; J < DIM; J++)
        {
          const double* row = A + ((i * DIM + J) * DIM + k) * DIM;
          for (int b = 0; b < NDP; b++)
          {
            double sum = 0.0;
            for (int L = 0; L < DIM; L++)
              sum += row[L] * g[L][b];
            h[J][b] = volume * sum;
          }
        }
        for (int a = 0; a < ND; a++)
          for (int b = 0; b < NDP; b++)
          {
            double sum = K[i][k][a][b];
            for (int J = 0; J < DIM; J++)
              sum += g[J][a] * h[J][b];
            K[i][k][a][b] = sum;
          }
      }
  }
  if (SYMMETRIC) /* A_iJkL = A_kLiJ, so K_ai,bk = K_bk,ai */
    for (int i = 0; i < DIM; i++)
      for (int k = i + 1; k < DIM; k++)
        for (int a = 0; a < ND; a++)
          for (int b = 0; b < ND; b++)
            K[k][i][b][a] = K[i][k][a][b];
}

static inline void take_corners(const int32_t* corners, const double* x, double y[NG][3])
{
  for (int m = 0; m < NG; m++)
    memcpy(y[m], x + 3 * (int64_t)corners[m], 3 * sizeof(double));
}

/* Rows and columns of fixed unknowns stay as they are. */
static inline void drop_fixed(const int8_t* fixed, const int32_t* nodes,
                              double K[DIM][DIM][ND][NDP])
{
  for (int a = 0; a < ND; a++)
    for (int i = 0; i < DIM; i++)
      if (fixed[DIM * nodes[a] + i])
        for (int k = 0; k < DIM; k++)
          for (int b = 0; b < ND; b++)
            K[i][k][a][b] = K[k][i][b][a] = 0.0;
}

int64_t add_stiffness(int64_t count, const int32_t* cells, const int32_t* corners, const double* x,
                      const int32_t* nodes, const double* moduli, const double* tables,
                      const double* geometry_tables, const double* weights, const int8_t* fixed,
                      const int64_t* start, const uint16_t* places, double* values)
{
  double K[DIM][DIM][ND][NDP] __attribute__((aligned(64))), y[NG][3];
  for (int64_t n = 0; n < count; n++)
  {
    const int64_t c = cells[n];
    take_corners(corners + c * NG, x, y);
    element(y, moduli + n * NQ * DIM * DIM * DIM * DIM, tables, geometry_tables, weights, K);
    const int32_t* node = nodes + c * ND;
    drop_fixed(fixed, node, K);
    for (int a = 0; a < ND; a++)
    {
      const uint16_t* place = places + (c * ND + a) * ND;
      for (int i = 0; i < DIM; i++)
      {
        double* row = values + start[(int64_t)DIM * node[a] + i];
        for (int b = 0; b < ND; b++)
          for (int k = 0; k < DIM; k++)
            row[place[b] + k] += K[i][k][a][b];
      }
    }
  }
  return 0;
}

int64_t add_product(int64_t count, const int32_t* cells, const int32_t* corners, const double* x,
                    const int32_t* nodes, const double* moduli, const double* tables,
                    const double* geometry_tables, const double* weights, const double* direction,
                    double* product)
{
  double K[DIM][DIM][ND][NDP] __attribute__((aligned(64))), y[NG][3];
  for (int64_t n = 0; n < count; n++)
  {
    const int64_t c = cells[n];
    const int32_t* node = nodes + c * ND;
    take_corners(corners + c * NG, x, y);
    element(y, moduli + n * NQ * DIM * DIM * DIM * DIM, tables, geometry_tables, weights, K);
    for (int i = 0; i < DIM; i++)
      for (int a = 0; a < ND; a++)
        for (int k = 0; k < DIM; k++)
          for (int b = 0; b < ND; b++)
            product[DIM * node[a] + i] += K[i][k][a][b] * direction[DIM * node[b] + k];
  }
  return 0;
}
"""
