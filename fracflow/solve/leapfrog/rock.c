/* (2.39) Forces of cells of plane rock, and steps of its nodes by central differences, in one sweep through memory.

   Arrays of two values a node: places x, displacements u, velocities v at the middle of steps, forces f, outer forces e.
   Moduli d of a rock: D_xx, D_xy, and D_ss of its shear, times engineering shear strain. A cell is a row of nodes and the
   number of its rock. Each function of a cell takes K u off f, and finds twice the strain energy of the cell. */
#include "machines.h"
#include <stdint.h>
#include <string.h>

const int fracflow_leapfrog_version = 11;

typedef double two __attribute__((vector_size(16), aligned(8)));
typedef double four __attribute__((vector_size(32)));
typedef long long places __attribute__((vector_size(32)));

#define AT(p, i) (*(const two *)((p) + (i)))
#define TO_IN(p, i) (*(two *)((p) + (i)))

INLINE double triangle(const int32_t *cell, const double *d, const double *x, const double *u, double *f) {
  const int64_t i = 2 * (int64_t)cell[0], j = 2 * (int64_t)cell[1], k = 2 * (int64_t)cell[2];
  const double x1 = x[j] - x[i], y1 = x[j + 1] - x[i + 1], x2 = x[k] - x[i], y2 = x[k + 1] - x[i + 1];
  const double u1 = u[j] - u[i], v1 = u[j + 1] - u[i + 1], u2 = u[k] - u[i], v2 = u[k + 1] - u[i + 1];
  const double w = 0.5 / (x1 * y2 - x2 * y1);
  const double xx = u1 * y2 - u2 * y1, yy = x1 * v2 - x2 * v1, xy = x1 * u2 - x2 * u1 + v1 * y2 - v2 * y1;
  const double s = w * (d[0] * xx + d[1] * yy), t = w * (d[1] * xx + d[0] * yy), h = w * d[2] * xy;
  const double jx = s * y2 - h * x2, jy = h * y2 - t * x2, kx = h * x1 - s * y1, ky = t * x1 - h * y1;
  f[i] += jx + kx, f[i + 1] += jy + ky;
  f[j] -= jx, f[j + 1] -= jy;
  f[k] -= kx, f[k + 1] -= ky;
  return s * xx + t * yy + h * xy;
}

/* Values at corner c of four cells side by side. */
#define SIDE_BY_SIDE(p, c, to_x, to_y) { \
    const two p0 = AT(p, at[c][0]), p1 = AT(p, at[c][1]), p2 = AT(p, at[c][2]), p3 = AT(p, at[c][3]); \
    to_x = (four){p0[0], p1[0], p2[0], p3[0]}, to_y = (four){p0[1], p1[1], p2[1], p3[1]}; }

/* Four triangles side by side, each as ``triangle`` has it. */
INLINE void triangles_of_four(const int32_t *cells, const uint16_t *rock, const double *moduli, const double *x,
                              const double *u, double *f, four *twice) {
  int64_t at[3][4];
  four px[3], py[3], qx[3], qy[3];
  const double *of[4];
  for (int n = 0; n < 4; n++) {
    of[n] = moduli + 3 * (int64_t)rock[n];
    for (int c = 0; c < 3; c++) at[c][n] = 2 * (int64_t)cells[3 * n + c];
  }
  const four d0 = {of[0][0], of[1][0], of[2][0], of[3][0]}, d1 = {of[0][1], of[1][1], of[2][1], of[3][1]};
  const four d2 = {of[0][2], of[1][2], of[2][2], of[3][2]};
  for (int c = 0; c < 3; c++) {
    SIDE_BY_SIDE(x, c, px[c], py[c])
    SIDE_BY_SIDE(u, c, qx[c], qy[c])
  }
  const four x1 = px[1] - px[0], y1 = py[1] - py[0], x2 = px[2] - px[0], y2 = py[2] - py[0];
  const four u1 = qx[1] - qx[0], v1 = qy[1] - qy[0], u2 = qx[2] - qx[0], v2 = qy[2] - qy[0];
  const four w = 0.5 / (x1 * y2 - x2 * y1);
  const four xx = u1 * y2 - u2 * y1, yy = x1 * v2 - x2 * v1, xy = x1 * u2 - x2 * u1 + v1 * y2 - v2 * y1;
  const four s = w * (d0 * xx + d1 * yy), t = w * (d1 * xx + d0 * yy), h = w * d2 * xy;
  const four jx = s * y2 - h * x2, jy = h * y2 - t * x2, kx = h * x1 - s * y1, ky = t * x1 - h * y1;
  const four ix = jx + kx, iy = jy + ky;
  *twice += s * xx + t * yy + h * xy;
  for (int n = 0; n < 4; n++) {
    TO_IN(f, at[0][n]) += (two){ix[n], iy[n]};
    TO_IN(f, at[1][n]) -= (two){jx[n], jy[n]};
    TO_IN(f, at[2][n]) -= (two){kx[n], ky[n]};
  }
}

