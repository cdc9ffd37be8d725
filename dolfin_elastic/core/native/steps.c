/* Forces of cells that remember, and what they remember then, in one loop: of each cell the unknowns
   and the numbers that it remembers are read, the kernel makes of both its stress at the one point
   of a linear cell and the numbers at the end of the step, forces are added up, and, where the step
   is accepted, the numbers are written over the old ones.

   A kernel gives P (3x3, row by row), then, with BRANCH, the part of P whose work is summed up, then
   the numbers.  Forces are added into rows of WIDTH numbers for each node, those of branches from the
   fifth on: one register for each node of each cell. */

#define real lanes
#define MAGNITUDE(x) fabs_lanes(x)

#include "cells.h"
#include "gradients.h"

/* Numbers of the next cells stand in rows of `size`; `enough`: at least one row follows. */
INLINE void take_rows(int64_t some, int enough, int64_t size, const double* rows, double* w)
{
  int64_t j = 0;
#if LANES == 8
  if (enough && size == 1)
  {
    memcpy(w, rows, sizeof(lanes));
    return;
  }
  for (; enough && j < size && size > 5; j += 8)
  {
    lanes in[8], out[8];
    for (int l = 0; l < 8; l++)
      memcpy(in + l, rows + l * size + j, sizeof(lanes));
    transpose(in, out);
    for (int k = 0; k < 8 && j + k < size; k++)
      memcpy(w + 8 * (j + k), out + k, sizeof(lanes));
  }
#endif
  (void)enough;
  for (; j < size; j++)
    for (int l = 0; l < LANES; l++)
      LANE(w, j, l) = rows[(l < some ? l : some - 1) * size + j];
}

INLINE void put_rows(int64_t some, int64_t size, const lanes* values, double* rows)
{
  int64_t j = 0;
#if LANES == 8
  if (some == 8 && size == 1)
  {
    memcpy(rows, values, sizeof(lanes));
    return;
  }
  if (some == 8 && size == 6)
  {
    lanes in[8], out[8];
    for (int k = 0; k < 8; k++)
      in[k] = values[k < 6 ? k : 5];
    transpose(in, out);
    /* The last two numbers of a row are overwritten by the next one. */
    for (int l = 0; l < 7; l++)
      memcpy(rows + 6 * l, out + l, sizeof(lanes));
    memcpy(rows + 42, out + 7, 6 * sizeof(double));
    return;
  }
#endif
  for (; j < size; j++)
    for (int64_t l = 0; l < some; l++)
      rows[l * size + j] = LANE((const double*)values, j, l);
}

/* Forces of the stress P on the nodes, as f[a][i]. */
INLINE void forces_of(const lanes* P, lanes g[DIM][NDP], lanes volume, lanes f[ND][4])
{
  for (int i = 0; i < DIM; i++)
  {
    lanes p[DIM];
    for (int J = 0; J < DIM; J++)
      p[J] = volume * P[3 * i + J];
    for (int a = 0; a < ND; a++)
    {
      f[a][i] = p[0] * g[0][a];
      for (int J = 1; J < DIM; J++)
        f[a][i] += p[J] * g[J][a];
    }
  }
}

INLINE void add_forces(int64_t some, const int32_t* cells, const int32_t* dofs, lanes f[2][ND][4],
                       double* room)
{
#if LANES == 8 && WIDTH == 8
  for (int a = 0; a < ND; a++)
  {
    lanes in[8], out[8];
    for (int k = 0; k < 8; k++)
      in[k] = f[k / 4][a][k % 4];
    transpose(in, out);
    for (int l = 0; l < some; l++)
    {
      double* row = room + 8 * (int64_t)dofs[(int64_t)cells[l] * NW + a];
      for (int k = 0; k < 8; k++)
        row[k] += out[l][k];
    }
  }
#else
  for (int a = 0; a < ND; a++)
    for (int l = 0; l < some; l++)
    {
      double* row = room + WIDTH * (int64_t)dofs[(int64_t)cells[l] * NW + a];
      for (int k = 0; k < WIDTH; k++)
        if (k % 4 < DIM)
          row[k] += LANE((const double*)&f[k / 4][a][k % 4], 0, l);
    }
#endif
}

