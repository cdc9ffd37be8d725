/* Moduli at points become element tangents, which are added up.

       K_ai,bk = sum over points  w |det dX/dxi|  dN_a/dX_J  A_iJkL  dN_b/dX_L
       K_ai,b  = sum over points  w |det dX/dxi|  dN_a/dX_J  G_iJ    M_b
       K_a,bk  = sum over points  w |det dX/dxi|  M_a        H_kL    dN_b/dX_L
       K_a,b   = sum over points  w |det dX/dxi|  M_a        c       M_b

   with A = dP/dF, and, where a pressure is unknown beside the displacement, G = dP/dp, and H, c the
   same derivatives of the pressure's equation; N are the shape functions of the displacement, M
   those of the pressure, of which there may be none.

   Of LANES cells at once moduli are contracted where they are: in the first cache of a core, or in
   the second one.

   Sources: Belytschko, Liu & Moran, Nonlinear Finite Elements (2000), (6.4.6), with A in place of
   its material and geometric parts; Bonet & Wood, Nonlinear Continuum Mechanics for Finite Element
   Analysis (2008), 8.6. */

#define real lanes
#define MAGNITUDE(x) fabs_lanes(x)

#include "cells.h"
#include "gradients.h"
#include "split.h"

/* A cell's nodes are ND of the displacement, of DIM unknowns in a row each, and NP of the pressure.
   The first unknown of each is STRIDE times what `nodes` has. */
#define NODES (ND + NP)
#define SQUARE (DIM * DIM)
#define UPPER (ND * (ND + 1) / 2)
#define COUPLINGS (NP == 0 ? 0 : SYMMETRIC ? 1 : 2)
/* Pairs of components i and k: i <= k where the tangent is symmetric. */
#define PAIRS (SYMMETRIC ? DIM * (DIM + 1) / 2 : SQUARE)
#define MODULI (PAIRS * SQUARE + COUPLINGS * SQUARE + (NP > 0))
/* One cell after the other, rows are whole vector registers. */
#define COLUMNS (LANES == 1 ? NDP : ND)

static inline void first_unknowns(const int32_t* nodes, int32_t* first)
{
  for (int a = 0; a < NODES; a++)
    first[a] = STRIDE * nodes[a];
}

/* Place of node b's first column within the rows of node a, for all pairs of a cell's nodes.
   Columns are sorted within a row; the rows of a node have the same columns. */
int64_t find_places(int64_t count, const int32_t cells[count], int64_t every,
                    const int32_t nodes[NODES * every], int64_t rows,
                    const int64_t start[rows + 1], const int32_t columns[start[rows]],
                    uint16_t places[NODES * NODES * every])
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

/* What elements of the tangent are made of, the same for all cells. */
struct model
{
  int64_t kernel;
  const int32_t *corners, *dofs;
  const double *x, *unknowns, *moduli, *tables, *pressures, *geometry_tables, *weights;
  const lanes* constants;
  int64_t packed, first, others;
  const int64_t* other;
};

/* Of K_ai,bk where the tangent is symmetric i <= k only, and of several cells, i = k, a <= b only;
   H is G then. */
struct tangent
{
  lanes K[PAIRS * ND * COLUMNS], G[DIM][NP][COLUMNS], H[DIM][NP][COLUMNS], C[NP][NP];
};

/* Where K_ai,bk is. */
INLINE int entry(int i, int k, int a, int b)
{
  const int turned = SYMMETRIC && (i > k || (LANES > 1 && i == k && a > b));
  const int I = turned ? k : i, K = turned ? i : k;
  const int pair = SYMMETRIC ? I * DIM - I * (I - 1) / 2 + K - I : I * DIM + K;
  return (pair * ND + (turned ? b : a)) * COLUMNS + (turned ? a : b);
}

INLINE void add_stiffness(const lanes* restrict A, lanes g[DIM][NDP], lanes volume, lanes* K)
{
  for (int i = 0; i < DIM; i++)
    for (int k = SYMMETRIC ? i : 0; k < DIM; k++, A += SQUARE, K += ND * COLUMNS)
    {
      lanes h[DIM][COLUMNS];
      for (int J = 0; J < DIM; J++)
        for (int b = 0; b < COLUMNS; b++)
        {
          lanes sum = A[J * DIM] * g[0][b];
          for (int L = 1; L < DIM; L++)
            sum += A[J * DIM + L] * g[L][b];
          h[J][b] = volume * sum;
        }
      for (int a = 0; a < ND; a++)
        for (int b = SYMMETRIC && LANES > 1 && i == k ? a : 0; b < COLUMNS; b++)
        {
          lanes sum = K[a * COLUMNS + b];
          for (int J = 0; J < DIM; J++)
            sum += g[J][a] * h[J][b];
          K[a * COLUMNS + b] = sum;
        }
    }
}

