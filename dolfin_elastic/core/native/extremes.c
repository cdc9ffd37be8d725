/* Extremes of det F and of |grad u| in each cell of a rank. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "gradients.h"

/* Smallest and largest det F of each cell, and where there are `linear` laws, 1 or 0, the largest
   |grad u|^2.  What is no number counts as -inf, and as 0. */
int64_t extremes(int64_t count, const int32_t corners[NG * count], const int32_t nodes[ND * count],
                 int64_t points, const double x[3 * points], int64_t entries,
                 const double u[entries], const double tables[NQ * DIM * NDP],
                 const double geometry_tables[NQ * NG * DIM], int64_t linear, double least[count],
                 double most[count], double steepest[linear * count])
{
  for (int64_t c = 0; c < count; c++)
  {
    double y[NG][3], g[DIM][NDP], low = INFINITY, high = -INFINITY, steep = 0.0;
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
      if (det < low)
        low = det;
      if (det > high)
        high = det;
      if (squares > steep)
        steep = squares;
    }
    least[c] = low;
    most[c] = high;
    if (linear)
      steepest[c] = steep;
  }
  return 0;
}
