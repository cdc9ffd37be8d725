/* Nearest points and rays of many triangles, by a tree of boxes; see `surface`.

   Node k of the tree has the children 2 k + 1 and 2 k + 2, and boxes of 6 numbers: smallest and
   largest coordinates.  All leaves are on the last level and have LEAF triangles each, one after
   the other in `order`.
   Source: C. Ericson, Real-Time Collision Detection (2005), sections 5.1.5 (nearest point of a
   triangle), 5.3.3 (rays and boxes) and 6.2 (trees); T. Moeller and B. Trumbore, Journal of
   Graphics Tools 2 (1997) 21 (rays and triangles). */

#include <math.h>
#include <stdint.h>

#define DEEPEST 64

static inline double dot(const double* a, const double* b)
{
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline void minus(const double* a, const double* b, double* out)
{
  for (int d = 0; d < 3; d++)
    out[d] = a[d] - b[d];
}

static inline void cross(const double* a, const double* b, double* out)
{
  for (int d = 0; d < 3; d++)
    out[d] = a[(d + 1) % 3] * b[(d + 2) % 3] - a[(d + 2) % 3] * b[(d + 1) % 3];
}

/* Square of the distance of a point from a box. */
static inline double outside(const double* box, const double* x)
{
  double sum = 0.0;
  for (int d = 0; d < 3; d++)
  {
    const double out = fmax(fmax(box[d] - x[d], x[d] - box[d + 3]), 0.0);
    sum += out * out;
  }
  return sum;
}

/* Nearest point of a triangle; its feature: 0 the face, 1 to 3 the edge that begins at a corner,
   4 to 6 that corner. */
static inline int64_t foot_on(const double* corners, const double* x, double* foot)
{
  const double *a = corners, *b = corners + 3, *c = corners + 6;
  double ab[3], ac[3], ap[3], bp[3], cp[3], s = 0.0, t = 0.0;
  int64_t feature = 0;
  minus(b, a, ab), minus(c, a, ac), minus(x, a, ap), minus(x, b, bp), minus(x, c, cp);
  const double d1 = dot(ab, ap), d2 = dot(ac, ap), d3 = dot(ab, bp), d4 = dot(ac, bp);
  const double d5 = dot(ab, cp), d6 = dot(ac, cp);
  const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
  if (d1 <= 0 && d2 <= 0)
    feature = 4;
  else if (d3 >= 0 && d4 <= d3)
    feature = 5, s = 1.0;
  else if (d6 >= 0 && d5 <= d6)
    feature = 6, t = 1.0;
  else if (vc <= 0 && d1 >= 0 && d3 <= 0)
    feature = 1, s = d1 / (d1 - d3);
  else if (va <= 0 && d4 >= d3 && d5 >= d6)
    feature = 2, t = (d4 - d3) / (d4 - d3 + d5 - d6), s = 1.0 - t;
  else if (vb <= 0 && d2 >= 0 && d6 <= 0)
    feature = 3, t = d2 / (d2 - d6);
  else
    s = vb / (va + vb + vc), t = vc / (va + vb + vc);
  for (int d = 0; d < 3; d++)
    foot[d] = a[d] + s * ab[d] + t * ac[d];
  return feature;
}

static inline void try_triangle(const double* corners, int64_t triangle, const double* x,
                                double* best, int64_t* nearest, int64_t* feature, double* foot)
{
  double place[3], arm[3];
  const int64_t part = foot_on(corners + 9 * triangle, x, place);
  minus(x, place, arm);
  const double square = dot(arm, arm);
  if (!(square < *best || (square == *best && triangle < *nearest)))
    return;
  *best = square, *nearest = triangle, *feature = part;
  for (int d = 0; d < 3; d++)
    foot[d] = place[d];
}

/* Of each point the nearest triangle, with the feature and the place on it. */
int64_t find_nearest(int64_t count, const double x[3 * count], int64_t triangles,
                     const double corners[9 * triangles], int64_t leaves,
                     const double boxes[6 * (2 * leaves - 1)], const int64_t order[LEAF * leaves],
                     int64_t nearest[count], int64_t feature[count], double feet[3 * count])
{
  for (int64_t i = 0; i < count; i++)
  {
    const double* p = x + 3 * i;
    int64_t stack[DEEPEST], height = 1;
    double best = INFINITY;
    stack[0] = nearest[i] = feature[i] = 0;
    while (height > 0)
    {
      const int64_t node = stack[--height];
      if (outside(boxes + 6 * node, p) > best)
        continue;
      if (node >= leaves - 1)
      {
        for (int64_t k = LEAF * (node - leaves + 1); k < LEAF * (node - leaves + 2); k++)
          try_triangle(corners, order[k], p, &best, nearest + i, feature + i, feet + 3 * i);
        continue;
      }
      const int64_t one = 2 * node + 1;
      const int swap = outside(boxes + 6 * one, p) < outside(boxes + 6 * (one + 1), p);
      stack[height++] = one + swap;
      stack[height++] = one + 1 - swap;
    }
  }
  return 0;
}

/* Whether a ray enters a box before it is as long as `most`. */
static inline int meets(const double* box, const double* x, const double* way, double most)
{
  double from = 0.0, to = most;
  for (int d = 0; d < 3; d++)
  {
    const double a = (box[d] - x[d]) / way[d], b = (box[d + 3] - x[d]) / way[d];
    from = fmax(from, fmin(a, b)), to = fmin(to, fmax(a, b));  // of NaN the other one
  }
  return from <= to * (1 + 1e-12);
}

/* How long each ray is up to where it leaves through the back of a triangle; infinite: nowhere. */
int64_t find_backs(int64_t count, const double x[3 * count], const double ways[3 * count],
                   int64_t triangles, const double corners[9 * triangles], int64_t leaves,
                   const double boxes[6 * (2 * leaves - 1)], const int64_t order[LEAF * leaves],
                   double lengths[count])
{
  for (int64_t i = 0; i < count; i++)
  {
    const double *p = x + 3 * i, *way = ways + 3 * i;
    int64_t stack[DEEPEST], height = 1;
    lengths[i] = INFINITY;
    stack[0] = 0;
    while (height > 0)
    {
      const int64_t node = stack[--height];
      if (!meets(boxes + 6 * node, p, way, lengths[i]))
        continue;
      if (node < leaves - 1)
      {
        stack[height++] = 2 * node + 1;
        stack[height++] = 2 * node + 2;
        continue;
      }
      for (int64_t k = LEAF * (node - leaves + 1); k < LEAF * (node - leaves + 2); k++)
      {
        const double* a = corners + 9 * order[k];
        double ab[3], ac[3], ap[3], h[3], q[3];
        minus(a + 3, a, ab), minus(a + 6, a, ac), minus(p, a, ap);
        cross(way, ac, h), cross(ap, ab, q);
        const double det = dot(ab, h), u = dot(ap, h), v = dot(way, q), t = dot(ac, q);
        // The determinant is minus the product of way and normal.
        if (det < 0 && u <= 0 && v <= 0 && u + v >= det && t < 0 && t / det < lengths[i])
          lengths[i] = t / det;
      }
    }
  }
  return 0;
}
