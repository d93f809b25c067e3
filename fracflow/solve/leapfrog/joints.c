/* The motion of joints in an explicit step, cluster by cluster, as ``joints.py`` has it for all at once, in the plane.

   A guess alone: the laws of ``fracflow/laws`` judge it, and answer for it. Friction is that of ``laws/friction.h``, a linear
   law as in ``linear.py``. Where friction alone acts its answer is ``laws/response.h``'s, of the last trial. */
#include "../../laws/response.h"
#include "machines.h"
#include <stdint.h>
#include <string.h>

#define MOST_MEMBERS 8
#define MOST_SIZE (2 * MOST_MEMBERS)
#define UNIT 2.220446049250313e-16
#define LEFT 1e-14 /* of the motion of the cluster */
#define ALIKE 1e-15 /* of a compliance */

/* columns of what a section was before the step with its free motion, and of what it is after it */
enum { FREE, STRAIN = 2, TRACTION = 4, TANGENT = 6, PLASTIC = 10, STATUS, PATH, BEFORE, FOUND = 7 };

typedef struct {
  double traction[2], tangent[4], status;
} response;

/* The response at a strain; ``status`` is the direction of sliding, 0 while it sticks, and stays where it is held; tractions
   are those of statuses held. 0 where crushed. */
INLINE int responds(const double *law, const double *before, const double *strain, double status, int is_held, friction *at,
                    response *found) {
  double *f = found->traction, *d = found->tangent;
  d[1] = d[2] = 0.0, found->status = status;
  if (law[KIND] == LINEAR) {
    f[0] = law[F_S] + law[K_S] * strain[0], f[1] = law[F_N] + law[K_N] * strain[1];
    d[0] = law[K_S], d[3] = law[K_N];
    return 1;
  }
  if (!(strain[1] > -law[GAP])) return 0;
  const past was = {before[PLASTIC], status, before[PATH]};
  rub(law, &was, strain, is_held, at);
  f[0] = at->slides ? at->carried * at->way : at->is_free ? 0.0 : at->shear, f[1] = at->f_n;
  d[0] = at->slides ? at->by_size * law[K_S] : at->is_free ? 0.0 : law[K_S], d[3] = at->k_n;
  if (at->slides && at->f_n < 0.0) d[1] = at->by_normal * at->k_n * at->way;
  found->status = at->slides ? at->way : 0.0;
  return 1;
}

/* x = A^-1 x by elimination with pivots; 0 where A is singular. */
static int solves(int n, double a[MOST_SIZE][MOST_SIZE], double *x) {
  for (int k = 0; k < n; k++) {
    int p = k;
    for (int i = k + 1; i < n; i++)
      if (fabs(a[i][k]) > fabs(a[p][k])) p = i;
    if (!(fabs(a[p][k]) > 0.0)) return 0;
    if (p != k) {
      for (int j = k; j < n; j++) {
        const double kept = a[k][j];
        a[k][j] = a[p][j], a[p][j] = kept;
      }
      const double kept = x[k];
      x[k] = x[p], x[p] = kept;
    }
    for (int i = k + 1; i < n; i++) {
      const double by = a[i][k] / a[k][k];
      if (by == 0.0) continue;
      for (int j = k + 1; j < n; j++) a[i][j] -= by * a[k][j];
      x[i] -= by * x[k];
    }
  }
  for (int k = n - 1; k >= 0; k--) {
    for (int j = k + 1; j < n; j++) x[k] -= a[k][j] * x[j];
    x[k] /= a[k][k];
  }
  return 1;
}

typedef struct {
  const double *law[MOST_MEMBERS], *before[MOST_MEMBERS];
  friction at[MOST_MEMBERS]; /* of the last trial */
  double status[MOST_MEMBERS], next[MOST_MEMBERS], change[MOST_SIZE], left[MOST_SIZE], traction[MOST_SIZE];
  double moduli[4 * MOST_MEMBERS];
} cluster;

/* What is left of the motion of a cluster while no section changes its status, and its moduli times weights. Tractions and next
   statuses are those of the laws. -1 where crushed, 1 where no more is left than round-off. */
