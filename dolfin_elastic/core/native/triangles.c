/* Nearest points and rays of many triangles, by a tree of boxes; see `surface`.

   Node k of the tree has the children 2 k + 1 and 2 k + 2, and boxes of 6 numbers: smallest and
   largest coordinates.  All leaves are on the last level and have LEAF triangles each, one after
   the other in `order`.

   Curved triangles are quadratic: at the place (s, t) of the flat one, less r s c0 + s t c1 + t r c2
   with r = 1 - s - t and the bow c of each edge.
   Source: C. Ericson, Real-Time Collision Detection (2005), sections 5.1.5 (nearest point of a
   triangle), 5.3.3 (rays and boxes) and 6.2 (trees); T. Moeller and B. Trumbore, Journal of
   Graphics Tools 2 (1997) 21 (rays and triangles). */

#include <math.h>
#include <stdint.h>

#define DEEPEST 64
#define STEPS 30       // of Newton's method
#define ENDS 1e-13     // step in s and t at which it ends
#define INSIDE 1e-12   // s or t below 0 that is none

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

/* A triangle, and its bows: c of the edge that begins at each corner, or NULL. */
typedef struct
{
  const double *corners, *bows;
} patch_t;

/* A nearest point so far: square of its distance, coordinates s and t along the edges from the
   first corner, its place, and its feature: 0 the face, 1 to 3 the edge that begins at a corner,
   4 to 6 that corner. */
typedef struct
{
  double square, s, t, place[3];
  int64_t feature;
} foot_t;

static inline foot_t foot_on(const double* corners, const double* x)
{
  const double *a = corners, *b = corners + 3, *c = corners + 6;
  double ab[3], ac[3], ap[3], bp[3], cp[3];
  foot_t foot = {.feature = 0};
  minus(b, a, ab), minus(c, a, ac), minus(x, a, ap), minus(x, b, bp), minus(x, c, cp);
  const double d1 = dot(ab, ap), d2 = dot(ac, ap), d3 = dot(ab, bp), d4 = dot(ac, bp);
  const double d5 = dot(ab, cp), d6 = dot(ac, cp);
  const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
  if (d1 <= 0 && d2 <= 0)
    foot.feature = 4;
  else if (d3 >= 0 && d4 <= d3)
    foot.feature = 5, foot.s = 1.0;
  else if (d6 >= 0 && d5 <= d6)
    foot.feature = 6, foot.t = 1.0;
  else if (vc <= 0 && d1 >= 0 && d3 <= 0)
    foot.feature = 1, foot.s = d1 / (d1 - d3);
  else if (va <= 0 && d4 >= d3 && d5 >= d6)
    foot.feature = 2, foot.t = (d4 - d3) / (d4 - d3 + d5 - d6), foot.s = 1.0 - foot.t;
  else if (vb <= 0 && d2 >= 0 && d6 <= 0)
    foot.feature = 3, foot.t = d2 / (d2 - d6);
  else
    foot.s = vb / (va + vb + vc), foot.t = vc / (va + vb + vc);
  double arm[3];
  for (int d = 0; d < 3; d++)
    foot.place[d] = a[d] + foot.s * ab[d] + foot.t * ac[d];
  minus(x, foot.place, arm);
  foot.square = dot(arm, arm);
  return foot;
}

/* Place on a patch, less x, and its derivatives by s and t. */
static inline void on_patch(patch_t patch, double s, double t, const double* x, double* arm,
                            double* by_s, double* by_t)
{
  const double *a = patch.corners, *c = patch.bows, r = 1.0 - s - t;
  for (int d = 0; d < 3; d++)
  {
    const double ab = a[3 + d] - a[d], ac = a[6 + d] - a[d];
    arm[d] = a[d] + s * ab + t * ac - x[d] - r * s * c[d] - s * t * c[3 + d] - t * r * c[6 + d];
    by_s[d] = ab - (r - s) * c[d] - t * c[3 + d] + t * c[6 + d];
    by_t[d] = ac + s * c[d] - s * c[3 + d] - (r - t) * c[6 + d];
  }
}

