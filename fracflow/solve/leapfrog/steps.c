/* Explicit steps in a row, as ``steps.Run`` takes them one by one, by the same loops. For joints whose law has a compiled
   answer, sides of dashpots and waves, one damping, supports, and loads that change. A step is in pieces: on several ranks
   values travel between them. */
#include "../../laws/response.h"
#include "loops.h"
#include <math.h>
#include <string.h>

/* The struct, and its text, from which ``compiled.py`` makes the same one. */
#define STEPS(...) \
  typedef struct { __VA_ARGS__ } steps; \
  const char fracflow_steps_members[] = #__VA_ARGS__; \
  const int64_t fracflow_steps_size = sizeof(steps);

/* All are of 8 bytes. Arrays in pairs are those before a step and after it, which change places. */
STEPS(
  int64_t sections, every, forced, pushed, own, both, ranges, batches, terms, damped;
  /* sections and pushed unknowns with those of other ranks behind this one's; unknowns of others, and their first place */
  int64_t sections_all, pushed_all, ghosts, first_ghost;
  /* nodes of the rock that move in the sweep, that are this rank's, and all; cells with nodes of other ranks */
  int64_t early, owned, whole, threes, fours;
  int64_t is_coupled, has_path, most, most_changes;
  /* whether damping waits for the first section that slides or opens: that step is not for these loops */
  int64_t damping_waits;
  /* unknowns with loads that change, and of supports; the row of their tables, below, that a step begins with */
  int64_t loaded, held, row;
  double dt, share, most_pressed;
  /* the rock, as in rock.c */
  const int32_t *node, *top, *of_three, *of_four, *oblique, *triangles, *quads;
  const uint8_t *quiet;
  const uint16_t *rock_three, *rock_four;
  const double *moduli, *x, *inverse;
  double *e, *u, *v, *f;
  const int32_t *triangles_late, *quads_late;
  const uint16_t *rock_three_late, *rock_four_late;
  /* nodes of joints, as in nodes.c; ``accelerations`` (p,) of what they push */
  const int32_t *starts, *at, *to;
  const double *entries, *weights, *inverse_pushed;
  const int32_t *of_pushed;
  const int64_t *places, *places_forced, *places_pushed;
  double *moved, *free, *sizes, *force, *added, *scratch, *forces;
  const double *base;
  double *accelerations[2];
  /* places of unknowns with loads that change (m,) among all and among pushed; their initial stress (m,); loads (rows, m) */
  const int64_t *at_loads, *by_loads;
  const double *prestress, *loads;
  /* places of supports (h,) among all, in the rock, and of each unknown at ``at_own`` among supports, -1 of none; masses there;
     tables (rows, h) of displacement, mean velocity and acceleration; forces (h,) of supports */
  const int64_t *at_held, *places_held, *held_of_own;
  const double *mass_own, *held_at, *held_speed, *held_acceleration;
  double *support;
  /* where waves come in, their forces (rows, terms, o) at ``at_own`` at the ends of steps */
  int64_t waves;
  const double *incoming;
  /* laws and clusters, as in joints.c: numbers (b, 2) of clusters and their members, and addresses of both arrays of a batch */
  const double *laws;
  double *before, *found;
  const int64_t *shapes, *const *rows;
  const double *const *compliance;
  double *strain[2], *values[2], *record[2], *blur[2], *friction;
  int8_t *statuses[2];
  /* nodes with dashpots: places of unknowns (o,) among all, in the rock, and pairs (b, 2) of pushed ones and them that are the
     same; blocks (o/2, 4) of (M + dt/2 C)^-1 and of each C; forces (o,) of each C */
  const int64_t *at_own, *places_own, *shared;
  const double *inverse_own;
  const double *const *dashpots;
  double *const *resisting, *u_own, *a_own, *a_rock;
  /* a matrix of damping, as in nodes.c, whose unknowns come first of all; its forces */
  const int32_t *damping_starts, *damping_columns;
  const double *damping;
  double *damped_forces[2];
  /* sums over the steps: (5,) of joints, the scheme, loads and supports, damping, each C; strain energy at the last one */
  double *of_joints, scheme, boundaries, of_damping, *of_terms, energy;
  double iterations, left;
  /* of joints in a step, the most over ranks: whether there is no answer, iterations, motion, and what is left of it */
  double *agreed;
)

