/* The response of all sections of a law at once; ``compiled.py`` calls it. */
#include "response.h"

const int fracflow_laws_version = 2;
#define TEXT_OF(name, columns) #name " " #columns ";"
const char fracflow_answer[] = PARTS_OF_ANSWER(TEXT_OF);

/* ``answer`` of sections (n,): their laws (n, LAW), strains (n, 2), and their histories; the path of slip may be NULL. */
void fracflow_friction(int32_t n, int32_t is_held, int32_t is_coupled, const double *laws, const double *strains,
                       const double *plastic, const double *sliding, const double *path, double *found, int8_t *statuses) {
  for (int64_t i = 0; i < n; i++) {
    const double *law = laws + LAW * i, *strain = strains + 2 * i;
    const past before = {plastic[i], sliding[i], path ? path[i] : 0.0};
    friction at;
    rub(law, &before, strain, is_held, &at);
    answer(law, &before, &at, strain, is_coupled, path != 0, i, n, found, statuses);
  }
}