/* A field of corner values p has slopes (p_1 + p_3 eta)/4 and (p_2 + p_3 xi)/4; both sides of the four places of quadrature lie
   side by side, so that their Jacobians are 16 times as large. Adds to twice the energy. */
INLINE void quadrilateral(const int32_t *cell, const double *d, const double *x, const double *u, double *f, four *twice) {
  const double g = 0.57735026918962576451;
  const four xi = {-g, g, g, -g}, eta = {-g, -g, g, g};
  const int64_t i = 2 * (int64_t)cell[0], j = 2 * (int64_t)cell[1], k = 2 * (int64_t)cell[2], l = 2 * (int64_t)cell[3];
  const two x_ki = AT(x, k) - AT(x, i), x_lj = AT(x, l) - AT(x, j), u_ki = AT(u, k) - AT(u, i), u_lj = AT(u, l) - AT(u, j);
  const two x1 = x_ki - x_lj, x2 = x_ki + x_lj, u1 = u_ki - u_lj, u2 = u_ki + u_lj;
  const two x3 = (AT(x, i) - AT(x, j)) + (AT(x, k) - AT(x, l)), u3 = (AT(u, i) - AT(u, j)) + (AT(u, k) - AT(u, l));
  const four xa = x1[0] + x3[0] * eta, ya = x1[1] + x3[1] * eta, xb = x2[0] + x3[0] * xi, yb = x2[1] + x3[1] * xi;
  const four ua = u1[0] + u3[0] * eta, va = u1[1] + u3[1] * eta, ub = u2[0] + u3[0] * xi, vb = u2[1] + u3[1] * xi;
  const four w = 0.0625 / (xa * yb - xb * ya);
  const four xx = ua * yb - ub * ya, yy = xa * vb - xb * va, xy = (xa * ub - xb * ua) + (va * yb - vb * ya);
  const four wx = w * xx, wy = w * yy, s = d[0] * wx + d[1] * wy, t = d[1] * wx + d[0] * wy, h = d[2] * (w * xy);
  const four ax = s * yb - h * xb, ay = h * yb - t * xb, bx = h * xa - s * ya, by = t * xa - h * ya;
  const four cx = ax * eta + bx * xi, cy = ay * eta + by * xi;
  *twice += s * xx + t * yy + h * xy;
  /* sums over the places, of both components at once */
#define MIXED(p, q, ...) __builtin_shuffle(p, q, (places){__VA_ARGS__})
#define PAIRS(p, q) (MIXED(p, q, 0, 4, 2, 6) + MIXED(p, q, 1, 5, 3, 7))
  const four a = PAIRS(ax, ay), b = PAIRS(bx, by), c = PAIRS(cx, cy);
  const two fa = {a[0] + a[2], a[1] + a[3]}, fb = {b[0] + b[2], b[1] + b[3]}, fc = {c[0] + c[2], c[1] + c[3]};
#define TO(i) TO_IN(f, i)
  TO(i) += (fa + fb) - fc;
  TO(j) -= (fa - fb) - fc;
  TO(k) -= (fa + fb) + fc;
  TO(l) += (fa - fb) + fc;
}