static void swap(double **pair) {
  double *kept = pair[0];
  pair[0] = pair[1], pair[1] = kept;
}

/* The motion of this rank's unknowns without what joints change, and with loads and supports. */
static void predicts(steps *s) {
  const double *was = s->loads + s->row * s->loaded, *is = was + s->loaded;
  fracflow_predict((int32_t)s->every, s->places, s->v, s->dt, s->moved);
  memset(s->force, 0, sizeof(double) * (size_t)s->pushed_all), memset(s->added, 0, sizeof(double) * (size_t)s->pushed_all);
  for (int64_t i = 0; i < s->loaded; i++) {
    const int64_t k = s->by_loads[i];
    s->force[k] = is[i] - was[i], s->added[k] = s->share * (s->inverse_pushed[k] * s->force[k]);
    s->moved[s->at_loads[i]] += s->added[k];
  }
  was = s->held_at + s->row * s->held, is = was + s->held;
  for (int64_t i = 0; i < s->held; i++) s->moved[s->at_held[i]] = is[i] - was[i];
}

/* Sections at the end of a step into the second of each pair. */
static void joints_balance(steps *s) {
  const int64_t n = s->sections_all;
  double *was = s->values[0], *is = s->values[1], *agreed = s->agreed;
  memset(agreed, 0, 4 * sizeof(double));
  fracflow_jumps((int32_t)n, s->starts, s->at, s->entries, s->moved, s->free);
  fracflow_before((int32_t)n, s->free, s->strain[0], was + of_traction * n, was + of_tangent * n, was + of_plastic_slip * n,
                  was + of_sliding * n, s->has_path ? was + of_slip_path * n : 0, s->before);
  for (int64_t k = 0; k < s->batches; k++) {
    const int32_t done = fracflow_joints((int32_t)s->shapes[2 * k], (int32_t)s->shapes[2 * k + 1], s->rows[k], s->compliance[k],
                                         s->share, s->laws, s->before, (int32_t)s->most, (int32_t)s->most_changes, s->found,
                                         (int32_t)n, (int32_t)s->is_coupled, is, s->statuses[1]);
    if (done < 0) {
      agreed[0] = 1.0;
      return;
    }
    if (done > agreed[1]) agreed[1] = done;
  }
  const double *inelastic = is + of_inelastic * n;
  const int8_t *is_open = s->statuses[1] + n;
  for (int64_t i = 0; i < s->sections; i++)
    if (!(-is[2 * i + 1] <= s->most_pressed) || (s->damping_waits && (inelastic[2 * i] != 0.0 || is_open[i])))
      agreed[0] = 1.0;
  fracflow_after((int32_t)n, s->before, s->found, s->strain[1], agreed + 2);
}

/* Joints push by what their tractions change, and their work counts. */
static void joints_push(steps *s) {
  const int64_t n = s->sections_all;
  const double *was = s->values[0], *is = s->values[1], *agreed = s->agreed;
  const double left = agreed[2] > 0.0 ? agreed[3] / agreed[2] : 0.0;
  s->iterations += agreed[1], s->left = left > s->left ? left : s->left;
  if (!n) return;
  fracflow_pull((int32_t)n, (int32_t)s->pushed_all, s->starts, s->at, s->to, s->entries, s->weights, was, is, s->inverse_pushed,
                s->share, s->of_pushed, s->scratch, s->force, s->added, s->moved, s->sizes);
  fracflow_work((int32_t)s->sections, s->weights, was, s->strain[0], was + of_inelastic * n, was + of_stored * n, s->record[0],
                s->blur[0], is, s->strain[1], is + of_inelastic * n, is + of_stored * n, s->sizes, s->record[1], s->blur[1],
                s->friction, s->of_joints);
  swap(s->strain), swap(s->values), swap(s->record), swap(s->blur);
  int8_t *kept = s->statuses[0];
  s->statuses[0] = s->statuses[1], s->statuses[1] = kept;
}

#define TIMES(row, block, x, y) ((block)[2 * (row)] * (x) + (block)[2 * (row) + 1] * (y))

/* Of a support whose number is h: its force, which has mass m and carries f less the dashpots' r, and their work. */
static void supports(steps *s, int64_t h, double m, double f, double r, double moved) {
  const int64_t old = s->row * s->held + h, new = old + s->held;
  const double *a = s->held_acceleration, *v = s->held_speed, force = m * a[new] - f + r;
  s->boundaries += (0.5 * (s->support[h] + force) - 0.5 * (m * (a[old] + a[new]))) * moved;
  s->boundaries += 0.5 * (v[old] + v[new]) * (m * (v[new] - v[old]));
  s->support[h] = force;
}

