"""The loop in C that finds the extremes of det F and of |grad u| over the cells of a rank."""

from __future__ import annotations

from dolfin_elastic.solvers.assembly.two_stage.kernel import GRADIENTS

DECLARATIONS = """
int64_t extremes(int64_t count, const int32_t* corners, const int32_t* nodes, const double* x,
                 const double* u, const double* tables, const double* geometry_tables,
                 int64_t linear, const int8_t* small, int64_t surviving, const int8_t* survives,
                 double* found, int32_t* where);
"""

SOURCE = (
    r"""
#include <math.h>
#include <stdint.h>
#include <string.h>
"""
    + GRADIENTS
    + r"""
/* Smallest and largest det F, the largest |grad u|^2 in cells that are `small`, of which there
   are `linear`, all or none, and the smallest det F in cells that do not `survive` inversion, of
   which there are marks for all cells or none; and the cells.  What is no number counts as -inf,
   and as 0.  Returns the number of inverted cells. */
int64_t extremes(int64_t count, const int32_t* corners, const int32_t* nodes, const double* x,
                 const double* u, const double* tables, const double* geometry_tables,
                 int64_t linear, const int8_t* small, int64_t surviving, const int8_t* survives,
                 double* found, int32_t* where)
{
  int64_t inverted = 0;
  found[0] = found[3] = INFINITY;
  found[1] = -INFINITY;
  found[2] = 0.0;
  where[0] = where[1] = where[2] = where[3] = 0;
  for (int64_t c = 0; c < count; c++)
  {
    double y[NG][3], g[DIM][NDP], least = INFINITY;
    for (int m = 0; m < NG; m++)
      memcpy(y[m], x + 3 * (int64_t)corners[c * NG + m], 3 * sizeof(double));
    for (int q = 0; q < NQ; q++)
    {
      double F[DIM][DIM] = {{0}}, squares = 0.0;
      gradients(y, geometry_tables + q * NG * DIM, tables + q * DIM * NDP, g);
      for (int a = 0; a < ND; a++)
      {
        const double* v = u + DIM * (int64_t)nodes[c * ND + a];
        for (int i = 0; i < DIM; i++)
          for (int J = 0; J < DIM; J++)
            F[i][J] += v[i] * g[J][a];
      }
      for (int i = 0; i < DIM; i++)
      {
        for (int J = 0; J < DIM; J++)
          squares += F[i][J] * F[i][J];
        F[i][i] += 1.0;
      }
#if DIM == 3
      double det = F[0][0] * (F[1][1] * F[2][2] - F[1][2] * F[2][1])
                   + F[0][1] * (F[1][2] * F[2][0] - F[1][0] * F[2][2])
                   + F[0][2] * (F[1][0] * F[2][1] - F[1][1] * F[2][0]);
#else
      double det = F[0][0] * F[1][1] - F[0][1] * F[1][0];
#endif
      if (det != det)
        det = -INFINITY;
      if (det < least)
        least = det;
      if (det > found[1])
      {
        found[1] = det;
        where[1] = (int32_t)c;
      }
      if (linear && small[c] && squares > found[2])
      {
        found[2] = squares;
        where[2] = (int32_t)c;
      }
    }
    inverted += !(least > 0.0);
    if (least < found[0])
    {
      found[0] = least;
      where[0] = (int32_t)c;
    }
    if (least < found[3] && !(surviving && survives[c]))
    {
      found[3] = least;
      where[3] = (int32_t)c;
    }
  }
  return inverted;
}
"""
)