static int balances(cluster *c, int members, const double *compliance, double share) {
  const int n = 2 * members;
  double push[MOST_SIZE], known[MOST_SIZE], moved = 0.0;
  for (int m = 0; m < members; m++) {
    const double *before = c->before[m], weight = c->law[m][WEIGHT];
    const double strain[2] = {before[STRAIN] + c->change[2 * m], before[STRAIN + 1] + c->change[2 * m + 1]};
    response at;
    friction held;
    if (!responds(c->law[m], before, strain, c->status[m], 0, c->at + m, &at)) return -1;
    c->next[m] = at.status, c->traction[2 * m] = at.traction[0], c->traction[2 * m + 1] = at.traction[1];
    if (at.status != c->status[m]) responds(c->law[m], before, strain, c->status[m], 1, &held, &at);
    for (int k = 0; k < 4; k++) c->moduli[4 * m + k] = weight * at.tangent[k];
    for (int i = 0; i < 2; i++) {
      const double *d = at.tangent + 2 * i;
      push[2 * m + i] = weight * (at.traction[i] - before[TRACTION + i]);
      known[2 * m + i] = weight * (fabs(d[0] * strain[0]) + fabs(d[1] * strain[1]) + 2.0 * fabs(at.traction[i]));
      moved = fmax(moved, fabs(c->change[2 * m + i]));
    }
  }
  int is_done = 1;
  for (int i = 0; i < n; i++) {
    const double free = c->before[i / 2][FREE + i % 2], *row = compliance + (int64_t)n * i;
    double pulled = 0.0, size = 0.0;
    for (int j = 0; j < n; j++) pulled += row[j] * push[j], size += fabs(row[j]) * known[j];
    c->left[i] = free - c->change[i] - share * pulled;
    size = fabs(free) + fabs(c->change[i]) + share * size;
    if (!(fabs(c->left[i]) <= 4.0 * UNIT * size + LEFT * moved)) is_done = 0;
  }
  return is_done;
}

/* Newton's correction, as far as no section closes by more than 0.9 of its gap. */
static int corrects(cluster *c, int members, const double *compliance, double share) {
  const int n = 2 * members;
  double matrix[MOST_SIZE][MOST_SIZE], allowed = 1.0;
  for (int i = 0; i < n; i++)
    for (int m = 0; m < members; m++) {
      const double *row = compliance + (int64_t)n * i + 2 * m, *d = c->moduli + 4 * m;
      matrix[i][2 * m] = share * (row[0] * d[0] + row[1] * d[2]) + (i == 2 * m);
      matrix[i][2 * m + 1] = share * (row[0] * d[1] + row[1] * d[3]) + (i == 2 * m + 1);
    }
  if (!solves(n, matrix, c->left)) return 0;
  for (int m = 0; m < members; m++) {
    const double closes = -c->left[2 * m + 1], gap = c->before[m][STRAIN + 1] + c->change[2 * m + 1] + c->law[m][GAP];
    if (c->law[m][KIND] != LINEAR && closes > 0.0) allowed = fmin(allowed, 0.9 * gap / closes);
  }
  for (int i = 0; i < n; i++) c->change[i] += allowed * c->left[i];
  return 1;
}

/* Iterations of a cluster until it is in balance and no section changes its status; 0 where it does not come there. */
static int settles(cluster *c, int members, const double *compliance, double share, int most, int most_changes) {
  int total = 0;
  for (int i = 0; i < 2 * members; i++) c->change[i] = 0.0, c->left[i] = c->before[i / 2][FREE + i % 2];
  for (int m = 0; m < members; m++)
    for (int k = 0; k < 4; k++) c->moduli[4 * m + k] = c->law[m][WEIGHT] * c->before[m][TANGENT + k];
  for (int round = 0; round < most_changes; round++) {
    int done = round ? balances(c, members, compliance, share) : 0;
    for (int since = 0; done == 0 && since <= most; since++) {
      total++;
      if (!corrects(c, members, compliance, share)) return 0;
      done = balances(c, members, compliance, share);
    }
    if (done != 1) return 0;
    int changes = 0;
    for (int m = 0; m < members; m++)
      if (c->next[m] != c->status[m]) changes = 1, c->status[m] = c->next[m];
    if (!changes) return total;
  }
  return 0;
}

/* Whether compliances between any two sections of a cluster are equal: they share both nodes and their frame, as on a straight
   fault, and move by their free motion less one x that they have in common. */
static int is_alike(int members, const double *compliance) {
  const int n = 2 * members;
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++)
      if (fabs(compliance[n * i + j] - compliance[n * (i % 2) + j % 2]) > ALIKE * fabs(compliance[0])) return 0;
  return 1;
}

