/* What a kernel needs to know of cells: TABULATE(A, w, c, y), of LANES cells at once. */

#include "kernel.h"

#define LANE(values, entry, l) ((values)[(entry) * LANES + (l)])

int64_t width(void)
{
  return LANES;
}

/* Constants, the same in all lanes. */
static inline void spread(int64_t count, const double* values, double* out)
{
  for (int64_t i = 0; i < count; i++)
    for (int l = 0; l < LANES; l++)
      LANE(out, i, l) = values[i];
}

/* Of the next LANES cells, or of count and the last of them again.  Unknowns stand in rows of BS at
   NW nodes of a cell, its geometry has NG nodes.  Of each other coefficient there are five numbers:
   addresses of nodes of cells and of values, nodes of a cell, values of a node, place in w. */
static inline void take_cells(int64_t count, const int32_t* cells, const int32_t* corners,
                              const double* x, const int32_t* dofs, const double* unknowns,
                              int64_t others, const int64_t* other, double* y, double* w,
                              int64_t first)
{
  for (int l = 0; l < LANES; l++)
  {
    const int64_t c = cells[l < count ? l : count - 1];
    for (int m = 0; m < NG; m++)
      for (int i = 0; i < 3; i++)
        LANE(y, 3 * m + i, l) = x[3 * (int64_t)corners[c * NG + m] + i];
    for (int a = 0; a < NW; a++)
      for (int i = 0; i < BS; i++)
        LANE(w, first + BS * a + i, l) = unknowns[BS * (int64_t)dofs[c * NW + a] + i];
    for (int64_t k = 0; k < others; k++)
    {
      const int64_t nodes = other[5 * k + 2], block = other[5 * k + 3], place = other[5 * k + 4];
      const int32_t* list = (const int32_t*)other[5 * k] + c * nodes;
      const double* values = (const double*)other[5 * k + 1];
      for (int64_t a = 0; a < nodes; a++)
        for (int64_t i = 0; i < block; i++)
          LANE(w, place + block * a + i, l) = values[block * list[a] + i];
    }
  }
}

#if LANES == 8
/* Entry l of in[k] becomes entry k of out[l]. */
INLINE void transpose(const lanes* in, lanes* out)
{
  lanes t[8], u[8];
  for (int k = 0; k < 8; k += 2)
  {
    t[k] = __builtin_shuffle(in[k], in[k + 1], (marks){0, 8, 2, 10, 4, 12, 6, 14});
    t[k + 1] = __builtin_shuffle(in[k], in[k + 1], (marks){1, 9, 3, 11, 5, 13, 7, 15});
  }
  for (int k = 0; k < 8; k += k % 4 == 1 ? 3 : 1)
  {
    u[k] = __builtin_shuffle(t[k], t[k + 2], (marks){0, 1, 8, 9, 4, 5, 12, 13});
    u[k + 2] = __builtin_shuffle(t[k], t[k + 2], (marks){2, 3, 10, 11, 6, 7, 14, 15});
  }
  for (int k = 0; k < 4; k++)
  {
    out[k] = __builtin_shuffle(u[k], u[k + 4], (marks){0, 1, 2, 3, 8, 9, 10, 11});
    out[k + 4] = __builtin_shuffle(u[k], u[k + 4], (marks){4, 5, 6, 7, 12, 13, 14, 15});
  }
}

/* The values of each cell in a row. */
static inline void put_cells(int64_t some, int64_t size, const lanes* values, double* out)
{
  int64_t j = 0;
  for (; j + 8 <= size; j += 8)
  {
    lanes rows[8];
    transpose(values + j, rows);
    for (int64_t l = 0; l < some; l++)
      memcpy(out + l * size + j, rows + l, sizeof(lanes));
  }
  for (; j < size; j++)
    for (int64_t l = 0; l < some; l++)
      out[l * size + j] = LANE((const double*)values, j, l);
}
#else
/* Of one cell, they are. */
#define put_cells(some, size, values, out) ((void)(some))
#endif
