/* Integrals over cells and values there by a kernel of FFCx, see `cell_integrals`. */

#include "cells.h"

int64_t add_vector(int64_t kernel, int64_t count, const int32_t cells[count], int64_t every,
                   const int32_t corners[NG * every], int64_t points, const double x[3 * points],
                   const int32_t dofs[NW * every], int64_t entries, const double unknowns[entries],
                   int64_t packed, int64_t first, int64_t others,
                   const int64_t other[5 * others], int64_t known, const double constants[known],
                   double out[entries])
{
  lanes y[3 * NG], w[packed], c[known + 1], b[BS * NW];
  memset(w, 0, sizeof(w));
  spread(known, constants, (double*)c);
  for (int64_t n = 0; n < count; n += LANES)
  {
    const int64_t some = count - n < LANES ? count - n : LANES;
    take_cells(some, cells + n, corners, x, dofs, unknowns, others, other, (double*)y, (double*)w,
               first);
    memset(b, 0, sizeof(b));
    TABULATE(b, w, c, y);
    for (int l = 0; l < some; l++)
      for (int a = 0; a < NW; a++)
        for (int i = 0; i < BS; i++)
          out[BS * (int64_t)dofs[(int64_t)cells[n + l] * NW + a] + i]
              += LANE((const double*)b, BS * a + i, l);
  }
  return 0;
}

int64_t add_scalar(int64_t kernel, int64_t count, const int32_t cells[count], int64_t every,
                   const int32_t corners[NG * every], int64_t points, const double x[3 * points],
                   const int32_t dofs[NW * every], int64_t entries, const double unknowns[entries],
                   int64_t packed, int64_t first, int64_t others,
                   const int64_t other[5 * others], int64_t known, const double constants[known],
                   double out[1])
{
  lanes y[3 * NG], w[packed], c[known + 1], value[1];
  memset(w, 0, sizeof(w));
  spread(known, constants, (double*)c);
  for (int64_t n = 0; n < count; n += LANES)
  {
    const int64_t some = count - n < LANES ? count - n : LANES;
    take_cells(some, cells + n, corners, x, dofs, unknowns, others, other, (double*)y, (double*)w,
               first);
    memset(value, 0, sizeof(value));
    TABULATE(value, w, c, y);
    for (int l = 0; l < some; l++)
      *out += LANE((const double*)value, 0, l);
  }
  return 0;
}

int64_t evaluate(int64_t kernel, int64_t count, const int32_t cells[count], int64_t every,
                 const int32_t corners[NG * every], int64_t points, const double x[3 * points],
                 const int32_t dofs[NW * every], int64_t entries, const double unknowns[entries],
                 int64_t packed, int64_t first, int64_t others,
                   const int64_t other[5 * others], int64_t known, const double constants[known],
                 int64_t size, double out[size * count])
{
  lanes y[3 * NG], w[packed], c[known + 1], room[LANES == 1 ? 1 : size];
  memset(w, 0, sizeof(w));
  spread(known, constants, (double*)c);
  for (int64_t n = 0; n < count; n += LANES)
  {
    const int64_t some = count - n < LANES ? count - n : LANES;
    take_cells(some, cells + n, corners, x, dofs, unknowns, others, other, (double*)y, (double*)w,
               first);
    double* next = out + n * size;
    lanes* values = LANES == 1 ? (lanes*)next : room;
    memset(values, 0, size * sizeof(lanes));
    TABULATE(values, w, c, y);
    put_cells(some, size, values, next);
  }
  return 0;
}
