/* Covariance algebra of the errorEKF: the compiled twin of kalman.py, which says what each function does.
 *
 * Covariances are row-major n x n and exactly symmetric. Jacobians come column-major from the model's functions.
 * No allocation, no library but libm. MODEL is the number of coordinates; the state begins with
 * coordinates, velocities, accelerations (MODEL each) and SURROUND surroundings, then come biases.
 *
 * Nearly all the work is linear combinations of rows, which `combine` holds in registers; sums along a row, which a
 * compiler may not reorder and therefore does one by one, are few, and four at a time in `dot`.
 */
#include <math.h>
#include <string.h>

#define MODEL 14
#define DYNAMIC 7
#define SURROUND 4
#define GAIN (DYNAMIC + MODEL + MODEL + SURROUND)
#define COMPONENTS 16 /* at most, of a measurement */
enum { n = STATES }; /* the length of the state, given when compiling: loops of known length are twice as fast */

/* What the functions share; all arrays stay where they are. */
struct model {
    const double *by_q, *by_u, *by_surroundings, *by_q_rates; /* 14 x 7, 14, 4, 14 */
    const double *by_angles, *by_velocity;                    /* 6 x 3, 6 x 6 */
    double *inverse;                                          /* 14 x 14, column-major */
    double *gain;                                             /* 14 x GAIN, row-major */
    double *covariance, *error;
    double *udot; /* 14 */
    double *whitened, *factor; /* COMPONENTS, COMPONENTS x COMPONENTS, or null: see kalman.py */
};

/* A measurement of `components` and what was expected of it. */
struct sensed {
    int components, uses_acceleration, first_bias, biases;
    const double *value, *variance;
    const double *expected, *by_q, *by_u, *by_udot, *by_surroundings;
};

static const int dynamic_coordinates[DYNAMIC] = {2, 3, 4, 6, 7, 8, 9};

static void gain_columns(int *columns) {
    int k = 0;
    for (int i = 0; i < DYNAMIC; i++) columns[k++] = dynamic_coordinates[i];
    for (int i = MODEL; i < 3 * MODEL + SURROUND; i++) columns[k++] = i;
}

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

/* Inverse by Gauss-Jordan elimination with partial pivoting; `rows` (MODEL x 2 MODEL) holds the matrix, and beside it
 * at first the unit matrix, at last the inverse. Returns 0 if singular. */
static int invert(double (*rows)[2 * MODEL]) {
    for (int k = 0; k < MODEL; k++) {
        int best = k;
        for (int i = k + 1; i < MODEL; i++)
            if (fabs(rows[i][k]) > fabs(rows[best][k])) best = i;
        if (!(fabs(rows[best][k]) > 1e-300)) return 0;
        if (best != k) {
            double row[2 * MODEL];
            memcpy(row, rows[k], sizeof row);
            memcpy(rows[k], rows[best], sizeof row);
            memcpy(rows[best], row, sizeof row);
        }
        const double scale = 1 / rows[k][k];
        for (int j = 0; j < 2 * MODEL; j++) rows[k][j] *= scale;
        const double *const row = rows[k];
        for (int i = 0; i < MODEL; i++) {
            const double f = -rows[i][k];
            if (i != k && f != 0) combine(2 * MODEL, rows[i], 1, &f, &row);
        }
    }
    return 1;
}

int vsense_transition(const struct model *model, double h, double gamma) {
    enum { width = 40 }; /* GAIN, rounded up */
    double rows[MODEL][2 * MODEL], w[MODEL], response[MODEL][MODEL + 2], right[MODEL][width];
    const double *right_rows[MODEL], *inverse_rows[MODEL];
    /* What the response is multiplied with: by_q, slope, nothing, by_surroundings, in the order of the gain. */
    memset(right, 0, sizeof right);
    for (int i = 0; i < MODEL; i++) {
        for (int j = 0; j < DYNAMIC; j++) right[i][j] = model->by_q[j * MODEL + i];
        for (int j = 0; j < SURROUND; j++) right[i][DYNAMIC + 2 * MODEL + j] = model->by_surroundings[j * MODEL + i];
        for (int j = 0; j < MODEL; j++) {
            const double s = model->by_u[j * MODEL + i] + gamma * h * model->by_q_rates[j * MODEL + i];
            right[i][DYNAMIC + j] = s;
            rows[i][j] = (i == j) - gamma * h * s;
            rows[i][MODEL + j] = i == j;
        }
        right_rows[i] = right[i];
        inverse_rows[i] = rows[i] + MODEL;
    }
    if (!invert(rows)) return 0;
    for (int i = 0; i < MODEL; i++) {
        for (int j = 0; j < MODEL; j++) {
            model->inverse[j * MODEL + i] = rows[i][MODEL + j];
            w[j] = h * (0.5 - gamma) / gamma * (rows[i][MODEL + j] - (i == j));
            response[i][j] = h * rows[i][MODEL + j];
        }
        combine(MODEL, response[i], MODEL, w, inverse_rows);
    }
    for (int i = 0; i < MODEL; i++) {
        double row[width] = {0};
        combine(width, row, MODEL, response[i], right_rows);
        row[DYNAMIC + i] += 1;
        memcpy(row + DYNAMIC + MODEL, response[i], MODEL * sizeof *row);
        memcpy(model->gain + i * GAIN, row, GAIN * sizeof *row);
    }
    return 1;
}

