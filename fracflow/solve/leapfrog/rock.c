/* (2.39) Forces of cells of plane rock, and steps of its nodes by central differences, in one sweep through memory.

   Arrays of two values a node: places x, displacements u, velocities v at the middle of steps, forces f, outer forces e. Moduli
   d of a rock: D_xx, D_xy, and D_ss of its shear, times engineering shear strain. A cell is a row of nodes and the number of its
   rock. Each function of a cell takes K u off f, and gives twice the strain energy of the cell. */
#include <stdint.h>
#include <string.h>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__gnu_linux__)
#define FOR_MACHINES __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define FOR_MACHINES
#endif
#define INLINE static inline __attribute__((always_inline))

const int fracflow_leapfrog_version = 1;

typedef double four __attribute__((vector_size(32)));

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

/* The four places of quadrature side by side. A field of corner values p is p_0 + p_1 xi + p_2 eta + p_3 xi eta. */
INLINE double quadrilateral(const int32_t *cell, const double *d, const double *x, const double *u, double *f) {
  const double g = 0.57735026918962576451;
  const four xi = {-g, g, g, -g}, eta = {-g, -g, g, g};
  const int64_t a = 2 * (int64_t)cell[0], b = 2 * (int64_t)cell[1], c = 2 * (int64_t)cell[2], e = 2 * (int64_t)cell[3];
  double slope[2][2][3]; /* of places, of displacements; by component; p_1, p_2, p_3 */
  for (int field = 0; field < 2; field++) {
    const double *p = field ? u : x;
    for (int i = 0; i < 2; i++) {
      const double first = p[c + i] - p[a + i], second = p[b + i] - p[e + i];
      slope[field][i][0] = 0.25 * (first + second);
      slope[field][i][1] = 0.25 * (first - second);
      slope[field][i][2] = 0.25 * ((p[a + i] - p[b + i]) + (p[c + i] - p[e + i]));
    }
  }
#define BY_XI(field, i) (slope[field][i][0] + slope[field][i][2] * eta)
#define BY_ETA(field, i) (slope[field][i][1] + slope[field][i][2] * xi)
#define SUM(z) (((z)[0] + (z)[1]) + ((z)[2] + (z)[3]))
  const four xa = BY_XI(0, 0), ya = BY_XI(0, 1), xb = BY_ETA(0, 0), yb = BY_ETA(0, 1);
  const four ua = BY_XI(1, 0), va = BY_XI(1, 1), ub = BY_ETA(1, 0), vb = BY_ETA(1, 1);
  const four w = 1.0 / (xa * yb - xb * ya);
  const four xx = ua * yb - ub * ya, yy = xa * vb - xb * va, xy = xa * ub - xb * ua + va * yb - vb * ya;
  const four s = w * (d[0] * xx + d[1] * yy), t = w * (d[1] * xx + d[0] * yy), h = w * (d[2] * xy);
  const four ax = s * yb - h * xb, ay = h * yb - t * xb, bx = h * xa - s * ya, by = t * xa - h * ya;
  const four cx = ax * eta + bx * xi, cy = ay * eta + by * xi, twice = s * xx + t * yy + h * xy;
  const double fa[2] = {0.25 * SUM(ax), 0.25 * SUM(ay)}, fb[2] = {0.25 * SUM(bx), 0.25 * SUM(by)};
  const double fc[2] = {0.25 * SUM(cx), 0.25 * SUM(cy)};
  for (int i = 0; i < 2; i++) {
    f[a + i] += fa[i] + fb[i] - fc[i];
    f[b + i] -= fa[i] - fb[i] - fc[i];
    f[c + i] -= fa[i] + fb[i] + fc[i];
    f[e + i] -= fb[i] - fa[i] - fc[i];
  }
  return SUM(twice);
}

/* Nodes from first to last: v += kick f/m, u += drift v. */
INLINE void moved(int64_t first, int64_t last, const double *inverse, double kick, double drift, double *u, double *v, const double *f) {
  for (int64_t i = first; i < last; i++) {
    const double by = kick * inverse[i], vx = v[2 * i] + by * f[2 * i], vy = v[2 * i + 1] + by * f[2 * i + 1];
    v[2 * i] = vx, v[2 * i + 1] = vy;
    u[2 * i] += drift * vx, u[2 * i + 1] += drift * vy;
  }
}

