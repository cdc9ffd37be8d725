"""The C code that turns moduli at points into element tangents and adds them up.

    K_ai,bk = sum over points  w |det dX/dxi|  dN_a/dX_J  A_iJkL  dN_b/dX_L
    K_ai,b  = sum over points  w |det dX/dxi|  dN_a/dX_J  G_iJ    M_b
    K_a,bk  = sum over points  w |det dX/dxi|  M_a        H_kL    dN_b/dX_L
    K_a,b   = sum over points  w |det dX/dxi|  M_a        c       M_b

with A = dP/dF, and, where a pressure is unknown beside the displacement, G = dP/dp, and H, c the
same derivatives of the pressure's equation; N are the shape functions of the displacement, M those
of the pressure, of which there may be none.

Sources: Belytschko, Liu & Moran, Nonlinear Finite Elements (2000), (6.4.6), with A in place of its
material and geometric parts; Bonet & Wood, Nonlinear Continuum Mechanics for Finite Element
Analysis (2008), 8.6.
"""

from __future__ import annotations

from dolfin_elastic.solvers.assembly.symmetric.loops import ADDING

DECLARATIONS = """
int64_t find_places(int64_t count, const int32_t* cells, const int32_t* nodes,
                    const int64_t* start, const int32_t* columns, uint16_t* places);
int64_t add_tangent(int64_t count, const int32_t* cells, const int32_t* corners, const double* x,
                    const int32_t* nodes, const double* moduli, const double* tables,
                    const double* pressures, const double* geometry_tables, const double* weights,
                    const int8_t* fixed, const int64_t* start, const uint16_t* places,
                    double* values);
int64_t find_upper_places(int64_t count, const int32_t* cells, const int32_t* nodes, int64_t owned,
                    const int64_t* start, const int32_t* columns, uint16_t* places);
int64_t add_half(int64_t count, const int32_t* cells, const int32_t* corners, const double* x,
                 const int32_t* nodes, const double* moduli, const double* tables,
                 const double* pressures, const double* geometry_tables, const double* weights,
                 const int8_t* fixed, const uint16_t* places, int64_t owned, const int64_t* start,
                 float* high, float* low, const int64_t* far_start, const int32_t* far_columns,
                 double* far_blocks);
int64_t add_product(int64_t count, const int32_t* cells, const int32_t* corners, const double* x,
                    const int32_t* nodes, const double* moduli, const double* tables,
                    const double* pressures, const double* geometry_tables, const double* weights,
                    const double* direction, double* product);
"""

# All sizes are known to the compiler, which unrolls and vectorises the innermost loops.
GRADIENTS = r"""
#ifndef real
#define real double
#define MAGNITUDE fabs
#endif

/* Gradients dN_a/dX_J as g[J][a] at a point; returns |det dX/dxi|. */
static inline real gradients(const real corners[NG][3], const double* restrict geometry,
                             const double* restrict table, real g[DIM][NDP])
{
  real j[DIM][DIM], k[DIM][DIM];
  memset(j, 0, sizeof(j));
  for (int n = 0; n < NG; n++)
    for (int d = 0; d < DIM; d++)
      for (int m = 0; m < DIM; m++)
        j[d][m] += corners[n][d] * geometry[n * DIM + m];
#if DIM == 3
  const real c0 = j[1][1] * j[2][2] - j[1][2] * j[2][1];
  const real c1 = j[1][2] * j[2][0] - j[1][0] * j[2][2];
  const real c2 = j[1][0] * j[2][1] - j[1][1] * j[2][0];
  const real det = j[0][0] * c0 + j[0][1] * c1 + j[0][2] * c2, id = 1.0 / det;
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
  const real det = j[0][0] * j[1][1] - j[0][1] * j[1][0], id = 1.0 / det;
  k[0][0] = j[1][1] * id;
  k[0][1] = -j[0][1] * id;
  k[1][0] = -j[1][0] * id;
  k[1][1] = j[0][0] * id;
#endif
  for (int d = 0; d < DIM; d++)
    for (int a = 0; a < NDP; a++)
    {
      real sum = table[a] * k[0][d];
      for (int m = 1; m < DIM; m++)
        sum += table[m * NDP + a] * k[m][d];
      g[d][a] = sum;
    }
  return MAGNITUDE(det);
}
"""
"""Of ND shape functions at a point of a cell with NG nodes of its geometry, in DIM dimensions.

Of the type `real`, by default a number; its absolute value is MAGNITUDE."""