INLINE void add_coupling(const lanes* restrict G, lanes g[DIM][NDP], const double* restrict M,
                         lanes volume, lanes K[DIM][NP][COLUMNS])
{
  for (int i = 0; i < DIM; i++)
    for (int b = 0; b < NP; b++)
    {
      const lanes factor = volume * M[b];
      for (int a = 0; a < COLUMNS; a++)
      {
        lanes sum = G[i * DIM] * g[0][a];
        for (int J = 1; J < DIM; J++)
          sum += G[i * DIM + J] * g[J][a];
        K[i][b][a] += factor * sum;
      }
    }
}

/* Of some cells, the n-th and those after it. */
static void elements(const struct model* m, int64_t some, int64_t n, const int32_t* cells,
                     struct tangent* restrict T)
{
  lanes g[DIM][NDP], y[NG][3], w[m->packed], room[NQ * MODULI];
  const lanes* moduli = room;
  take_cells(some, cells + n, m->corners, m->x, m->dofs, m->unknowns, m->others, m->other,
             (double*)y, (double*)w, m->first);
  if (m->kernel)
  {
    const int64_t kernel = m->kernel;
    memset(room, 0, sizeof(room));
    TABULATE(room, w, m->constants, (const lanes*)y);
  }
  else
    moduli = (const lanes*)m->moduli + n * NQ * MODULI;
  memset(T, 0, sizeof(*T));
  for (int q = 0; q < NQ; q++)
  {
    const lanes volume
        = m->weights[q] * gradients(y, m->geometry_tables + q * NG * DIM,
                                    m->tables + q * DIM * NDP, g);
    const lanes *A = moduli + q * MODULI, *G = A + PAIRS * SQUARE;
    const double* M = m->pressures + q * NP;
    add_stiffness(A, g, volume, T->K);
    if (NP == 0)
      continue;
    add_coupling(G, g, M, volume, T->G);
    if (!SYMMETRIC)
      add_coupling(G + SQUARE, g, M, volume, T->H);
    for (int a = 0; a < NP; a++)
      for (int b = 0; b < NP; b++)
        T->C[a][b] += volume * G[COUPLINGS * SQUARE] * (M[a] * M[b]);
  }
  if (SYMMETRIC)
    memcpy(T->H, T->G, sizeof(T->G));
}

#define OF_CELL(x, l) (((double*)&(x))[l])

/* Of the l-th cell rows and columns of fixed unknowns stay as they are. */
INLINE void drop_fixed(const int8_t* fixed, const int32_t* nodes, int l, struct tangent* T)
{
  for (int a = 0; a < ND; a++)
    for (int i = 0; i < DIM; i++)
      if (fixed[nodes[a] + i])
      {
        for (int b = 0; b < ND; b++)
          for (int k = 0; k < DIM; k++)
          {
            OF_CELL(T->K[entry(i, k, a, b)], l) = 0.0;
            OF_CELL(T->K[entry(k, i, b, a)], l) = 0.0;
          }
        for (int b = 0; b < NP; b++)
        {
          OF_CELL(T->G[i][b][a], l) = 0.0;
          OF_CELL(T->H[i][b][a], l) = 0.0;
        }
      }
  for (int b = 0; b < NP; b++)
    if (fixed[nodes[ND + b]])
    {
      for (int i = 0; i < DIM; i++)
        for (int a = 0; a < ND; a++)
        {
          OF_CELL(T->G[i][b][a], l) = 0.0;
          OF_CELL(T->H[i][b][a], l) = 0.0;
        }
      for (int a = 0; a < NP; a++)
      {
        OF_CELL(T->C[a][b], l) = 0.0;
        OF_CELL(T->C[b][a], l) = 0.0;
      }
    }
}

