/* Equations r(z) = 0 at points of cells, by Newton's method, see `point_roots`.

   The kernel gives r and dr/dz of z at all points of a cell at once, of LANES cells.  A step is
   halved while the correction that the last derivative gives at its end is not smaller: that test
   does not depend on the units of r.  Source: P. Deuflhard, Newton Methods for Nonlinear Problems
   (2004), section 3.3. */

#include "cells.h"

#define MOST 60
#define SMALLEST 1e-4
#define PLACES (1 + N)

/* Inverts a matrix by elimination with exchange of rows; 0 where it has none. */
static int invert(const double in[N * N], double out[N * N])
{
  double a[N][2 * N];
  for (int i = 0; i < N; i++)
    for (int j = 0; j < N; j++)
    {
      a[i][j] = in[N * i + j];
      a[i][N + j] = i == j;
    }
  for (int k = 0; k < N; k++)
  {
    int best = k;
    for (int i = k + 1; i < N; i++)
      if (fabs(a[i][k]) > fabs(a[best][k]))
        best = i;
    if (!(fabs(a[best][k]) > 0.0) || !isfinite(a[best][k]))
      return 0;
    for (int j = 0; j < 2 * N; j++)
    {
      const double value = a[best][j];
      a[best][j] = a[k][j];
      a[k][j] = value;
    }
    const double scale = 1.0 / a[k][k];
    for (int j = k; j < 2 * N; j++)
      a[k][j] *= scale;
    for (int i = 0; i < N; i++)
      if (i != k && a[i][k] != 0.0)
      {
        const double factor = a[i][k];
        for (int j = k; j < 2 * N; j++)
          a[i][j] -= factor * a[k][j];
      }
  }
  for (int i = 0; i < N; i++)
    for (int j = 0; j < N; j++)
      out[N * i + j] = a[i][N + j];
  return 1;
}

/* The iteration of one point. */
struct point
{
  double z[N], before[N], step[N], inverse[N * N], length, share;
  int state; /* 0: goes on; 1: found; 2: lost */
};

/* Largest component of a step, each over the size of the variable it belongs to. */
static double measured(const double* step, const double* z, const int32_t* variable,
                       const double* least)
{
  double sizes[N] = {0}, result = 0.0;
  for (int i = 0; i < N; i++)
    sizes[variable[i]] += z[i] * z[i];
  for (int i = 0; i < N; i++)
  {
    const double one = fabs(step[i]) / (sqrt(sizes[variable[i]]) + least[i]);
    if (!(one <= result))
      result = one; /* NaN stays */
  }
  return result;
}

/* The step that an inverse gives. */
static void correct(const double* inverse, const double* r, double* step)
{
  for (int i = 0; i < N; i++)
  {
    step[i] = 0.0;
    for (int j = 0; j < N; j++)
      step[i] -= inverse[N * i + j] * r[j];
  }
}

/* Takes r and dr/dz at z; the next z. */
static void advance(struct point* p, const double* r, const double* J, int first,
                    const int32_t* variable, const double* least, double enough)
{
  double next[N];
  if (!first)
  {
    correct(p->inverse, r, next);
    const double length = measured(next, p->before, variable, least);
    if (!(length < p->length) && p->length > enough)
    {
      p->share *= 0.5;
      p->state = p->share < SMALLEST ? 2 : 0;
      for (int i = 0; i < N; i++)
        p->z[i] = p->before[i] + p->share * p->step[i];
      return;
    }
  }
  if (!invert(J, p->inverse))
  {
    p->state = 2;
    return;
  }
  correct(p->inverse, r, p->step);
  p->length = measured(p->step, p->z, variable, least);
  p->share = 1.0;
  p->state = isfinite(p->length) ? p->length <= enough : 2;
  for (int i = 0; i < N; i++)
  {
    p->before[i] = p->z[i];
    p->z[i] += p->step[i];
  }
}