/* Along an edge of a patch, by Newton's method; ends are corners. */
static inline void try_edge(patch_t patch, int edge, const double* x, double at, foot_t* best)
{
  static const double S[] = {0.0, 1.0, 0.0}, T[] = {0.0, 0.0, 1.0};
  const int next = (edge + 1) % 3;
  const double ds = S[next] - S[edge], dt = T[next] - T[edge], *c = patch.bows + 3 * edge;
  double arm[3], by_s[3], by_t[3], along[3], s, t;
  for (int k = 0;; k++)
  {
    s = S[edge] + at * ds, t = T[edge] + at * dt;
    on_patch(patch, s, t, x, arm, by_s, by_t);
    if (k == STEPS)
      break;
    for (int d = 0; d < 3; d++)
      along[d] = ds * by_s[d] + dt * by_t[d];
    const double bent = dot(along, along) + 2.0 * dot(arm, c);
    const double goal = at - dot(arm, along) / (bent > 0.0 ? bent : dot(along, along));
    const double to = fmin(fmax(goal, 0.0), 1.0), way = fabs(to - at);
    at = to;
    if (way < ENDS)
      k = STEPS - 1;
  }
  if (!(dot(arm, arm) < best->square))
    return;
  best->square = dot(arm, arm), best->s = s, best->t = t;
  best->feature = at <= 0.0 ? 4 + edge : at >= 1.0 ? 4 + next : 1 + edge;
  for (int d = 0; d < 3; d++)
    best->place[d] = arm[d] + x[d];
}

/* Nearest point of a patch, by Newton's method from that of its triangle. */
static inline foot_t foot_on_patch(patch_t patch, const double* x)
{
  foot_t foot = foot_on(patch.corners, x);
  const double* c = patch.bows;
  double arm[3], by_s[3], by_t[3], s = foot.s, t = foot.t, way = 1.0;
  for (int k = 0; k <= STEPS; k++)
  {
    on_patch(patch, s, t, x, arm, by_s, by_t);
    if (k == STEPS || way < ENDS)
      break;
    const double f = dot(arm, by_s), g = dot(arm, by_t);
    double ss = dot(by_s, by_s), st = dot(by_s, by_t), tt = dot(by_t, by_t);
    const double c0 = dot(arm, c), c1 = dot(arm, c + 3), c2 = dot(arm, c + 6);
    const double hs = ss + 2.0 * c0, ht = tt + 2.0 * c2, hst = st + c0 - c1 + c2;
    if (hs > 0.0 && hs * ht > hst * hst)
      ss = hs, st = hst, tt = ht;
    const double det = ss * tt - st * st;
    double ds = (st * g - tt * f) / det, dt = (st * f - ss * g) / det;
    way = fmax(fabs(ds), fabs(dt));
    const double share = way > 0.5 ? 0.5 / way : 1.0;
    s += share * ds, t += share * dt;
    if (fabs(s) > 2.0 || fabs(t) > 2.0)
      break;
  }
  const double least = fmin(fmin(s, t), 1.0 - s - t);
  if (way < ENDS && least >= -INSIDE)
  {
    foot.square = dot(arm, arm), foot.s = s, foot.t = t, foot.feature = 0;
    for (int d = 0; d < 3; d++)
      foot.place[d] = arm[d] + x[d];
    return foot;
  }
  foot.square = INFINITY;
  const double starts[] = {s, t, 1.0 - t};
  for (int edge = 0; edge < 3; edge++)
    try_edge(patch, edge, x, fmin(fmax(starts[edge], 0.0), 1.0), &foot);
  return foot;
}

/* Of each point the nearest triangle, or patch where they are curved, with the feature, the place
   and its coordinates there. */
int64_t find_nearest(int64_t count, const double x[3 * count], int64_t triangles,
                     const double corners[9 * triangles], int64_t leaves,
                     const double boxes[6 * (2 * leaves - 1)], const int64_t order[LEAF * leaves],
                     int64_t curved, const double bows[9 * curved], int64_t nearest[count],
                     int64_t feature[count], double feet[3 * count], double local[2 * count])
{
  for (int64_t i = 0; i < count; i++)
  {
    const double* p = x + 3 * i;
    int64_t stack[DEEPEST], height = 1;
    foot_t best = {.square = INFINITY};
    stack[0] = nearest[i] = 0;
    while (height > 0)
    {
      const int64_t node = stack[--height];
      if (outside(boxes + 6 * node, p) > best.square)
        continue;
      if (node >= leaves - 1)
      {
        for (int64_t k = LEAF * (node - leaves + 1); k < LEAF * (node - leaves + 2); k++)
        {
          const patch_t patch = {corners + 9 * order[k], curved ? bows + 9 * order[k] : bows};
          const foot_t foot = curved ? foot_on_patch(patch, p) : foot_on(patch.corners, p);
          const int alike = foot.square == best.square && order[k] < nearest[i];
          if (foot.square < best.square || alike)
            best = foot, nearest[i] = order[k];
        }
        continue;
      }
      const int64_t one = 2 * node + 1;
      const int swap = outside(boxes + 6 * one, p) < outside(boxes + 6 * (one + 1), p);
      stack[height++] = one + swap;
      stack[height++] = one + 1 - swap;
    }
    feature[i] = best.feature, local[2 * i] = best.s, local[2 * i + 1] = best.t;
    for (int d = 0; d < 3; d++)
      feet[3 * i + d] = best.place[d];
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