int64_t add_tangent(int64_t kernel, int64_t count, const int32_t cells[count], int64_t every,
                    const int32_t corners[NG * every], int64_t points, const double x[3 * points],
                    const int32_t dofs[NW * every], int64_t entries,
                    const double unknowns[entries], int64_t packed, int64_t first, int64_t others,
                    const int64_t other[5 * others], int64_t known, const double constants[known],
                    int64_t given, const double moduli[given * NQ * MODULI],
                    const double tables[NQ * DIM * NDP], const double pressures[NQ * NP],
                    const double geometry_tables[NQ * NG * DIM], const double weights[NQ],
                    const int32_t nodes[NODES * every], const int8_t fixed[entries],
                    const int64_t start[entries + 1], const uint16_t places[NODES * NODES * every],
                    double values[start[entries]])
{
  struct tangent T __attribute__((aligned(64)));
  lanes c[known + 1];
  const struct model m = {kernel,    corners,         dofs,    x, unknowns, moduli, tables,
                          pressures, geometry_tables, weights, c,
                          packed,    first,           others,  other};
  spread(known, constants, (double*)c);
  for (int64_t n = 0; n < count; n += LANES)
  {
    const int some = LANES == 1 || count - n >= LANES ? LANES : count - n;
    elements(&m, some, n, cells, &T);
    for (int l = 0; l < some; l++)
    {
      const uint16_t* place = places + (int64_t)cells[n + l] * NODES * NODES;
      int32_t node[NODES];
      first_unknowns(nodes + (int64_t)cells[n + l] * NODES, node);
      drop_fixed(fixed, node, l, &T);
      for (int a = 0; a < ND; a++, place += NODES)
        for (int i = 0; i < DIM; i++)
        {
          double* row = values + start[node[a] + i];
          for (int b = 0; b < ND; b++)
            for (int k = 0; k < DIM; k++)
              row[place[b] + k] += OF_CELL(T.K[entry(i, k, a, b)], l);
          for (int b = 0; b < NP; b++)
            row[place[ND + b]] += OF_CELL(T.G[i][b][a], l);
        }
      for (int a = 0; a < NP; a++, place += NODES)
      {
        double* row = values + start[node[ND + a]];
        for (int b = 0; b < ND; b++)
          for (int k = 0; k < DIM; k++)
            row[place[b] + k] += OF_CELL(T.H[k][a][b], l);
        for (int b = 0; b < NP; b++)
          row[place[ND + b]] += OF_CELL(T.C[a][b], l);
      }
    }
  }
  return 0;
}

/* Place of the block of nodes a <= b of a cell in the row of the lower one, where at least one is
   owned; see symmetric.c. */
int64_t find_upper_places(int64_t count, const int32_t cells[count], int64_t every,
                          const int32_t nodes[NODES * every], int64_t owned,
                          const int64_t start[owned + 1], const int32_t columns[start[owned]],
                          uint16_t places[UPPER * every])
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
static void add_far(struct tangent* T, int l, int a, int b, int32_t row, int32_t column,
                    const int64_t* far_start, const int32_t* far_columns, double* far_blocks)
{
  for (int64_t f = far_start[row]; f < far_start[row + 1]; f++)
    if (far_columns[f] == column)
      for (int i = 0; i < DIM; i++)
        for (int k = 0; k < DIM; k++)
          far_blocks[f * SQUARE + i * DIM + k] += OF_CELL(T->K[entry(i, k, a, b)], l);
}