/* Nodes with dashpots and supports, whose velocities the sweep has left as they were. */
static void own_nodes_move(steps *s, double kick, double drift, int is_last) {
  const int64_t next = (s->row + 1) * s->held;
  const double *incoming = s->waves ? s->incoming + s->row * s->terms * s->own : 0;
  for (int64_t i = 0; i < s->own; i += 2) {
    const int64_t p[2] = {s->places_own[i], s->places_own[i + 1]}, held[2] = {s->held_of_own[i], s->held_of_own[i + 1]};
    const double x = s->v[p[0]], y = s->v[p[1]], *inverse = s->inverse_own + 2 * i;
    double r[2] = {0.0, 0.0}, a[2], v[2], resist[2] = {0.0, 0.0};
    for (int64_t t = 0; t < s->terms; t++) {
      const double *block = s->dashpots[t] + 2 * i;
      r[0] += TIMES(0, block, x, y), r[1] += TIMES(1, block, x, y);
      if (incoming) r[0] -= incoming[t * s->own + i], r[1] -= incoming[t * s->own + i + 1];
    }
    const double fx = s->f[p[0]] - r[0], fy = s->f[p[1]] - r[1];
    a[0] = TIMES(0, inverse, fx, fy), a[1] = TIMES(1, inverse, fx, fy);
    v[0] = x + 0.5 * s->dt * a[0], v[1] = y + 0.5 * s->dt * a[1];
    for (int c = 0; c < 2; c++)
      if (held[c] >= 0) a[c] = s->held_acceleration[next + held[c]], v[c] = s->held_speed[next + held[c]];
    const double moved[2] = {s->moved[s->at_own[i]], s->moved[s->at_own[i + 1]]};
    for (int64_t t = 0; t < s->terms; t++) {
      const double *block = s->dashpots[t] + 2 * i;
      double *resisting = s->resisting[t] + i;
      double nx = TIMES(0, block, v[0], v[1]), ny = TIMES(1, block, v[0], v[1]);
      if (incoming) nx -= incoming[t * s->own + i], ny -= incoming[t * s->own + i + 1];
      s->of_terms[t] += 0.5 * ((resisting[0] + nx) * moved[0] + (resisting[1] + ny) * moved[1]);
      resisting[0] = nx, resisting[1] = ny, resist[0] += nx, resist[1] += ny;
    }
    for (int c = 0; c < 2; c++) {
      const double before = c ? y : x;
      if (held[c] >= 0) supports(s, held[c], s->mass_own[i + c], s->f[p[c]], resist[c], moved[c]);
      s->v[p[c]] = held[c] < 0 ? before + kick * a[c] : is_last ? v[c] : v[c] + 0.5 * s->dt * a[c];
      s->a_own[i + c] = a[c];
      if (is_last)
        s->a_rock[p[c]] = a[c];
      else
        s->u[p[c]] = s->u_own[i + c] + drift * s->v[p[c]];
    }
  }
  for (int64_t k = 0; k < s->both; k++) s->accelerations[1][s->shared[2 * k]] = s->a_own[s->shared[2 * k + 1]];
}

/* Outer forces at the end of a step, and displacements there. */
static void outer_forces(steps *s) {
  const int64_t beyond = s->first_ghost + s->ghosts - s->forced;
  const double *loads = s->loads + (s->row + 1) * s->loaded;
  fracflow_put((int32_t)s->pushed, 1, s->places_pushed, s->added, s->u);
  fracflow_put((int32_t)s->held, 0, s->places_held, s->held_at + (s->row + 1) * s->held, s->u);
  memcpy(s->forces, s->base, sizeof(double) * (size_t)s->forced);
  for (int64_t i = 0; i < s->loaded; i++) s->forces[s->at_loads[i]] = loads[i] - s->prestress[i];
  memset(s->forces + s->forced, 0, sizeof(double) * (size_t)beyond);
  fracflow_resist((int32_t)s->sections_all, s->starts, s->at, s->entries, s->weights, s->values[0], s->forces);
  if (s->damped && !s->damping_waits) {
    s->of_damping += 0.5 * fracflow_damp((int32_t)s->damped, s->damping_starts, s->damping_columns, s->damping, 1.0 / s->dt,
                                         s->moved, s->damped_forces[0], s->damped_forces[1], s->forces);
    swap(s->damped_forces);
  }
  fracflow_put((int32_t)s->forced, 0, s->places_forced, s->forces, s->e);
  for (int64_t i = 0; i < s->own; i++) s->u_own[i] = s->u[s->places_own[i]];
}