/* Of each variable there are four numbers: address of its rows, numbers in a row, and its place in w
   (below 0: it is not read) and in what the kernel gives. */
int64_t add_steps(int64_t kernel, int64_t count, const int32_t cells[count], int64_t every,
                  const int32_t corners[NG * every], int64_t points, const double x[3 * points],
                  const int32_t dofs[NW * every], int64_t entries, const double unknowns[entries],
                  int64_t packed, int64_t first, int64_t others, const int64_t other[5 * others],
                  int64_t known, const double constants[known], int64_t size,
                  const double table[DIM * NDP], const double geometry_table[NG * DIM],
                  const double weight[1], int64_t variables, const int64_t variable[4 * variables],
                  int64_t accept, double room[WIDTH * entries / BS])
{
  lanes w[packed], c[known + 1], A[size], g[DIM][NDP], y[NG][3], f[2][ND][4];
  memset(w, 0, sizeof(w));
  memset(f, 0, sizeof(f));
  spread(known, constants, (double*)c);
  for (int64_t n = 0; n < count; n += LANES)
  {
    const int64_t some = count - n < LANES ? count - n : LANES;
    const int enough = count - n > LANES;
    take_cells(some, cells + n, corners, x, dofs, unknowns, others, other, (double*)y, (double*)w,
               first);
    for (int64_t v = 0; v < variables; v++)
    {
      const int64_t* one = variable + 4 * v;
      const double* rows = (const double*)one[0] + n * one[1];
      double* place = (double*)(w + one[2]);
      if (one[2] >= 0 && one[1] == 6)
        take_rows(some, enough, 6, rows, place);
      else if (one[2] >= 0)
        take_rows(some, enough, one[1], rows, place);
    }
    memset(A, 0, sizeof(A));
    TABULATE((void*)A, (void*)w, (void*)c, (void*)y);
    const lanes volume = weight[0] * gradients(y, geometry_table, table, g);
    forces_of(A, g, volume, f[0]);
#if BRANCH
    forces_of(A + 9, g, volume, f[1]);
#endif
    add_forces(some, cells + n, dofs, f, room);
    for (int64_t v = 0; v < variables && accept; v++)
    {
      const int64_t* one = variable + 4 * v;
      double* rows = (double*)one[0] + n * one[1];
      if (one[1] == 6)
        put_rows(some, 6, A + one[3], rows);
      else
        put_rows(some, one[1], A + one[3], rows);
    }
  }
  return 0;
}

/* Adds forces to a vector and empties their rows; of branches sums up the work since the last state,
   by the trapezoidal rule, where the step is accepted (1), or begins there (2). */
int64_t collect(int64_t nodes, double room[WIDTH * nodes], double out[DIM * nodes],
                const double unknowns[DIM * nodes], double before[WIDTH * nodes], int64_t accept,
                double work[1])
{
  for (int64_t n = 0; n < nodes; n++)
    for (int i = 0; i < DIM; i++)
    {
      out[DIM * n + i] += room[WIDTH * n + i];
      room[WIDTH * n + i] = 0.0;
#if WIDTH == 8
      double *force = before + WIDTH * n + i, *moved = before + WIDTH * n + 4 + i;
      const double now = room[WIDTH * n + 4 + i], u = unknowns[DIM * n + i];
      room[WIDTH * n + 4 + i] = 0.0;
      if (accept == 1)
        work[0] += (*force + now) * (u - *moved) / 2;
      if (accept)
      {
        *force = now;
        *moved = u;
      }
#else
      (void)before, (void)unknowns, (void)accept, (void)work;
#endif
    }
  return 0;
}
