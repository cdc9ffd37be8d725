/* Of ND shape functions at a point of a cell with NG nodes of its geometry, in DIM dimensions; rows
   of NDP have room for whole vector registers.  All sizes are known to the compiler, which unrolls
   and vectorises the innermost loops.

   Of the type `real`, by default a number; its absolute value is MAGNITUDE. */

#include <math.h>
#include <string.h>

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