/* Four parallelograms side by side, of which the last are none where count is less. Slopes of a field are (p_1 + p_3 eta)/4 and
   (p_2 + p_3 xi)/4 here too, but the Jacobian is the same everywhere: the four places of quadrature add up to four times the
   middle, and to a third of that for what goes with eta and with xi. */
INLINE void parallelograms(const int32_t *cells, const uint16_t *rock, int count, const double *moduli, const double *x,
                           const double *u, double *f, four *twice) {
  int64_t at[4][4];
  four px[4], py[4], qx[4], qy[4];
  const double *of[4];
  for (int n = 0; n < 4; n++) {
    const int k = n < count ? n : 0;
    of[n] = moduli + 3 * (int64_t)rock[k];
    for (int c = 0; c < 4; c++) at[c][n] = 2 * (int64_t)cells[4 * k + c];
  }
  const four d[3] = {{of[0][0], of[1][0], of[2][0], of[3][0]}, {of[0][1], of[1][1], of[2][1], of[3][1]},
                     {of[0][2], of[1][2], of[2][2], of[3][2]}};
  const four used = {1.0, count > 1 ? 1.0 : 0.0, count > 2 ? 1.0 : 0.0, count > 3 ? 1.0 : 0.0};
  for (int c = 0; c < 4; c++) {
    SIDE_BY_SIDE(x, c, px[c], py[c])
    SIDE_BY_SIDE(u, c, qx[c], qy[c])
  }
#define ALONG(p) ((p[2] - p[0]) - (p[3] - p[1]))
#define ACROSS(p) ((p[2] - p[0]) + (p[3] - p[1]))
#define TWIST(p) ((p[0] - p[1]) + (p[2] - p[3]))
  const four xa = ALONG(px), ya = ALONG(py), xb = ACROSS(px), yb = ACROSS(py);
  const four ua = ALONG(qx), va = ALONG(qy), ub = ACROSS(qx), vb = ACROSS(qy), uc = TWIST(qx), vc = TWIST(qy);
  const four w = 0.25 / (xa * yb - xb * ya), third = w * (1.0 / 3.0);
  const four xx = ua * yb - ub * ya, yy = xa * vb - xb * va, xy = (xa * ub - xb * ua) + (va * yb - vb * ya);
  const four s = w * (d[0] * xx + d[1] * yy), t = w * (d[1] * xx + d[0] * yy), h = w * d[2] * xy;
  const four ax = s * yb - h * xb, ay = h * yb - t * xb, bx = h * xa - s * ya, by = t * xa - h * ya;
  const four exx = uc * yb, eyy = -xb * vc, exy = vc * yb - xb * uc; /* with eta */
  const four es = third * (d[0] * exx + d[1] * eyy), et = third * (d[1] * exx + d[0] * eyy), eh = third * d[2] * exy;
  const four gxx = -uc * ya, gyy = xa * vc, gxy = xa * uc - vc * ya; /* with xi */
  const four gs = third * (d[0] * gxx + d[1] * gyy), gt = third * (d[1] * gxx + d[0] * gyy), gh = third * d[2] * gxy;
  const four cx = (es * yb - eh * xb) + (gh * xa - gs * ya), cy = (eh * yb - et * xb) + (gt * xa - gh * ya);
  *twice += used * ((s * xx + t * yy + h * xy) + (es * exx + et * eyy + eh * exy) + (gs * gxx + gt * gyy + gh * gxy));
  const four ix = (ax + bx) - cx, iy = (ay + by) - cy, jx = cx - (ax - bx), jy = cy - (ay - by);
  const four kx = -(ax + bx) - cx, ky = -(ay + by) - cy, lx = (ax - bx) + cx, ly = (ay - by) + cy;
  for (int n = 0; n < 4 && n < count; n++) {
    TO(at[0][n]) += (two){ix[n], iy[n]};
    TO(at[1][n]) += (two){jx[n], jy[n]};
    TO(at[2][n]) += (two){kx[n], ky[n]};
    TO(at[3][n]) += (two){lx[n], ly[n]};
  }
}

