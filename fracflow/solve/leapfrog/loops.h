/* Loops of rock.c, nodes.c and joints.c that steps.c calls. */
#include <stdint.h>

double fracflow_sweep(int32_t ranges, int32_t begun, const int32_t *node, const int32_t *top, const int32_t *of_three,
                      const int32_t *of_four, const int32_t *oblique, const uint8_t *quiet, const int32_t *triangles,
                      const int32_t *quads, const uint16_t *rock_three, const uint16_t *rock_four, const double *moduli,
                      const double *x, const double *inverse, const double *e, double kick, double drift, double *u, double *v,
                      double *f);
double fracflow_cells(int32_t threes, int32_t fours, const int32_t *triangles, const int32_t *quads, const uint16_t *rock_three,
                      const uint16_t *rock_four, const double *moduli, const double *x, const double *u, double *f);
void fracflow_move(int32_t first, int32_t last, const double *inverse, double kick, double drift, double *u, double *v,
                   const double *f);
void fracflow_predict(int32_t n, const int64_t *place, const double *v, double dt, double *moved);
void fracflow_jumps(int32_t n, const int32_t *starts, const int32_t *at, const double *entries, const double *moved,
                    double *found);
void fracflow_pull(int32_t n, int32_t p, const int32_t *starts, const int32_t *at, const int32_t *to, const double *entries,
                   const double *weights, const double *before, const double *after, const double *inverse, double share,
                   const int32_t *of_pushed, double *force, double *pushed, double *added, double *moved, double *sizes);
void fracflow_resist(int32_t n, const int32_t *starts, const int32_t *at, const double *entries, const double *weights,
                     const double *traction, double *force);
void fracflow_put(int32_t n, int32_t adds, const int64_t *place, const double *values, double *there);
void fracflow_accelerate(int32_t n, const int64_t *place, const double *inverse, const double *f, double *a);
double fracflow_gain(int32_t n, const double *inverse, const double *force, const double *before, const double *after);
double fracflow_damp(int32_t n, const int32_t *starts, const int32_t *columns, const double *blocks, double by,
                     const double *moved, const double *before, double *y, double *force);
void fracflow_before(int32_t n, const double *free, const double *strain, const double *traction, const double *tangent,
                     const double *plastic, const double *sliding, const double *path, double *before);
int32_t fracflow_after(int32_t n, const double *before, const double *found, double *strain, double *largest);
int32_t fracflow_joints(int32_t clusters, int32_t members, const int64_t *rows, const double *compliance, double share,
                        const double *laws, const double *before, int32_t most, int32_t most_changes, double *found,
                        int32_t count, int32_t is_coupled, double *answers, int8_t *statuses);
void fracflow_work(int32_t n, const double *weight, const double *t0, const double *e0, const double *p0, const double *s0,
                   const double *r0, const double *b0, const double *t, const double *e, const double *p, const double *s,
                   const double *moved, double *record, double *blur, double *friction, double *sums);
