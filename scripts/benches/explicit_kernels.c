/* Steps of leapfrog, v -= dt K u / m and u += dt v, with two unknowns a node: K by rows, by 2 x 2 blocks, or T3 by cells. */
#include <stddef.h>

void rows(int n, const int *p, const int *c, const double *a, double *u, double *v, const double *w, double dt) {
  for (int i = 0; i < n; i++) {
    double s = 0.0;
    for (int k = p[i]; k < p[i + 1]; k++) s += a[k] * u[c[k]];
    v[i] -= dt * w[i] * s;
  }
  for (int i = 0; i < n; i++) u[i] += dt * v[i];
}

void blocks(int n, const int *p, const int *c, const double *a, double *u, double *v, const double *w, double dt) {
  for (int i = 0; i < n; i++) {
    double s = 0.0, t = 0.0;
    for (int k = p[i]; k < p[i + 1]; k++) {
      const double *b = a + 4 * (size_t)k, x = u[2 * c[k]], y = u[2 * c[k] + 1];
      s += b[0] * x + b[1] * y;
      t += b[2] * x + b[3] * y;
    }
    v[2 * i] -= dt * w[2 * i] * s;
    v[2 * i + 1] -= dt * w[2 * i + 1] * t;
  }
  for (int i = 0; i < 2 * n; i++) u[i] += dt * v[i];
}

/* g: slopes of the first two shape functions by x, then by y, each times the root of the area; f: forces, zero before and after */
void cells(int m, int n, const int *e, const double *g, double lambda, double mu, double *u, double *v, double *f, const double *w,
           double dt) {
  for (int k = 0; k < m; k++) {
    const int *q = e + 3 * (size_t)k;
    const double *b = g + 4 * (size_t)k, x[3] = {b[0], b[1], -b[0] - b[1]}, y[3] = {b[2], b[3], -b[2] - b[3]};
    double xx = 0.0, yy = 0.0, xy = 0.0;
    for (int i = 0; i < 3; i++) {
      const double *d = u + 2 * (size_t)q[i];
      xx += x[i] * d[0];
      yy += y[i] * d[1];
      xy += y[i] * d[0] + x[i] * d[1];
    }
    const double s = (lambda + 2.0 * mu) * xx + lambda * yy, t = (lambda + 2.0 * mu) * yy + lambda * xx, h = mu * xy;
    for (int i = 0; i < 3; i++) {
      f[2 * (size_t)q[i]] += x[i] * s + y[i] * h;
      f[2 * (size_t)q[i] + 1] += y[i] * t + x[i] * h;
    }
  }
  for (int i = 0; i < 2 * n; i++) {
    v[i] -= dt * w[i] * f[i];
    f[i] = 0.0;
    u[i] += dt * v[i];
  }
}

void triad(int n, double *a, const double *b, const double *c, double s) {
  for (int i = 0; i < n; i++) a[i] = b[i] + s * c[i];
}