/* x of such a cluster, K = S G M^-1 G' between any two of its sections, what is left of x = K sum w (f - f_old), and sum w D.
   */
typedef struct {
  double x[2], compliance[4], left[2], moduli[4];
} common;

/* ``balances`` of it. */
INLINE int balances_alike(cluster *c, int members, common *all) {
  double push[2] = {0.0}, known[2] = {0.0}, free[2] = {0.0}, moved = 0.0, *k = all->compliance;
  for (int i = 0; i < 4; i++) all->moduli[i] = 0.0;
  for (int m = 0; m < members; m++) {
    const double *before = c->before[m], weight = c->law[m][WEIGHT];
    double *change = c->change + 2 * m, *traction = c->traction + 2 * m;
    change[0] = before[FREE] - all->x[0], change[1] = before[FREE + 1] - all->x[1];
    const double strain[2] = {before[STRAIN] + change[0], before[STRAIN + 1] + change[1]};
    response at;
    friction held;
    if (!responds(c->law[m], before, strain, c->status[m], 0, c->at + m, &at)) return -1;
    c->next[m] = at.status, traction[0] = at.traction[0], traction[1] = at.traction[1];
    if (at.status != c->status[m]) responds(c->law[m], before, strain, c->status[m], 1, &held, &at);
    for (int i = 0; i < 2; i++) {
      const double *d = at.tangent + 2 * i;
      all->moduli[2 * i] += weight * d[0], all->moduli[2 * i + 1] += weight * d[1];
      push[i] += weight * (at.traction[i] - before[TRACTION + i]);
      known[i] += weight * (fabs(d[0] * strain[0]) + fabs(d[1] * strain[1]) + 2.0 * fabs(at.traction[i]));
      free[i] = most_of(free[i], fabs(before[FREE + i]) + fabs(change[i])), moved = most_of(moved, fabs(change[i]));
    }
  }
  int is_done = 1;
  for (int i = 0; i < 2; i++, k += 2) {
    all->left[i] = k[0] * push[0] + k[1] * push[1] - all->x[i];
    const double size = free[i] + fabs(k[0]) * known[0] + fabs(k[1]) * known[1];
    if (!(fabs(all->left[i]) <= 4.0 * UNIT * size + LEFT * moved)) is_done = 0;
    for (int m = 0; m < members; m++) c->left[2 * m + i] = -all->left[i];
  }
  return is_done;
}

/* x += (1 + K sum w D)^-1 of what is left. */
INLINE void corrects_alike(common *all) {
  const double *k = all->compliance, *d = all->moduli, r = all->left[0], s = all->left[1];
  const double a = 1.0 + k[0] * d[0] + k[1] * d[2], b = k[0] * d[1] + k[1] * d[3];
  const double e = k[2] * d[0] + k[3] * d[2], f = 1.0 + k[2] * d[1] + k[3] * d[3], by = 1.0 / (a * f - b * e);
  all->x[0] += by * (f * r - b * s), all->x[1] += by * (a * s - e * r);
}

/* ``settles`` of it, for x alone; 0 also where a section would be crushed, which it leaves to that. */
INLINE int settles_alike(cluster *c, int members, const double *compliance, double share, int most, int most_changes) {
  const int n = 2 * members;
  const double *k = compliance;
  common all = {{0.0}, {share * k[0], share * k[1], share * k[n], share * k[n + 1]}, {0.0}, {0.0}};
  int total = 0;
  for (int m = 0; m < members; m++) {
    const double *before = c->before[m], *d = before + TANGENT, *free = before + FREE, weight = c->law[m][WEIGHT];
    for (int i = 0; i < 4; i++) all.moduli[i] += weight * d[i];
    const double push[2] = {weight * (d[0] * free[0] + d[1] * free[1]), weight * (d[2] * free[0] + d[3] * free[1])};
    for (int i = 0; i < 2; i++) all.left[i] += all.compliance[2 * i] * push[0] + all.compliance[2 * i + 1] * push[1];
  }
  for (int round = 0; round < most_changes; round++) {
    int done = round ? balances_alike(c, members, &all) : 0;
    for (int since = 0; done == 0 && since <= most; since++) {
      total++;
      corrects_alike(&all);
      done = balances_alike(c, members, &all);
    }
    if (done != 1) return 0;
    int changes = 0;
    for (int m = 0; m < members; m++)
      if (c->next[m] != c->status[m]) changes = 1, c->status[m] = c->next[m];
    if (!changes) return total;
  }
  return 0;
}