/* Solves at NQ points of some cells.  Values of z and of the inverse of dr/dz stand at NN nodes of
   a cell, `list`, where z begins; where nothing is found they are NaN.  Returns how many points
   are lost. */
int64_t solve(int64_t kernel, int64_t count, const int32_t cells[count], int64_t every,
              const int32_t corners[NG * every], int64_t points, const double x[3 * points],
              const int32_t dofs[NW * every], int64_t entries, const double unknowns[entries],
              int64_t packed, int64_t first, int64_t others, const int64_t other[5 * others],
              int64_t known, const double constants[known], int64_t place,
              const double to_points[NQ * NN], const double to_nodes[NN * NQ],
              const int32_t variable[N], const double least[N], const double enough[1],
              const int32_t list[NN * every], int64_t rows, double values[N * rows],
              double inverses[N * N * rows], double largest[N])
{
  lanes y[3 * NG], w[packed], c[known + 1], found[NQ * N * PLACES];
  struct point at[NQ * LANES];
  int64_t lost = 0;
  memset(w, 0, sizeof(w));
  spread(known, constants, (double*)c);
  for (int64_t n = 0; n < count; n += LANES)
  {
    const int64_t some = count - n < LANES ? count - n : LANES;
    take_cells(some, cells + n, corners, x, dofs, unknowns, others, other, (double*)y, (double*)w,
               first);
    for (int q = 0; q < NQ; q++)
      for (int l = 0; l < LANES; l++)
      {
        struct point* p = at + q * LANES + l;
        memset(p, 0, sizeof(*p));
        for (int i = 0; i < N; i++)
          for (int a = 0; a < NN; a++)
            p->z[i] += to_points[q * NN + a] * LANE((const double*)w, place + N * a + i, l);
      }
    int going = 1;
    for (int step = 0; going && step < MOST; step++)
    {
      for (int a = 0; a < NN; a++)
        for (int i = 0; i < N; i++)
          for (int l = 0; l < LANES; l++)
          {
            double sum = 0.0;
            for (int q = 0; q < NQ; q++)
              sum += to_nodes[a * NQ + q] * at[q * LANES + l].z[i];
            LANE((double*)w, place + N * a + i, l) = sum;
          }
      memset(found, 0, sizeof(found));
      TABULATE(found, w, c, y);
      going = 0;
      for (int q = 0; q < NQ; q++)
        for (int l = 0; l < LANES; l++)
        {
          struct point* p = at + q * LANES + l;
          if (p->state)
            continue;
          double r[N], J[N * N];
          for (int i = 0; i < N; i++)
            r[i] = LANE((const double*)found, q * N * PLACES + i, l);
          for (int i = 0; i < N * N; i++)
            J[i] = LANE((const double*)found, q * N * PLACES + N + i, l);
          advance(p, r, J, step == 0, variable, least, *enough);
          going |= p->state == 0;
        }
    }
    for (int q = 0; q < NQ; q++)
      for (int l = 0; l < LANES; l++)
      {
        struct point* p = at + q * LANES + l;
        lost += l < some && p->state != 1;
        for (int i = 0; i < N; i++)
        {
          if (p->state != 1)
            p->z[i] = NAN;
          else if (l < some && fabs(p->z[i]) > largest[i])
            largest[i] = fabs(p->z[i]);
        }
      }
    for (int64_t l = 0; l < some; l++)
      for (int a = 0; a < NN; a++)
      {
        const int64_t row = list[(int64_t)cells[n + l] * NN + a];
        for (int i = 0; i < N; i++)
        {
          double sum = 0.0;
          for (int q = 0; q < NQ; q++)
            sum += to_nodes[a * NQ + q] * at[q * LANES + l].z[i];
          values[N * row + i] = sum;
        }
        for (int i = 0; i < N * N; i++)
        {
          double sum = 0.0;
          for (int q = 0; q < NQ; q++)
            sum += to_nodes[a * NQ + q] * at[q * LANES + l].inverse[i];
          inverses[N * N * row + i] = sum;
        }
      }
  }
  return lost;
}