/* corner (MODEL x MODEL) += left * right', where the columns of right' stand in `transposed`; then made symmetric. */
static void symmetric_corner(int count, double (*left)[GAIN], double (*transposed)[16], double (*corner)[16]) {
    const double *rows[GAIN];
    for (int k = 0; k < count; k++) rows[k] = transposed[k];
    for (int i = 0; i < MODEL; i++) combine(16, corner[i], count, left[i], rows);
    for (int i = 0; i < MODEL; i++)
        for (int j = 0; j < i; j++) corner[i][j] = corner[j][i] = 0.5 * (corner[i][j] + corner[j][i]);
}

void vsense_propagate(const struct model *model, double h, const double *decay, const double *noise) {
    enum { first_slow = 2 * MODEL, followed = 9 };
    double *p = model->covariance, rows[MODEL][STATES], left[MODEL][GAIN], corner[MODEL][16] = {{0}};
    double transposed[GAIN][16] = {{0}}, map[MODEL][GAIN] = {{0}};
    const double *from[GAIN];
    int columns[GAIN];
    gain_columns(columns);
    /* velocities */
    for (int k = 0; k < GAIN; k++) from[k] = p + columns[k] * n;
    memset(rows, 0, sizeof rows);
    for (int i = 0; i < MODEL; i++) {
        combine(n, rows[i], GAIN, model->gain + i * GAIN, from);
        for (int k = 0; k < GAIN; k++) {
            left[i][k] = rows[i][columns[k]];
            transposed[k][i] = model->gain[i * GAIN + k];
        }
    }
    symmetric_corner(GAIN, left, transposed, corner);
    for (int i = 0; i < MODEL; i++) {
        memcpy(rows[i] + MODEL, corner[i], MODEL * sizeof(double));
        memcpy(p + (MODEL + i) * n, rows[i], n * sizeof(double));
    }
    for (int j = 0; j < MODEL; j++)
        for (int i = 0; i < MODEL; i++) p[j * n + MODEL + i] = rows[i][j];
    /* Coordinates: position and attitude follow attitude and velocity of the chassis, each of the others its rate. */
    for (int k = 0; k < followed; k++) columns[k] = k < 3 ? 3 + k : MODEL + k - 3;
    for (int k = followed; k < followed + MODEL - 6; k++) columns[k] = MODEL + 6 + k - followed;
    for (int i = 0; i < MODEL; i++) {
        for (int k = 0; k < followed && i < 6; k++)
            map[i][k] = h * (k < 3 ? model->by_angles[k * 6 + i] : model->by_velocity[(k - 3) * 6 + i]);
        if (i >= 6) map[i][followed + i - 6] = h;
    }
    for (int k = 0; k < followed + MODEL - 6; k++) {
        from[k] = p + columns[k] * n;
        for (int i = 0; i < MODEL; i++) transposed[k][i] = map[i][k];
    }
    for (int i = 0; i < MODEL; i++) {
        memcpy(rows[i], p + i * n, sizeof rows[i]);
        if (i < 6)
            combine(n, rows[i], followed, map[i], from);
        else
            combine(n, rows[i], 1, map[i] + followed + i - 6, from + followed + i - 6);
        for (int k = 0; k < followed + MODEL - 6; k++) left[i][k] = rows[i][columns[k]];
        memcpy(corner[i], rows[i], MODEL * sizeof(double));
    }
    symmetric_corner(followed + MODEL - 6, left, transposed, corner);
    for (int i = 0; i < MODEL; i++) {
        memcpy(rows[i], corner[i], MODEL * sizeof(double));
        memcpy(p + i * n, rows[i], n * sizeof(double));
        for (int j = MODEL; j < first_slow; j++) p[j * n + i] = rows[i][j];
    }
    /* forces, surroundings, biases */
    for (int i = 0; i < first_slow; i++)
        for (int j = first_slow; j < n; j++) p[i * n + j] *= decay[j - first_slow];
    for (int i = first_slow; i < n; i++) {
        double *row = p + i * n;
        const double own = decay[i - first_slow];
        for (int j = 0; j < first_slow; j++) row[j] = p[j * n + i];
        for (int j = first_slow; j < n; j++) row[j] *= own * decay[j - first_slow];
        row[i] += noise[i - first_slow];
    }
}