SOURCE = (
    r"""
#include <math.h>
#include <stdint.h>
#include <string.h>
"""
    + ADDING
    + r"""
/* A cell's nodes are ND of the displacement, of DIM unknowns in a row each, and NP of the pressure.
   The first unknown of each is STRIDE times what `nodes` has. */
#define NODES (ND + NP)
#define SQUARE (DIM * DIM)
#define UPPER (ND * (ND + 1) / 2)
#define COUPLINGS (NP == 0 ? 0 : SYMMETRIC ? 1 : 2)
#define STIFFNESSES (SYMMETRIC ? DIM * (DIM + 1) / 2 * SQUARE : SQUARE * SQUARE)
#define MODULI (STIFFNESSES + COUPLINGS * SQUARE + (NP > 0))

static inline void first_unknowns(const int32_t* nodes, int32_t* first)
{
  for (int a = 0; a < NODES; a++)
    first[a] = STRIDE * nodes[a];
}

/* Place of node b's first column within the rows of node a, for all pairs of a cell's nodes.
   Columns are sorted within a row; the rows of a node have the same columns. */
int64_t find_places(int64_t count, const int32_t* cells, const int32_t* nodes,
                    const int64_t* start, const int32_t* columns, uint16_t* places)
{
  for (int64_t n = 0; n < count; n++)
    for (int a = 0; a < NODES; a++)
    {
      const int64_t c = cells[n], row = STRIDE * nodes[c * NODES + a];
      for (int b = 0; b < NODES; b++)
      {
        const int32_t column = STRIDE * nodes[c * NODES + b];
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
        places[(c * NODES + a) * NODES + b] = (uint16_t)(low - start[row]);
      }
    }
  return -1;
}

"""
    + GRADIENTS
    + r"""
struct tangent
{
  double K[DIM][DIM][ND][NDP], G[DIM][NP][NDP], H[DIM][NP][NDP], C[NP][NP];
};

static inline void add_stiffness(const double* restrict A, double g[DIM][NDP], double volume,
                                 double K[DIM][DIM][ND][NDP])
{
  for (int i = 0; i < DIM; i++)
    for (int k = SYMMETRIC ? i : 0; k < DIM; k++, A += SQUARE)
    {
      double h[DIM][NDP];
      for (int J = 0; J < DIM; J++)
      {
        const double* row = A + J * DIM;
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

static inline void add_coupling(const double* restrict G, double g[DIM][NDP],
                                const double* restrict M, double volume, double K[DIM][NP][NDP])
{
  for (int i = 0; i < DIM; i++)
    for (int b = 0; b < NP; b++)
    {
      const double factor = volume * M[b];
      for (int a = 0; a < NDP; a++)
      {
        double sum = 0.0;
        for (int J = 0; J < DIM; J++)
          sum += G[i * DIM + J] * g[J][a];
        K[i][b][a] += factor * sum;
      }
    }
}

static inline void element(const int32_t* corners, const double* x, const double* restrict moduli,
                           const double* restrict tables, const double* restrict pressures,
                           const double* restrict geometry_tables, const double* restrict weights,
                           struct tangent* restrict T)
{
  double g[DIM][NDP], y[NG][3];
  for (int m = 0; m < NG; m++)
    memcpy(y[m], x + 3 * (int64_t)corners[m], 3 * sizeof(double));
  memset(T, 0, sizeof(*T));
  for (int q = 0; q < NQ; q++)
  {
    const double volume = weights[q] * gradients(y, geometry_tables + q * NG * DIM,
                                                 tables + q * DIM * NDP, g);
    const double *A = moduli + q * MODULI, *G = A + STIFFNESSES;
    const double *M = pressures + q * NP;
    add_stiffness(A, g, volume, T->K);
    if (NP == 0)
      continue;
    add_coupling(G, g, M, volume, T->G);
    if (!SYMMETRIC)
      add_coupling(G + SQUARE, g, M, volume, T->H);
    for (int a = 0; a < NP; a++)
      for (int b = 0; b < NP; b++)
        T->C[a][b] += volume * G[COUPLINGS * SQUARE] * M[a] * M[b];
  }
  if (SYMMETRIC) /* A_iJkL = A_kLiJ and H = G */
  {
    for (int i = 0; i < DIM; i++)
      for (int k = i + 1; k < DIM; k++)
        for (int a = 0; a < ND; a++)
          for (int b = 0; b < ND; b++)
            T->K[k][i][b][a] = T->K[i][k][a][b];
    memcpy(T->H, T->G, sizeof(T->G));
  }
}

/* Rows and columns of fixed unknowns stay as they are. */
static inline void drop_fixed(const int8_t* fixed, const int32_t* nodes, struct tangent* T)
{
  for (int a = 0; a < ND; a++)
    for (int i = 0; i < DIM; i++)
      if (fixed[nodes[a] + i])
      {
        for (int k = 0; k < DIM; k++)
          for (int b = 0; b < ND; b++)
            T->K[i][k][a][b] = T->K[k][i][b][a] = 0.0;
        for (int b = 0; b < NP; b++)
          T->G[i][b][a] = T->H[i][b][a] = 0.0;
      }
  for (int b = 0; b < NP; b++)
    if (fixed[nodes[ND + b]])
    {
      for (int i = 0; i < DIM; i++)
        for (int a = 0; a < ND; a++)
          T->G[i][b][a] = T->H[i][b][a] = 0.0;
      for (int a = 0; a < NP; a++)
        T->C[a][b] = T->C[b][a] = 0.0;
    }
}

int64_t add_tangent(int64_t count, const int32_t* cells, const int32_t* corners, const double* x,
                    const int32_t* nodes, const double* moduli, const double* tables,
                    const double* pressures, const double* geometry_tables, const double* weights,
                    const int8_t* fixed, const int64_t* start, const uint16_t* places,
                    double* values)
{
  struct tangent T __attribute__((aligned(64)));
  for (int64_t n = 0; n < count; n++)
  {
    const int64_t c = cells[n];
    int32_t node[NODES];
    first_unknowns(nodes + c * NODES, node);
    const uint16_t* place = places + c * NODES * NODES;
    element(corners + c * NG, x, moduli + n * NQ * MODULI, tables, pressures, geometry_tables,
            weights, &T);
    drop_fixed(fixed, node, &T);
    for (int a = 0; a < ND; a++, place += NODES)
      for (int i = 0; i < DIM; i++)
      {
        double* row = values + start[node[a] + i];
        for (int b = 0; b < ND; b++)
          for (int k = 0; k < DIM; k++)
            row[place[b] + k] += T.K[i][k][a][b];
        for (int b = 0; b < NP; b++)
          row[place[ND + b]] += T.G[i][b][a];
      }
    for (int a = 0; a < NP; a++, place += NODES)
    {
      double* row = values + start[node[ND + a]];
      for (int b = 0; b < ND; b++)
        for (int k = 0; k < DIM; k++)
          row[place[b] + k] += T.H[k][a][b];
      for (int b = 0; b < NP; b++)
        row[place[ND + b]] += T.C[a][b];
    }
  }
  return 0;
}

/* Place of the block of nodes a <= b of a cell in the row of the lower one, where at least one is
   owned; see `symmetric`. */
int64_t find_upper_places(int64_t count, const int32_t* cells, const int32_t* nodes, int64_t owned,
                          const int64_t* start, const int32_t* columns, uint16_t* places)
{
  for (int64_t n = 0; n < count; n++)
  {
    uint16_t* place = places + (int64_t)cells[n] * UPPER;
    int32_t node[NODES];
    first_unknowns(nodes + (int64_t)cells[n] * NODES, node);
    for (int a = 0; a < ND; a++)
      for (int b = a; b < ND; b++, place++)
      {
        const int32_t one = node[a] / DIM, two = node[b] / DIM;
        const int32_t row = one < two ? one : two, column = one < two ? two : one;
        if (row >= owned)
          continue;
        int64_t k = start[row];
        while (k < start[row + 1] && columns[k] != column)
          k++;
        if (k == start[row + 1] || k - start[row] > UINT16_MAX)
          return cells[n];
        *place = (uint16_t)(k - start[row]);
      }
  }
  return -1;
}

/* Adds the block of nodes a and b to the row of a ghost. */
static void add_far(const struct tangent* T, int a, int b, int32_t row, int32_t column,
                    const int64_t* far_start, const int32_t* far_columns, double* far_blocks)
{
  for (int64_t k = far_start[row]; k < far_start[row + 1]; k++)
    if (far_columns[k] == column)
      for (int i = 0; i < DIM; i++)
        for (int j = 0; j < DIM; j++)
          far_blocks[k * SQUARE + i * DIM + j] += T->K[i][j][a][b];
}

/* Adds half of a symmetric tangent: see `symmetric` for where its blocks stand. */
int64_t add_half(int64_t count, const int32_t* cells, const int32_t* corners, const double* x,
                 const int32_t* nodes, const double* moduli, const double* tables,
                 const double* pressures, const double* geometry_tables, const double* weights,
                 const int8_t* fixed, const uint16_t* places, int64_t owned, const int64_t* start,
                 float* high, float* low, const int64_t* far_start, const int32_t* far_columns,
                 double* far_blocks)
{
  struct tangent T __attribute__((aligned(64)));
  for (int64_t n = 0; n < count; n++)
  {
    const int64_t c = cells[n];
    int32_t node[NODES];
    first_unknowns(nodes + c * NODES, node);
    const uint16_t* place = places + c * UPPER;
    element(corners + c * NG, x, moduli + n * NQ * MODULI, tables, pressures, geometry_tables,
            weights, &T);
    drop_fixed(fixed, node, &T);
    for (int a = 0; a < ND; a++)
      for (int b = a; b < ND; b++, place++)
      {
        const int32_t one = node[a] / DIM, two = node[b] / DIM;
        const int p = one < two ? a : b, q = one < two ? b : a;
        const int32_t row = node[p] / DIM;
        if (row < owned)
        {
          const int64_t k = (start[row] + *place) * SQUARE;
#define ENTRY(i, j) T.K[i][j][p][q]
#if DIM == 3
          add_eight(high + k, low + k,
                    (doubles){ENTRY(0, 0), ENTRY(1, 0), ENTRY(2, 0), ENTRY(0, 1), ENTRY(1, 1),
                              ENTRY(2, 1), ENTRY(0, 2), ENTRY(1, 2)});
          add_split(high + k + 8, low + k + 8, ENTRY(2, 2));
#else
          for (int j = 0; j < DIM; j++)
            for (int i = 0; i < DIM; i++)
              add_split(high + k + j * DIM + i, low + k + j * DIM + i, ENTRY(i, j));
#endif
        }
        if (one >= owned)
          add_far(&T, a, b, one - owned, two, far_start, far_columns, far_blocks);
        if (two >= owned && a != b)
          add_far(&T, b, a, two - owned, one, far_start, far_columns, far_blocks);
      }
  }
  return 0;
}

int64_t add_product(int64_t count, const int32_t* cells, const int32_t* corners, const double* x,
                    const int32_t* nodes, const double* moduli, const double* tables,
                    const double* pressures, const double* geometry_tables, const double* weights,
                    const double* direction, double* product)
{
  struct tangent T __attribute__((aligned(64)));
  for (int64_t n = 0; n < count; n++)
  {
    const int64_t c = cells[n];
    int32_t node[NODES];
    first_unknowns(nodes + c * NODES, node);
    element(corners + c * NG, x, moduli + n * NQ * MODULI, tables, pressures, geometry_tables,
            weights, &T);
    for (int i = 0; i < DIM; i++)
      for (int a = 0; a < ND; a++)
      {
        double sum = 0.0;
        for (int k = 0; k < DIM; k++)
          for (int b = 0; b < ND; b++)
            sum += T.K[i][k][a][b] * direction[node[b] + k];
        for (int b = 0; b < NP; b++)
          sum += T.G[i][b][a] * direction[node[ND + b]];
        product[node[a] + i] += sum;
      }
    for (int a = 0; a < NP; a++)
    {
      double sum = 0.0;
      for (int k = 0; k < DIM; k++)
        for (int b = 0; b < ND; b++)
          sum += T.H[k][a][b] * direction[node[b] + k];
      for (int b = 0; b < NP; b++)
        sum += T.C[a][b] * direction[node[ND + b]];
      product[node[ND + a]] += sum;
    }
  }
  return 0;
}
"""
)