/* f = e - K u, and the step of each node right after its last cell. Cells are in the order of their lowest nodes: those of range
   r, from its first triangle and quadrilateral on, begin at nodes from node[r] on, and touch none from top[r] on but others that
   do not move here. Nodes before begun have their e. */
FOR_MACHINES double fracflow_sweep(int32_t ranges, int32_t begun, const int32_t *node, const int32_t *top, const int32_t *of_three,
                                   const int32_t *of_four, const int32_t *three, const int32_t *four_, const uint16_t *rock_three, const uint16_t *rock_four,
                                   const double *moduli, const double *x, const double *inverse, const double *e, double kick,
                                   double drift, double *u, double *v, double *f) {
  double twice = 0.0;
  for (int32_t r = 0; r < ranges; r++) {
    if (top[r] > begun) {
      memcpy(f + 2 * (int64_t)begun, e + 2 * (int64_t)begun, 2 * sizeof(double) * (size_t)(top[r] - begun));
      begun = top[r];
    }
    for (int64_t k = of_three[r]; k < of_three[r + 1]; k++)
      twice += triangle(three + 3 * k, moduli + 3 * (int64_t)rock_three[k], x, u, f);
    for (int64_t k = of_four[r]; k < of_four[r + 1]; k++)
      twice += quadrilateral(four_ + 4 * k, moduli + 3 * (int64_t)rock_four[k], x, u, f);
    moved(node[r], node[r + 1], inverse, kick, drift, u, v, f);
  }
  return twice;
}

/* f -= K u of some cells of three and of four nodes. */
FOR_MACHINES double fracflow_cells(int32_t threes, int32_t fours, const int32_t *three, const int32_t *four_, const uint16_t *rock_three,
                                   const uint16_t *rock_four, const double *moduli, const double *x, const double *u, double *f) {
  double twice = 0.0;
  for (int64_t k = 0; k < threes; k++) twice += triangle(three + 3 * k, moduli + 3 * (int64_t)rock_three[k], x, u, f);
  for (int64_t k = 0; k < fours; k++) twice += quadrilateral(four_ + 4 * k, moduli + 3 * (int64_t)rock_four[k], x, u, f);
  return twice;
}

FOR_MACHINES void fracflow_move(int32_t first, int32_t last, const double *inverse, double kick, double drift, double *u, double *v,
                                const double *f) {
  moved(first, last, inverse, kick, drift, u, v, f);
}

/* Half a step: v += half a, u += step v. */
FOR_MACHINES void fracflow_start(int32_t n, double half, double step, const double *a, double *u, double *v) {
  for (int64_t i = 0; i < 2 * (int64_t)n; i++) {
    v[i] += half * a[i];
    u[i] += step * v[i];
  }
}

/* a = f/m where forces alone move a node. */
FOR_MACHINES void fracflow_stop(int32_t n, const double *inverse, const double *f, double *a) {
  for (int64_t i = 0; i < 2 * (int64_t)n; i++)
    if (inverse[i / 2] > 0.0) a[i] = inverse[i / 2] * f[i];
}

/* Sums of m v v, m a a and s u, with m of each unknown. */
FOR_MACHINES void fracflow_sums(int32_t n, const double *mass, const double *v, const double *a, const double *s, const double *u,
                                double *sums) {
  double moving = 0.0, pushed = 0.0, work = 0.0;
  for (int64_t i = 0; i < 2 * (int64_t)n; i++) {
    moving += mass[i] * v[i] * v[i];
    pushed += mass[i] * a[i] * a[i];
    work += s[i] * u[i];
  }
  sums[0] = moving, sums[1] = pushed, sums[2] = work;
}

/* Nodes of one order (n,) from places of another: there = here[place]; back: there[place] = here. */
void fracflow_take(int32_t n, const int32_t *place, const double *here, double *there) {
  for (int64_t i = 0; i < n; i++) {
    there[2 * i] = here[2 * (int64_t)place[i]];
    there[2 * i + 1] = here[2 * (int64_t)place[i] + 1];
  }
}

void fracflow_give(int32_t n, const int32_t *place, const double *here, double *there) {
  for (int64_t i = 0; i < n; i++) {
    there[2 * (int64_t)place[i]] = here[2 * i];
    there[2 * (int64_t)place[i] + 1] = here[2 * i + 1];
  }
}

void fracflow_triad(int32_t n, double *a, const double *b, const double *c, double s) {
  for (int64_t i = 0; i < n; i++) a[i] = b[i] + s * c[i];
}
