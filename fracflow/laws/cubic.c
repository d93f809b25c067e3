/* Conductances of elements between two walls: a copy of ``CubicLaw.conductance`` in ``cubic_flow.py`` by the exact mean cube,
   where (3.4) is at home. It goes operation by operation, so that the bits are the same; ``compiled.py`` calls it. */
#include <math.h>
#include <stdint.h>

/* As NumPy's: one that is no number stays so. */
static inline double most_of(double a, double b) { return a > b || a != a ? a : b; }

/* Whether walls of an element part by more than their aperture at ``rest``: ``FrontCubic`` adds something there. */
static int has_front(const double *opening, double rest) {
  const double first = opening[0] > -rest ? opening[0] : -rest, second = opening[1] > -rest ? opening[1] : -rest;
  return fabs(first - second) - rest > 0.0;
}

/* Of n elements: openings, apertures and least apertures (n, 2), 12 mu L (n,), apertures at rest (n,) or NULL. In ``found``
   follow conductances (n,) and slopes (n, 2). Returns 1 at the first element with a front, where it ends; else 0. */
int32_t fracflow_cubic(int32_t n, const double *opening, const double *aperture, const double *least, const double *resists,
                       const double *rest, double *found) {
  double *slope = found + n;
  for (int32_t i = 0; i < n; i++, opening += 2, aperture += 2, least += 2, slope += 2) {
    if (rest && has_front(opening, rest[i])) return 1;
    double d[2], opens[2];
    for (int end = 0; end < 2; end++) {
      const double mechanical = aperture[end] + opening[end];
      d[end] = most_of(most_of(mechanical, least[end]), 0.0);
      opens[end] = mechanical >= least[end] ? 1.0 : 0.0;
    }
    const double total = d[0] + d[1], divisor = total > 0.0 ? total : 1.0, share_1 = d[0] / divisor, share_2 = d[1] / divisor;
    found[i] = 2.0 * share_1 * d[0] * d[1] * d[1] / resists[i];
    slope[0] = 2.0 * share_1 * share_2 * d[1] * (total + d[1]) / resists[i] * opens[0];
    slope[1] = 2.0 * share_1 * share_2 * d[0] * (total + d[0]) / resists[i] * opens[1];
  }
  return 0;
}
