/* Algebra that every filter in C shares: linear combinations of rows, and the correction of an extended Kalman filter.
 *
 * Covariances are row-major n x n and exactly symmetric. No allocation, no library but libm. STATES, the length of the
 * state, is given when compiling: loops of known length are twice as fast.
 *
 * Nearly all the work is linear combinations of rows, which `combine` holds in registers; sums along a row, which a
 * compiler may not reorder and therefore does one by one, are few, and four at a time in `dot`.
 */
#include <math.h>
#include <string.h>

#define COMPONENTS 16 /* at most, of a measurement */
enum { n = STATES };

/* out += sum of factor[k] * row[k], all rows `width` long; `width` is a constant wherever this is called. */
#ifdef __STRICT_ANSI__ /* C99 and nothing else: every compiler has its own way of holding rows in registers */
static void combine(int width, double *out, int count, const double *factor, const double *const *row) {
    for (int k = 0; k < count; k++)
        for (int j = 0; j < width; j++) out[j] += factor[k] * row[k][j];
}

static double dot(int width, const double *a, const double *b) {
    double sum = 0;
    for (int j = 0; j < width; j++) sum += a[j] * b[j];
    return sum;
}
#else
typedef double lane __attribute__((vector_size(32)));
#define LANES 14 /* with two more registers for operands, what a processor with 16 of them can hold */

static inline __attribute__((always_inline)) lane loaded(const double *from) {
    lane result;
    memcpy(&result, from, sizeof result);
    return result;
}

static inline __attribute__((always_inline)) void combine(int width, double *out, int count, const double *factor,
                                                          const double *const *row) {
    int first = 0;
    for (; width - first >= 4; first += 4 * LANES) {
        const int lanes = (width - first) / 4 < LANES ? (width - first) / 4 : LANES;
        lane sum[LANES];
#pragma GCC unroll 16
        for (int j = 0; j < lanes; j++) sum[j] = loaded(out + first + 4 * j);
        for (int k = 0; k < count; k++) {
            const lane f = {factor[k], factor[k], factor[k], factor[k]};
#pragma GCC unroll 16
            for (int j = 0; j < lanes; j++) sum[j] += f * loaded(row[k] + first + 4 * j);
        }
#pragma GCC unroll 16
        for (int j = 0; j < lanes; j++) memcpy(out + first + 4 * j, &sum[j], sizeof(lane));
    }
    for (int k = 0; k < count; k++)
        for (int j = width / 4 * 4; j < width; j++) out[j] += factor[k] * row[k][j];
}

static inline __attribute__((always_inline)) double dot(int width, const double *a, const double *b) {
    lane sums = {0, 0, 0, 0};
    double rest = 0;
    for (int j = 0; j < width / 4 * 4; j += 4) sums += loaded(a + j) * loaded(b + j);
    for (int j = width / 4 * 4; j < width; j++) rest += a[j] * b[j];
    return sums[0] + sums[1] + (sums[2] + sums[3]) + rest;
}
#endif

/* A measurement in the filter's terms: of the `used` components that are there, their Jacobians by the errors of the
 * state, innovations and variances; and after `update` L^-1 innovation and the Cholesky factor L of their covariance. */
struct innovation {
    int used;
    double rows[COMPONENTS][STATES], residual[COMPONENTS], variance[COMPONENTS];
    double weights[COMPONENTS], factor[COMPONENTS][COMPONENTS];
};

/* Corrects the covariance, P - W W' with W = P H' L^-T, and writes the error of the state (n).
 *
 * Returns the squared norm of the innovation in units of its standard deviation; the correction is made only where that
 * is at most `limit`. NaN: the covariance of the innovation is not positive definite. `scale` multiplies it. */
static double update(struct innovation *found, double *p, double *error, double scale, double limit) {
    double projected[COMPONENTS][STATES], factors[STATES], (*const total)[COMPONENTS] = found->factor;
    double *const weights = found->weights, nis = 0;
    const double *from[STATES];
    const int used = found->used;
    for (int a = 0; a < used; a++) {
        int count = 0;
        for (int k = 0; k < n; k++)
            if (found->rows[a][k] != 0) {
                factors[count] = found->rows[a][k];
                from[count++] = p + k * n;
            }
        memset(projected[a], 0, sizeof projected[a]);
        combine(n, projected[a], count, factors, from);
        for (int b = 0; b <= a; b++) total[a][b] = total[b][a] = dot(n, projected[a], found->rows[b]);
    }
    for (int a = 0; a < used; a++) {
        total[a][a] += found->variance[a];
        for (int b = 0; b < used; b++) total[a][b] *= scale;
    }
    /* Whitening by the Cholesky factor: with L L' = total, projected := L^-1 H P and weights := L^-1 innovation. */
    for (int a = 0; a < used; a++) {
        for (int b = 0; b < a; b++) {
            double sum = total[a][b];
            for (int k = 0; k < b; k++) sum -= total[a][k] * total[b][k];
            total[a][b] = sum / total[b][b];
        }
        double sum = total[a][a];
        for (int k = 0; k < a; k++) sum -= total[a][k] * total[a][k];
        if (!(sum > 0)) return NAN;
        total[a][a] = sqrt(sum);
        double w = found->residual[a];
        for (int k = 0; k < a; k++) w -= total[a][k] * weights[k];
        weights[a] = w / total[a][a];
        nis += weights[a] * weights[a];
    }
    if (!(nis <= limit)) return nis;
    for (int a = 0; a < used; a++) {
        for (int k = 0; k < a; k++) factors[k] = -total[a][k];
        from[a] = projected[a];
        combine(n, projected[a], a, factors, from);
        const double f = 1 / total[a][a];
        for (int j = 0; j < n; j++) projected[a][j] *= f;
    }
    memset(error, 0, n * sizeof *error);
    combine(n, error, used, weights, from);
    for (int i = 0; i < n; i++) {
        for (int a = 0; a < used; a++) factors[a] = -projected[a][i];
        combine(n, p + i * n, used, factors, from);
    }
    return nis;
}
