"""The C code of half of a symmetric tangent, of several cells at once.

Moduli of LANES cells (`core.jit.vectorise`) are contracted with shape functions where they are: in
the first cache of a core, or in the second one.  `kernel` has the formulas, and the same for one
cell after the other.
"""

from __future__ import annotations

from dolfin_elastic.solvers.assembly.symmetric.loops import ADDING
from dolfin_elastic.solvers.assembly.two_stage.kernel import GRADIENTS

_HEAD = """
int64_t add_half(int64_t count, const int32_t* cells, const int32_t* corners, const double* x,
                 const int32_t* nodes, const double* unknowns, int64_t known,
                 const double* constants, const double* tables, const double* geometry_tables,
                 const double* weights, const int8_t* fixed, const uint16_t* places, int64_t owned,
                 const int64_t* start, float* high, float* low, const int64_t* far_start,
                 const int32_t* far_columns, double* far_blocks)"""

SOURCE = (
    ADDING
    + "#define real lanes\n#define MAGNITUDE(x) fabs_lanes(x)\n"
    + GRADIENTS
    + r"""
#define SQUARE (DIM * DIM)
#define PAIRS (ND * (ND + 1) / 2)
#define MODULI (DIM * (DIM + 1) / 2 * SQUARE)
/* Of nodes a <= b. */
#define PAIR(a, b) ((a) * ND - (a) * ((a) - 1) / 2 + (b) - (a))

/* K[PAIR(a, b)][i * DIM + k] is the entry of component i of node a and component k of node b. */
static inline void add_stiffness(const lanes* restrict A, lanes g[DIM][NDP], lanes volume,
                                 lanes K[PAIRS][SQUARE])
{
  for (int i = 0; i < DIM; i++)
    for (int k = i; k < DIM; k++, A += SQUARE)
    {
      lanes h[DIM][ND];
      for (int J = 0; J < DIM; J++)
        for (int b = 0; b < ND; b++)
        {
          lanes sum = A[J * DIM] * g[0][b];
          for (int L = 1; L < DIM; L++)
            sum += A[J * DIM + L] * g[L][b];
          h[J][b] = volume * sum;
        }
      for (int a = 0; a < ND; a++)
        for (int b = i == k ? a : 0; b < ND; b++)
        {
          lanes sum = g[0][a] * h[0][b];
          for (int J = 1; J < DIM; J++)
            sum += g[J][a] * h[J][b];
          if (a <= b)
            K[PAIR(a, b)][i * DIM + k] += sum;
          if (i != k && b <= a)
            K[PAIR(b, a)][k * DIM + i] += sum;
        }
    }
}

/* Rows and columns of fixed unknowns stay as they are. */
static inline void drop_fixed(const int8_t* fixed, const int32_t* nodes, int l, double* K)
{
  for (int a = 0; a < ND; a++)
    for (int i = 0; i < DIM; i++)
      for (int b = 0; fixed[DIM * nodes[a] + i] && b < ND; b++)
        for (int k = 0; k < DIM; k++)
        {
          if (a <= b)
            LANE(K, PAIR(a, b) * SQUARE + i * DIM + k, l) = 0.0;
          if (b <= a)
            LANE(K, PAIR(b, a) * SQUARE + k * DIM + i, l) = 0.0;
        }
}

/* Adds the block of the nodes of a pair to the row of a ghost. */
static void add_far(const double* K, int pair, int l, int turned, int32_t row, int32_t column,
                    const int64_t* far_start, const int32_t* far_columns, double* far_blocks)
{
  for (int64_t f = far_start[row]; f < far_start[row + 1]; f++)
    if (far_columns[f] == column)
      for (int i = 0; i < DIM; i++)
        for (int k = 0; k < DIM; k++)
          far_blocks[f * SQUARE + i * DIM + k]
              += LANE(K, pair * SQUARE + (turned ? k * DIM + i : i * DIM + k), l);
}
"""
    + _HEAD
    + r"""
{
  lanes y[NG][3], w[DIM * ND], c[known + 1], A[NQ * MODULI], K[PAIRS][SQUARE];
  const double* entries = (const double*)K;
  spread(known, constants, (double*)c);
  for (int64_t n = 0; n < count; n += LANES)
  {
    const int some = count - n < LANES ? count - n : LANES;
    take_cells(some, cells + n, corners, x, nodes, unknowns, (double*)y, (double*)w);
    memset(A, 0, sizeof(A));
    TABULATE(A, w, c, (const lanes*)y);
    memset(K, 0, sizeof(K));
    for (int q = 0; q < NQ; q++)
    {
      lanes g[DIM][NDP];
      const lanes volume
          = weights[q] * gradients(y, geometry_tables + q * NG * DIM, tables + q * DIM * NDP, g);
      add_stiffness(A + q * MODULI, g, volume, K);
    }
    for (int l = 0; l < some; l++)
      drop_fixed(fixed, nodes + cells[n + l] * (int64_t)ND, l, (double*)K);
    for (int a = 0, pair = 0; a < ND; a++)
      for (int b = a; b < ND; b++, pair++)
      {
#if DIM == 3
        lanes blocks[LANES];
        transpose(K[pair], blocks);
#endif
        for (int l = 0; l < some; l++)
        {
          const int64_t cell = cells[n + l];
          const int32_t one = nodes[cell * ND + a], two = nodes[cell * ND + b];
          const int turned = one > two; /* the row is that of the lower node */
          const int32_t row = turned ? two : one;
          if (row < owned)
          {
            const int64_t k = (start[row] + places[cell * PAIRS + pair]) * SQUARE;
#if DIM == 3
            static const marks order[2]
                = {{0, 3, 6, 1, 4, 7, 2, 5}, {0, 1, 2, 3, 4, 5, 6, 7}};
            add_eight(high + k, low + k, __builtin_shuffle(blocks[l], order[turned]));
            add_split(high + k + 8, low + k + 8, LANE(entries, pair * SQUARE + 8, l));
#else
            for (int i = 0; i < DIM; i++)
              for (int j = 0; j < DIM; j++)
              {
                const int64_t place = k + j * DIM + i; /* column by column */
                const int entry = turned ? j * DIM + i : i * DIM + j;
                add_split(high + place, low + place, LANE(entries, pair * SQUARE + entry, l));
              }
#endif
          }
          if (one >= owned)
            add_far(entries, pair, l, 0, one - owned, two, far_start, far_columns, far_blocks);
          if (two >= owned && a != b)
            add_far(entries, pair, l, 1, two - owned, one, far_start, far_columns, far_blocks);
        }
      }
  }
  return 0;
}
"""
)
"""Where LANES > 1, after what `core.jit.cell_integrals.TAKING` has."""

DECLARATIONS = f"{_HEAD};"
