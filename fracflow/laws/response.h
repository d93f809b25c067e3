/* What a law answers for one section, ``friction.Trial.response``, once ``friction.h`` has tried a strain. */
#ifndef FRACFLOW_RESPONSE
#define FRACFLOW_RESPONSE
#include "friction.h"
#include <stdint.h>

/* Parts of an answer and their columns, one part after the other, each of all sections; ``compiled.py`` reads its text. */
#define PARTS_OF_ANSWER(PART) \
  PART(traction, 2) PART(tangent, 4) PART(inelastic, 2) PART(stored, 1) PART(strength, 1) PART(utilisation, 1) PART(margin, 1) \
  PART(plastic_slip, 1) PART(sliding, 1) PART(slip_path, 1)
#define COLUMNS_OF(name, columns) of_##name, last_of_##name = of_##name + columns - 1,
enum { PARTS_OF_ANSWER(COLUMNS_OF) COLUMNS_OF_ANSWER };

#define TINY_STRENGTH 1e-9 /* ``friction.TINY_STRENGTH`` */

/* ``closure._minus_log`` */
static inline double minus_log(double x) {
  const double series = x * x * (0.5 - x * (1.0 / 3.0 - x * (0.25 - x * (0.2 - x / 6.0))));
  return fabs(x) < 1e-3 ? series : x - log1p(x > -1.0 ? x : 0.0);
}

/* Energy of ``NormalClosure.evaluate``. */
static inline double energy_of(const double *law, double opening) {
  const double eps = least_of(opening, edge_of(law));
  const double hyperbola = law[GAP] * law[GAP] * minus_log(least_of(eps, 0.0) / law[GAP]);
  return law[F_N] * eps + law[K_N] * (opening < 0.0 ? hyperbola : 0.5 * (eps * eps));
}

/* ``Trial.margin`` */
static inline double margin_of(const double *law, const past *before, const friction *at, double opening) {
  if (at->is_free) return law[F_N] < 0.0 ? fabs(law[F_N] + law[K_N] * opening) / -law[F_N] : INFINITY;
  if (!isfinite(at->onset) || (!(at->size > 0.0) && !(at->onset > 0.0))) return INFINITY;
  const double excess = before->sliding != 0.0 ? at->along - at->kept : at->size - at->onset;
  return fabs(excess) / most_of(at->onset, TINY_STRENGTH * most_of(fabs(law[F_N]), law[K_N] * law[GAP]));
}

/* ``friction._quotient`` */
static inline double used(double size, double strength) {
  if (strength > 0.0) return size / strength;
  return size > 0.0 ? INFINITY : 0.0;
}

/* Of section i of n, into ``found``; in ``statuses`` whether they slide, and whether they are open.
   Products with 0 are made as the laws make them: where a traction overflows they have no number, and the trial is refused. */
static inline void answer(const double *law, const past *before, const friction *at, const double *strain, int is_coupled,
                          int has_path, int64_t i, int64_t n, double *found, int8_t *statuses) {
  double *traction = found + of_traction * n, *tangent = found + of_tangent * n, *inelastic = found + of_inelastic * n;
  double *stored = found + of_stored * n, *strength = found + of_strength * n, *utilisation = found + of_utilisation * n;
  double *margin = found + of_margin * n, *new_plastic = found + of_plastic_slip * n, *new_sliding = found + of_sliding * n;
  double *new_path = found + of_slip_path * n, k_s = law[K_S];
  const double held = at->slides ? at->carried : 0.0, divisor = at->size > 0.0 ? at->size : 1.0;
  const double f_s = at->slides ? held * at->way : at->is_free ? 0.0 : at->shear;
  const double outer = at->slides * at->way * at->way, ratio = (at->slides ? held / divisor : at->is_free ? 0.0 : 1.0) * k_s;
  const double slope = at->slides && at->f_n < 0.0 && !at->is_crushed ? at->by_normal : 0.0;
  traction[2 * i] = f_s, traction[2 * i + 1] = at->f_n;
  tangent[4 * i] = ratio * (1.0 - outer) + at->by_size * k_s * outer;
  tangent[4 * i + 1] = is_coupled ? slope * (at->is_crushed ? 0.0 : at->k_n) * at->way : 0.0;
  tangent[4 * i + 2] = 0.0, tangent[4 * i + 3] = at->k_n;
  new_plastic[i] = at->is_crushed ? before->plastic : before->plastic + (at->shear - f_s) / k_s;
  new_sliding[i] = at->is_crushed ? before->sliding : at->slides * at->way;
  inelastic[2 * i] = new_plastic[i], inelastic[2 * i + 1] = 0.0;
  stored[i] = (at->k_n == INFINITY ? INFINITY : energy_of(law, strain[1])) + (f_s * f_s - law[F_S] * law[F_S]) / (2.0 * k_s);
  const int slips = has_path && at->slides && !at->is_crushed && at->slip > 0.0;
  strength[i] = slips ? at->carried : at->onset;
  utilisation[i] = at->slides ? 1.0 : used(sqrt(f_s * f_s), strength[i]);
  margin[i] = margin_of(law, before, at, strain[1]);
  if (has_path) new_path[i] = before->path + (slips ? at->slip : 0.0);
  statuses[i] = (int8_t)at->slides, statuses[n + i] = (int8_t)at->is_open;
}
#endif
