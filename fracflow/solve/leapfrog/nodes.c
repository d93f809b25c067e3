/* Passes of an explicit step over the nodes of joints in the plane, each of which ``joint_nodes.py`` has in NumPy too.

   Section s has entries from starts[s] on, two each, of both its rows of G, at places ``at`` of all nodes on which more than
   the rock acts, and at places ``to`` of those that are pushed. */
#include "machines.h"
#include <math.h>
#include <stdint.h>
#include <string.h>

/* dt v at places (n,). */
void fracflow_predict(int32_t n, const int64_t *place, const double *v, double dt, double *moved) {
  for (int64_t i = 0; i < n; i++) moved[i] = dt * v[place[i]];
}

/* G times motion, (n, 2). */
void fracflow_jumps(int32_t n, const int32_t *starts, const int32_t *at, const double *entries, const double *moved,
                    double *found) {
  for (int64_t s = 0; s < n; s++) {
    double x = 0.0, y = 0.0;
    for (int64_t k = starts[s]; k < starts[s + 1]; k++) {
      const double u = moved[at[k]];
      x += entries[2 * k] * u, y += entries[2 * k + 1] * u;
    }
    found[2 * s] = x, found[2 * s + 1] = y;
  }
}

/* Forces G' W (before - after) of sections on pushed nodes (p,), which they also add to ``pushed``; S M^-1 of them is added to
   ``added`` and to the motion there, at places ``of_pushed``. |G| |motion| after that into ``sizes`` (n, 2). */
void fracflow_pull(int32_t n, int32_t p, const int32_t *starts, const int32_t *at, const int32_t *to, const double *entries,
                   const double *weights, const double *before, const double *after, const double *inverse, double share,
                   const int32_t *of_pushed, double *force, double *pushed, double *added, double *moved, double *sizes) {
  memset(force, 0, sizeof(double) * (size_t)p);
  for (int64_t s = 0; s < n; s++) {
    const double x = weights[s] * (before[2 * s] - after[2 * s]), y = weights[s] * (before[2 * s + 1] - after[2 * s + 1]);
    for (int64_t k = starts[s]; k < starts[s + 1]; k++) force[to[k]] += entries[2 * k] * x + entries[2 * k + 1] * y;
  }
  for (int64_t i = 0; i < p; i++) {
    const double more = share * (inverse[i] * force[i]);
    pushed[i] += force[i], added[i] += more, moved[of_pushed[i]] += more;
  }
  for (int64_t s = 0; s < n; s++) {
    double x = 0.0, y = 0.0;
    for (int64_t k = starts[s]; k < starts[s + 1]; k++) {
      const double u = fabs(moved[at[k]]);
      x += fabs(entries[2 * k]) * u, y += fabs(entries[2 * k + 1]) * u;
    }
    sizes[2 * s] = x, sizes[2 * s + 1] = y;
  }
}

/* force -= G' W f */
void fracflow_resist(int32_t n, const int32_t *starts, const int32_t *at, const double *entries, const double *weights,
                     const double *traction, double *force) {
  for (int64_t s = 0; s < n; s++) {
    const double x = weights[s] * traction[2 * s], y = weights[s] * traction[2 * s + 1];
    for (int64_t k = starts[s]; k < starts[s + 1]; k++) force[at[k]] -= entries[2 * k] * x + entries[2 * k + 1] * y;
  }
}

/* there[place] = values, or += where ``adds``. */
void fracflow_put(int32_t n, int32_t adds, const int64_t *place, const double *values, double *there) {
  if (adds)
    for (int64_t i = 0; i < n; i++) there[place[i]] += values[i];
  else
    for (int64_t i = 0; i < n; i++) there[place[i]] = values[i];
}

/* a = w f at places (n,). */
void fracflow_accelerate(int32_t n, const int64_t *place, const double *inverse, const double *f, double *a) {
  for (int64_t i = 0; i < n; i++) a[i] = inverse[i] * f[place[i]];
}

/* Sum of forces times accelerations before and after, where masses are not infinite. */
double fracflow_gain(int32_t n, const double *inverse, const double *force, const double *before, const double *after) {
  double sum = 0.0;
  for (int64_t i = 0; i < n; i++)
    if (inverse[i] > 0.0) sum += force[i] * (before[i] + after[i]);
  return sum;
}

typedef double four __attribute__((vector_size(32), aligned(8)));

/* y = by A x of a symmetric matrix in blocks of two, by its blocks on and right of the diagonal; the first of a row is on it. The
   sum of (y + before) times ``moved``. Takes y off ``force``. Columns from n on, of other ranks, add to y there: none reads it. */
FOR_MACHINES double fracflow_damp(int32_t n, const int32_t *starts, const int32_t *columns, const double *blocks, double by, const double *moved,
                             const double *before, double *y, double *force) {
  double work = 0.0;
  memset(y, 0, 2 * sizeof(double) * (size_t)n);
  for (int64_t i = 0; i < n; i++) {
    const double x0 = moved[2 * i], x1 = moved[2 * i + 1];
    const four down = {x0, x0, x1, x1};
    int32_t k = starts[i];
    four sum = *(const four *)(blocks + 4 * (int64_t)k) * (four){x0, x1, x0, x1};
    for (k++; k < starts[i + 1]; k++) {
      const int64_t j = 2 * (int64_t)columns[k];
      const four block = *(const four *)(blocks + 4 * (int64_t)k), turned = block * down;
      const double z0 = moved[j], z1 = moved[j + 1];
      sum += block * (four){z0, z1, z0, z1};
      y[j] += turned[0] + turned[2], y[j + 1] += turned[1] + turned[3];
    }
    const double y0 = by * (y[2 * i] + (sum[0] + sum[1])), y1 = by * (y[2 * i + 1] + (sum[2] + sum[3]));
    work += (y0 + before[2 * i]) * x0 + (y1 + before[2 * i + 1]) * x1;
    y[2 * i] = y0, y[2 * i + 1] = y1;
    force[2 * i] -= y0, force[2 * i + 1] -= y1;
  }
  return work;
}

/* Columns of sections before a step, as ``joints.c`` has them; histories that are NULL are left as they are. */
void fracflow_before(int32_t n, const double *free, const double *strain, const double *traction, const double *tangent,
                     const double *plastic, const double *sliding, const double *path, double *before) {
  for (int64_t i = 0; i < n; i++) {
    double *row = before + 13 * i;
    row[0] = free[2 * i], row[1] = free[2 * i + 1], row[2] = strain[2 * i], row[3] = strain[2 * i + 1];
    row[4] = traction[2 * i], row[5] = traction[2 * i + 1];
    for (int k = 0; k < 4; k++) row[6 + k] = tangent[4 * i + k];
    if (plastic) row[10] = plastic[i], row[11] = sliding[i];
    if (path) row[12] = path[i];
  }
}

/* Strains (n, 2) after a step that ``joints.c`` found. Into ``largest`` the most of motion and of what is left of it; whether
   any status has changed. */
int32_t fracflow_after(int32_t n, const double *before, const double *found, double *strain, double *largest) {
  int changes = 0;
  double most = 0.0, worst = 0.0;
  for (int64_t i = 0; i < n; i++) {
    const double *was = before + 13 * i, *is = found + 7 * i;
    changes |= was[11] != is[2];
    for (int k = 0; k < 2; k++) {
      strain[2 * i + k] = was[2 + k] + is[k];
      most = fabs(is[k]) > most ? fabs(is[k]) : most, worst = fabs(is[5 + k]) > worst ? fabs(is[5 + k]) : worst;
    }
  }
  largest[0] = most, largest[1] = worst;
  return changes;
}