/* Nodes from first to last: v += kick f/m, u += drift v. */
INLINE void moved(int64_t first, int64_t last, const double *inverse, double kick, double drift, double *u, double *v,
                  const double *f) {
  for (int64_t i = first; i < last; i++) {
    const double by = kick * inverse[i], vx = v[2 * i] + by * f[2 * i], vy = v[2 * i + 1] + by * f[2 * i + 1];
    v[2 * i] = vx, v[2 * i + 1] = vy;
    u[2 * i] += drift * vx, u[2 * i + 1] += drift * vy;
  }
}

/* f = e - K u, and the step of each node right after its last cell. Cells are in the order of their lowest nodes: those of
   range r, from its first triangle and quadrilateral on, begin at nodes from node[r] on, and touch none from top[r] on but
   others that do not move here. Its quadrilaterals from oblique[r] on are no parallelograms. Nodes before begun have their e.
   Where quiet[r], e is 0 from the last top on, and is not read. */
FOR_MACHINES double fracflow_sweep(int32_t ranges, int32_t begun, const int32_t *node, const int32_t *top,
                                   const int32_t *of_three, const int32_t *of_four, const int32_t *oblique,
                                   const uint8_t *quiet, const int32_t *triangles, const int32_t *quads,
                                   const uint16_t *rock_three, const uint16_t *rock_four, const double *moduli, const double *x,
                                   const double *inverse, const double *e, double kick, double drift, double *u, double *v,
                                   double *f) {
  double twice = 0.0;
  four others = {0.0, 0.0, 0.0, 0.0};
  for (int32_t r = 0; r < ranges; r++) {
    if (top[r] > begun) {
      const size_t size = 2 * sizeof(double) * (size_t)(top[r] - begun);
      if (quiet[r])
        memset(f + 2 * (int64_t)begun, 0, size);
      else
        memcpy(f + 2 * (int64_t)begun, e + 2 * (int64_t)begun, size);
      begun = top[r];
    }
    int64_t next = of_three[r];
    for (; next + 4 <= of_three[r + 1]; next += 4)
      triangles_of_four(triangles + 3 * next, rock_three + next, moduli, x, u, f, &others);
    for (; next < of_three[r + 1]; next++)
      twice += triangle(triangles + 3 * next, moduli + 3 * (int64_t)rock_three[next], x, u, f);
    next = of_four[r];
    for (; next + 4 <= oblique[r]; next += 4) parallelograms(quads + 4 * next, rock_four + next, 4, moduli, x, u, f, &others);
    if (next < oblique[r])
      parallelograms(quads + 4 * next, rock_four + next, oblique[r] - (int)next, moduli, x, u, f, &others);
    for (int64_t k = oblique[r]; k < of_four[r + 1]; k++)
      quadrilateral(quads + 4 * k, moduli + 3 * (int64_t)rock_four[k], x, u, f, &others);
    moved(node[r], node[r + 1], inverse, kick, drift, u, v, f);
  }
  return twice + ((others[0] + others[1]) + (others[2] + others[3]));
}

/* f -= K u of some cells of three and of four nodes. */
FOR_MACHINES double fracflow_cells(int32_t threes, int32_t fours, const int32_t *triangles, const int32_t *quads,
                                   const uint16_t *rock_three, const uint16_t *rock_four, const double *moduli, const double *x,
                                   const double *u, double *f) {
  double twice = 0.0;
  four others = {0.0, 0.0, 0.0, 0.0};
  for (int64_t k = 0; k < threes; k++) twice += triangle(triangles + 3 * k, moduli + 3 * (int64_t)rock_three[k], x, u, f);
  for (int64_t k = 0; k < fours; k++) quadrilateral(quads + 4 * k, moduli + 3 * (int64_t)rock_four[k], x, u, f, &others);
  return twice + ((others[0] + others[1]) + (others[2] + others[3]));
}