/* Of each section motion, status, traction, and what is left of the motion (s, 7), of clusters of as many members each, whose
   sections are ``rows`` of the tables.
   Answers of ``count`` sections by friction, as of ``response.h``, and their statuses; NULL where laws find them.
   The most iterations of a cluster; -1 where one of them did not come into balance. */
int32_t fracflow_joints(int32_t clusters, int32_t members, const int64_t *rows, const double *compliance, double share,
                        const double *laws, const double *before, int32_t most, int32_t most_changes, double *found,
                        int32_t count, int32_t is_coupled, double *answers, int8_t *statuses) {
  int32_t worst = 0;
  if (members > MOST_MEMBERS) return -1;
  for (int64_t k = 0; k < clusters; k++) {
    cluster c;
    const int64_t *row = rows + k * members;
    for (int m = 0; m < members; m++) {
      c.law[m] = laws + LAW * row[m], c.before[m] = before + BEFORE * row[m];
      c.status[m] = c.before[m][STATUS];
    }
    const double *own = compliance + k * 4 * members * members;
    int total = 0;
    if (is_alike(members, own)) /* mostly both sections of one joint, for which a compiler unrolls the loops */
      total = members == 2 ? settles_alike(&c, 2, own, share, most, most_changes)
                           : settles_alike(&c, members, own, share, most, most_changes);
    if (total == 0) {
      for (int m = 0; m < members; m++) c.status[m] = c.before[m][STATUS];
      total = settles(&c, members, own, share, most, most_changes);
    }
    if (total == 0) return -1;
    if (total > worst) worst = total;
    for (int m = 0; m < members; m++) {
      double *to = found + FOUND * row[m];
      to[0] = c.change[2 * m], to[1] = c.change[2 * m + 1], to[2] = c.status[m];
      to[3] = c.traction[2 * m], to[4] = c.traction[2 * m + 1], to[5] = c.left[2 * m], to[6] = c.left[2 * m + 1];
      if (!answers) continue;
      const double *was = c.before[m], strain[2] = {was[STRAIN] + to[0], was[STRAIN + 1] + to[1]};
      const past history = {was[PLASTIC], c.status[m], was[PATH]};
      answer(c.law[m], &history, c.at + m, strain, is_coupled, c.law[m][KIND] == WEAKENING, row[m], count, answers, statuses);
    }
  }
  return worst;
}

/* ``energy.joint_work`` and ``energy.dissipated`` of sections in the plane, and what ``steps.Run.pull`` keeps of them. Adds
   the work of friction and the five sums; ``blur`` is ``residual.round_off_of_jumps`` of ``moved``, ``record`` the largest
   traction. */
void fracflow_work(int32_t n, const double *weight, const double *t0, const double *e0, const double *p0, const double *s0,
                   const double *r0, const double *b0, const double *t, const double *e, const double *p, const double *s,
                   const double *moved, double *record, double *blur, double *friction, double *sums) {
  double normal = 0.0, shear = 0.0, plastic = 0.0, stored = 0.0, apart = 0.0;
  for (int64_t k = 0; k < n; k++) {
    const int64_t i = 2 * k, j = i + 1;
    const double f = 0.5 * (t0[i] + t[i]), g = 0.5 * (t0[j] + t[j]), w = weight[k];
    const double along = f * (p[i] - p0[i]), across = g * (p[j] - p0[j]);
    friction[k] += along + across;
    normal += w * (g * (e[j] - e0[j]) - across), shear += w * (f * (e[i] - e0[i]) - along);
    plastic += w * (along + across), stored += w * (s[k] - s0[k]), apart -= w * across;
    const double size = sqrt(t[i] * t[i] + t[j] * t[j]);
    record[k] = size > r0[k] ? size : r0[k];
    for (int64_t m = i; m <= j; m++) {
      const double more = 0.5 * UNIT * moved[m];
      blur[m] = sqrt(b0[m] * b0[m] + more * more);
    }
  }
  sums[0] += normal, sums[1] += shear, sums[2] += plastic, sums[3] += stored, sums[4] += apart;
}