/* Some ranges of the rock, whose strain energy counts. */
static void sweeps(steps *s, int64_t first, int64_t last, double kick, double drift) {
  const int32_t begun = first ? s->top[first - 1] : 0;
  if (first == last) return;
  s->energy += 0.5 * fracflow_sweep((int32_t)(last - first), begun, s->node + first, s->top + first, s->of_three + first,
                                    s->of_four + first, s->oblique + first, s->quiet + first, s->triangles, s->quads,
                                    s->rock_three, s->rock_four, s->moduli, s->x, s->inverse, s->e, kick, drift, s->u, s->v,
                                    s->f);
}

/* Accelerations at the end of a step, the motion of nodes with dashpots and supports, and the work of loads. */
static void ends(steps *s, double kick, double drift, int is_last) {
  const int32_t pushed = (int32_t)s->pushed;
  fracflow_accelerate(pushed, s->places_pushed, s->inverse_pushed, s->f, s->accelerations[1]);
  own_nodes_move(s, kick, drift, is_last);
  const double gain = fracflow_gain(pushed, s->inverse_pushed, s->force, s->accelerations[0], s->accelerations[1]);
  s->scheme += 0.125 * (s->dt * s->dt) * gain;
  swap(s->accelerations);
  const double *was = s->loads + s->row * s->loaded, *is = was + s->loaded;
  double work = 0.0;
  for (int64_t i = 0; i < s->loaded; i++) work += (was[i] + is[i]) * s->moved[s->at_loads[i]];
  s->boundaries += 0.5 * work;
  s->row++;
}

/* The pieces of a step in their order, and their text, by which ``in_a_row.py`` knows what travels before each. */
#define PIECES(...) \
  enum { __VA_ARGS__, COUNT_OF_PIECES }; \
  const char fracflow_pieces[] = #__VA_ARGS__;
PIECES(MOTION, JOINTS, FORCES, FIRST_HALF, LATE_CELLS, SECOND_HALF, END)

/* One of them, of a step that ends at an instant where ``is_last``. */
void fracflow_piece(steps *s, int32_t piece, int32_t is_last) {
  const double kick = is_last ? 0.5 * s->dt : s->dt, drift = is_last ? 0.0 : s->dt;
  const int64_t half = s->ranges / 2, early = 2 * s->early, owned = 2 * s->owned;
  switch (piece) {
    case MOTION: predicts(s); return;
    case JOINTS: joints_balance(s); return;
    case FORCES:
      joints_push(s), outer_forces(s);
      memcpy(s->f + early, s->e + early, sizeof(double) * (size_t)(owned - early));
      memset(s->f + owned, 0, 2 * sizeof(double) * (size_t)(s->whole - s->owned)), s->energy = 0.0;
      return;
    case FIRST_HALF: sweeps(s, 0, half, kick, drift); return;
    case LATE_CELLS:
      s->energy += 0.5 * fracflow_cells((int32_t)s->threes, (int32_t)s->fours, s->triangles_late, s->quads_late,
                                        s->rock_three_late, s->rock_four_late, s->moduli, s->x, s->u, s->f);
      return;
    case SECOND_HALF: sweeps(s, half, s->ranges, kick, drift); return;
    default:
      fracflow_move((int32_t)s->early, (int32_t)s->owned, s->inverse, kick, drift, s->u, s->v, s->f);
      ends(s, kick, drift, is_last);
  }
}

/* Up to ``count`` steps on one rank, and how many there were: one that joints need the laws for is not begun. The last of them
   all ends at an instant where they ``end`` there. */
int64_t fracflow_steps(steps *s, int64_t count, int32_t end) {
  for (int64_t k = 0; k < count; k++) {
    const int is_last = end && k == count - 1;
    for (int32_t piece = 0; piece < COUNT_OF_PIECES; piece++) {
      if (piece == FORCES && s->agreed[0] > 0.0) return k;
      fracflow_piece(s, piece, is_last);
    }
  }
  return count;
}