FOR_MACHINES void fracflow_move(int32_t first, int32_t last, const double *inverse, double kick, double drift, double *u,
                                double *v, const double *f) {
  moved(first, last, inverse, kick, drift, u, v, f);
}

/* Half a step: v += half a, u += step v. */
FOR_MACHINES void fracflow_start(int32_t n, double half, double step, const double *a, double *u, double *v) {
  for (int64_t i = 0; i < 2 * (int64_t)n; i++) {
    v[i] += half * a[i];
    u[i] += step * v[i];
  }
}

typedef long long pair __attribute__((vector_size(16)));
typedef struct {
  two moving, pushed, work, largest, farthest;
} sums;

INLINE two larger(two one, two other) {
  const pair is_one = one > other;
  return (two)((is_one & (pair)one) | (~is_one & (pair)other));
}

/* Of a node, added to sums of m v v, m a a and s u, and to the largest |m a| and |u|. */
INLINE void add(sums *all, two mass, two s, two u, two v, two a) {
  const two force = mass * a;
  all->moving += mass * v * v, all->pushed += force * a, all->work += s * u;
  all->largest = larger(all->largest, larger(force, -force)), all->farthest = larger(all->farthest, larger(u, -u));
}

INLINE void told(const sums *all, double *found) {
  found[0] = all->moving[0] + all->moving[1], found[1] = all->pushed[0] + all->pushed[1];
  found[2] = all->work[0] + all->work[1];
  const two l = all->largest, u = all->farthest;
  found[3] = l[0] > l[1] ? l[0] : l[1], found[4] = u[0] > u[1] ? u[0] : u[1];
}

/* Those sums, with m of each unknown. */
FOR_MACHINES void fracflow_sums(int32_t n, const double *mass, const double *v, const double *a, const double *s,
                                const double *u, double *found) {
  sums all = {{0.0}};
  for (int64_t i = 0; i < 2 * (int64_t)n; i += 2) add(&all, AT(mass, i), AT(s, i), AT(u, i), AT(v, i), AT(a, i));
  told(&all, found);
}

/* a = f/m where forces alone move a node; those sums; and u, v, a of each node to its place in another order. */
FOR_MACHINES void fracflow_stop(int32_t n, const int32_t *place, const double *inverse, const double *f, const double *mass,
                                const double *s, const double *u, const double *v, double *a, double *to_u, double *to_v,
                                double *to_a, double *found) {
  sums all = {{0.0}};
  for (int64_t k = 0; k < n; k++) {
    const int64_t i = 2 * k, j = 2 * (int64_t)place[k];
    if (inverse[k] > 0.0) TO_IN(a, i) = inverse[k] * AT(f, i);
    add(&all, AT(mass, i), AT(s, i), AT(u, i), AT(v, i), AT(a, i));
    TO_IN(to_u, j) = AT(u, i), TO_IN(to_v, j) = AT(v, i), TO_IN(to_a, j) = AT(a, i);
  }
  told(&all, found);
}

/* Nodes of one order (n,) from places of another: there = here[place]. */
void fracflow_take(int32_t n, const int32_t *place, const double *here, double *there) {
  for (int64_t i = 0; i < n; i++) {
    there[2 * i] = here[2 * (int64_t)place[i]];
    there[2 * i + 1] = here[2 * (int64_t)place[i] + 1];
  }
}

void fracflow_triad(int32_t n, double *a, const double *b, const double *c, double s) {
  for (int64_t i = 0; i < n; i++) a[i] = b[i] + s * c[i];
}
