/* Closure and friction of one section in the plane: a copy of ``closure.NormalClosure``, ``friction.Trial``,
   ``hyperbolic_coulomb.py`` and ``slip_weakening.py``, where the equations are at home. It goes operation by operation, so that
   tractions, tangents and statuses have the same bits; ``tests/laws/test_compiled.py`` holds one against the other. */
#ifndef FRACFLOW_FRICTION
#define FRACFLOW_FRICTION
#include <math.h>

#define ONSET_ROUND_OFF 1e-12 /* ``friction.ONSET_ROUND_OFF`` */

/* columns of a section's law: ``compiled.PARAMETERS`` behind the first two */
enum { KIND, WEIGHT, K_N, K_S, GAP, F_N, F_S, COHESION, PEAK, DYNAMIC, DISTANCE, RATIO, OPEN_STRENGTH, LAW };
enum { LINEAR, COULOMB, WEAKENING };

/* Plastic slip, direction of sliding, 0 while it sticks, and path of slip before. */
typedef struct {
  double plastic, sliding, path;
} past;

/* ``friction.Trial`` at a strain, the choice of its status, and what it carries as it slides on by ``slip`` along ``way``. */
typedef struct {
  int is_crushed, is_open, is_free, slides;
  double f_n, k_n, shear, size, along, onset, kept, carried, by_size, by_normal, way, slip;
} friction;

/* As NumPy's: one that is no number stays so. */
static inline double least_of(double a, double b) { return a < b || a != a ? a : b; }
static inline double most_of(double a, double b) { return a > b || a != a ? a : b; }

/* Opening at which the normal traction vanishes. */
static inline double edge_of(const double *law) { return -law[F_N] / law[K_N]; }

static inline double friction_at(const double *law, double path) {
  return path < law[DISTANCE] ? law[PEAK] - (law[PEAK] - law[DYNAMIC]) / law[DISTANCE] * path : law[DYNAMIC];
}

/* ``SlipWeakening.evaluate`` past the choice of status; ``f_n`` is 0 where crushed. */
static inline void weaken(const double *law, const past *before, double f_n, int is_held, int is_back, friction *at) {
  const double falls = before->path < law[DISTANCE] ? (law[PEAK] - law[DYNAMIC]) / law[DISTANCE] : 0.0;
  const double excess = is_back ? 0.0 : most_of(at->size - at->onset, 0.0), stiff = law[K_S] + f_n * falls;
  const double free_slip = stiff > 0.0 ? excess / stiff : INFINITY;
  const int crosses = falls > 0.0 && before->path + (excess > 0.0 ? free_slip : 0.0) >= law[DISTANCE];
  const double lower = law[COHESION] - f_n * law[DYNAMIC];
  at->slip = excess > 0.0 ? (crosses ? (at->size - lower) / law[K_S] : free_slip) : 0.0;
  const int softens = at->slides && falls > 0.0 && !crosses && at->slip > 0.0;
  const double share = softens ? law[K_S] / stiff : 1.0, now = friction_at(law, before->path + at->slip);
  at->carried = at->slip > 0.0 ? law[COHESION] - f_n * now : is_held ? at->onset : least_of(at->onset, at->size);
  at->by_size = 1.0 - share, at->by_normal = -now * share;
}

/* A section at a strain; held, it keeps its status. */
static inline void rub(const double *law, const past *before, const double *strain, int is_held, friction *at) {
  const double k_s = law[K_S], edge = edge_of(law), opening = strain[1];
  const int slid = before->sliding != 0.0, weakens = law[KIND] == WEAKENING;
  const int is_shut = opening <= -law[GAP];
  at->is_open = opening > edge;
  at->is_free = at->is_open && !(law[OPEN_STRENGTH] > 0.0);
  const double eps = is_shut ? 0.0 : least_of(opening, edge), squeeze = 1.0 + least_of(eps, 0.0) / law[GAP];
  at->f_n = is_shut ? -INFINITY : at->is_open ? 0.0 : least_of(law[F_N] + law[K_N] * eps / squeeze, 0.0);
  at->k_n = is_shut ? INFINITY : at->is_open ? 0.0 : law[K_N] / (squeeze * squeeze);
  at->is_crushed = !isfinite(at->f_n);
  const double f_n = at->is_crushed ? 0.0 : at->f_n;
  at->shear = law[F_S] + k_s * (strain[0] - before->plastic);
  at->size = sqrt(at->shear * at->shear), at->along = at->shear * before->sliding;
  const double mu = weakens ? friction_at(law, before->path) : law[PEAK];
  at->onset = at->is_free ? 0.0 : law[COHESION] - f_n * mu, at->kept = law[RATIO] * at->onset;
  at->slides = slid;
  if (!is_held) {
    const double slack = ONSET_ROUND_OFF * ((isfinite(at->onset) ? at->onset : 0.0) + k_s * fabs(strain[0]));
    if (slid)
      at->slides = at->is_crushed || at->along >= at->kept - slack;
    else
      at->slides = at->size >= at->onset - slack && at->size > 0.0 && !at->is_crushed;
  }
  at->slides = at->slides && !at->is_free;
  const int is_back = slid && at->along <= 0.0;
  at->way = at->size > 0.0 && !is_back ? at->shear / at->size : before->sliding;
  at->slip = 0.0, at->by_size = 0.0, at->by_normal = -law[RATIO] * law[PEAK];
  at->carried = is_held ? at->kept : least_of(at->kept, at->size);
  if (weakens) weaken(law, before, f_n, is_held, is_back, at);
}
#endif