/* Adds half of a symmetric tangent without pressures: see symmetric.c for where blocks stand. */
int64_t add_half(int64_t kernel, int64_t count, const int32_t cells[count], int64_t every,
                 const int32_t corners[NG * every], int64_t points, const double x[3 * points],
                 const int32_t dofs[NW * every], int64_t entries, const double unknowns[entries],
                 int64_t packed, int64_t first, int64_t others,
                    const int64_t other[5 * others], int64_t known, const double constants[known], int64_t given,
                 const double moduli[given * NQ * MODULI], const double tables[NQ * DIM * NDP],
                 const double pressures[NQ * NP], const double geometry_tables[NQ * NG * DIM],
                 const double weights[NQ], const int32_t nodes[NODES * every],
                 const int8_t fixed[entries], const uint16_t places[UPPER * every], int64_t owned,
                 const int64_t start[owned + 1], float high[SQUARE * start[owned] + 1],
                 float low[SQUARE * start[owned] + 1], int64_t ghosts,
                 const int64_t far_start[ghosts + 1], const int32_t far_columns[far_start[ghosts]],
                 double far_blocks[SQUARE * far_start[ghosts]])
{
  struct tangent T __attribute__((aligned(64)));
  lanes c[known + 1];
  const struct model m = {kernel,    corners,         dofs,    x, unknowns, moduli, tables,
                          pressures, geometry_tables, weights, c,
                          packed,    first,           others,  other};
  spread(known, constants, (double*)c);
  for (int64_t n = 0; n < count; n += LANES)
  {
    const int some = LANES == 1 || count - n >= LANES ? LANES : count - n;
    elements(&m, some, n, cells, &T);
    for (int l = 0; l < some; l++)
    {
      int32_t node[NODES];
      first_unknowns(nodes + (int64_t)cells[n + l] * NODES, node);
      drop_fixed(fixed, node, l, &T);
    }
    for (int a = 0, pair = 0; a < ND; a++)
      for (int b = a; b < ND; b++, pair++)
      {
#if LANES > 1
        lanes block[SQUARE]; /* row by row */
        for (int i = 0; i < DIM; i++)
          for (int k = 0; k < DIM; k++)
            block[i * DIM + k] = T.K[entry(i, k, a, b)];
#if DIM == 3
        lanes eight[LANES]; /* of each cell, the first ones */
        transpose(block, eight);
#endif
#endif
        for (int l = 0; l < some; l++)
        {
          const int64_t cell = cells[n + l];
          const int32_t one = STRIDE * nodes[cell * NODES + a] / DIM;
          const int32_t two = STRIDE * nodes[cell * NODES + b] / DIM;
          const int turned = one > two; /* the row is that of the lower node */
          const int32_t row = turned ? two : one;
          if (row < owned)
          {
            const int64_t k = (start[row] + places[cell * UPPER + pair]) * SQUARE;
            /* Columns of the stored block are columns of this one, or its rows. */
#if LANES == 1
#define ENTRY(i, j) T.K[entry(i, j, turned ? b : a, turned ? a : b)]
#else
#define ENTRY(i, j) OF_CELL(block[turned ? (j) * DIM + (i) : (i) * DIM + (j)], l)
#endif
#if DIM == 3
#if LANES == 1
            const double8 first = {ENTRY(0, 0), ENTRY(1, 0), ENTRY(2, 0), ENTRY(0, 1),
                                   ENTRY(1, 1), ENTRY(2, 1), ENTRY(0, 2), ENTRY(1, 2)};
#else
            static const marks order[2]
                = {{0, 3, 6, 1, 4, 7, 2, 5}, {0, 1, 2, 3, 4, 5, 6, 7}};
            const double8 first = __builtin_shuffle(eight[l], order[turned]);
#endif
            add_eight(high + k, low + k, first);
            add_split(high + k + 8, low + k + 8, ENTRY(2, 2));
#else
            for (int j = 0; j < DIM; j++)
              for (int i = 0; i < DIM; i++)
                add_split(high + k + j * DIM + i, low + k + j * DIM + i, ENTRY(i, j));
#endif
          }
          if (one >= owned)
            add_far(&T, l, a, b, one - owned, two, far_start, far_columns, far_blocks);
          if (two >= owned && a != b)
            add_far(&T, l, b, a, two - owned, one, far_start, far_columns, far_blocks);
        }
      }
  }
  return 0;
}

int64_t add_product(int64_t kernel, int64_t count, const int32_t cells[count], int64_t every,
                    const int32_t corners[NG * every], int64_t points, const double x[3 * points],
                    const int32_t dofs[NW * every], int64_t entries,
                    const double unknowns[entries], int64_t packed, int64_t first, int64_t others,
                    const int64_t other[5 * others], int64_t known, const double constants[known],
                    int64_t given, const double moduli[given * NQ * MODULI],
                    const double tables[NQ * DIM * NDP], const double pressures[NQ * NP],
                    const double geometry_tables[NQ * NG * DIM], const double weights[NQ],
                    const int32_t nodes[NODES * every], const double direction[entries],
                    double product[entries])
{
  struct tangent T __attribute__((aligned(64)));
  lanes c[known + 1];
  const struct model m = {kernel,    corners,         dofs,    x, unknowns, moduli, tables,
                          pressures, geometry_tables, weights, c,
                          packed,    first,           others,  other};
  spread(known, constants, (double*)c);
  for (int64_t n = 0; n < count; n += LANES)
  {
    const int some = LANES == 1 || count - n >= LANES ? LANES : count - n;
    elements(&m, some, n, cells, &T);
    for (int l = 0; l < some; l++)
    {
      int32_t node[NODES];
      first_unknowns(nodes + (int64_t)cells[n + l] * NODES, node);
      for (int i = 0; i < DIM; i++)
        for (int a = 0; a < ND; a++)
        {
          double sum = 0.0;
          for (int k = 0; k < DIM; k++)
            for (int b = 0; b < ND; b++)
              sum += OF_CELL(T.K[entry(i, k, a, b)], l) * direction[node[b] + k];
          for (int b = 0; b < NP; b++)
            sum += OF_CELL(T.G[i][b][a], l) * direction[node[ND + b]];
          product[node[a] + i] += sum;
        }
      for (int a = 0; a < NP; a++)
      {
        double sum = 0.0;
        for (int k = 0; k < DIM; k++)
          for (int b = 0; b < ND; b++)
            sum += OF_CELL(T.H[k][a][b], l) * direction[node[b] + k];
        for (int b = 0; b < NP; b++)
          sum += OF_CELL(T.C[a][b], l) * direction[node[ND + b]];
        product[node[ND + a]] += sum;
      }
    }
  }
  return 0;
}