/* One row of the measurement's Jacobian by the whole state. */
static void sensed_row(const struct model *model, const struct sensed *sensed, int i, double *row) {
    const int m = sensed->components;
    memset(row, 0, n * sizeof *row);
    for (int j = 0; j < MODEL; j++) {
        row[j] = sensed->by_q[j * m + i];
        row[MODEL + j] = sensed->by_u[j * m + i];
    }
    for (int j = 0; j < SURROUND; j++) row[3 * MODEL + j] = sensed->by_surroundings[j * m + i];
    if (sensed->uses_acceleration)
        for (int k = 0; k < MODEL; k++) {
            const double f = sensed->by_udot[k * m + i];
            if (f == 0) continue;
            for (int j = 0; j < DYNAMIC; j++) row[dynamic_coordinates[j]] += f * model->by_q[j * MODEL + k];
            for (int j = 0; j < MODEL; j++) row[MODEL + j] += f * model->by_u[j * MODEL + k];
            row[2 * MODEL + k] = f;
            for (int j = 0; j < SURROUND; j++) row[3 * MODEL + j] += f * model->by_surroundings[j * MODEL + k];
        }
    if (sensed->biases) row[sensed->first_bias + i] = 1;
}

/* Keeps the whitened innovation and the factor of its covariance. */
static void tell(const struct model *model, int components, int used, const int *component, const double *weights,
                 double (*factor)[COMPONENTS]) {
    for (int i = 0; i < components; i++) model->whitened[i] = NAN;
    for (int i = 0; i < components * components; i++) model->factor[i] = i % (components + 1) == 0;
    for (int a = 0; a < used; a++) {
        model->whitened[component[a]] = weights[a];
        for (int b = 0; b <= a; b++) model->factor[component[a] * components + component[b]] = factor[a][b];
    }
}

/* Adds what the error makes of the accelerations, with which the sensor that comes next is compared. */
static void carry_on(const struct model *model) {
    const double *const error = model->error, *column[DYNAMIC + MODEL + SURROUND];
    double factor[DYNAMIC + MODEL + SURROUND];
    int count = 0;
    for (int j = 0; j < DYNAMIC; j++) {
        column[count] = model->by_q + j * MODEL;
        factor[count++] = error[dynamic_coordinates[j]];
    }
    for (int j = 0; j < MODEL; j++) {
        column[count] = model->by_u + j * MODEL;
        factor[count++] = error[MODEL + j];
    }
    for (int j = 0; j < SURROUND; j++) {
        column[count] = model->by_surroundings + j * MODEL;
        factor[count++] = error[3 * MODEL + j];
    }
    for (int i = 0; i < MODEL; i++) model->udot[i] += error[2 * MODEL + i];
    combine(MODEL, model->udot, count, factor, column);
}

/* Returns the squared norm of the innovation in units of its standard deviation, negative if nothing was measured;
 * the correction is made, and carried into error and accelerations, only where that is at most limit. */
double vsense_correct(const struct model *model, const struct sensed *sensed, double scale, double limit) {
    double rows[COMPONENTS][STATES], projected[COMPONENTS][STATES], total[COMPONENTS][COMPONENTS];
    double innovation[COMPONENTS], weights[COMPONENTS], factors[STATES], *p = model->covariance;
    const double *from[STATES];
    int used = 0, component[COMPONENTS];
    for (int i = 0; i < sensed->components; i++)
        if (isfinite(sensed->value[i]) && isfinite(sensed->expected[i])) component[used++] = i;
    if (used == 0) return -1;
    for (int a = 0; a < used; a++) {
        int count = 0;
        sensed_row(model, sensed, component[a], rows[a]);
        innovation[a] = sensed->value[component[a]] - sensed->expected[component[a]];
        for (int k = 0; k < n; k++)
            if (rows[a][k] != 0) {
                factors[count] = rows[a][k];
                from[count++] = p + k * n;
            }
        memset(projected[a], 0, sizeof projected[a]);
        combine(n, projected[a], count, factors, from);
        for (int b = 0; b <= a; b++) total[a][b] = total[b][a] = dot(n, projected[a], rows[b]);
    }
    for (int a = 0; a < used; a++) {
        total[a][a] += sensed->variance[component[a]];
        for (int b = 0; b < used; b++) total[a][b] *= scale;
    }
    /* Whitening by the Cholesky factor: with L L' = total, projected := L^-1 H P and weights := L^-1 innovation. */
    double nis = 0;
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
        double w = innovation[a];
        for (int k = 0; k < a; k++) w -= total[a][k] * weights[k];
        weights[a] = w / total[a][a];
        nis += weights[a] * weights[a];
    }
    if (model->whitened) tell(model, sensed->components, used, component, weights, total);
    if (!(nis <= limit)) return nis;
    for (int a = 0; a < used; a++) {
        for (int k = 0; k < a; k++) factors[k] = -total[a][k];
        from[a] = projected[a];
        combine(n, projected[a], a, factors, from);
        const double f = 1 / total[a][a];
        for (int j = 0; j < n; j++) projected[a][j] *= f;
    }
    memset(model->error, 0, n * sizeof(double));
    combine(n, model->error, used, weights, from);
    for (int i = 0; i < n; i++) {
        for (int a = 0; a < used; a++) factors[a] = -projected[a][i];
        combine(n, p + i * n, used, factors, from);
    }
    carry_on(model);
    return nis;
}
