/* Covariance algebra of the multibody car: the compiled twin of kalman.py, which says what each function does, on top of
 * ../estimation/algebra.c.
 *
 * Jacobians come column-major from the model's functions. MODEL is the number of coordinates; the state begins with
 * coordinates, velocities, accelerations (MODEL each) and SURROUND surroundings, then come biases.
 */
#define MODEL 14
#define DYNAMIC 7
#define SURROUND 4
#define GAIN (DYNAMIC + MODEL + MODEL + SURROUND)

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
static void tell(const struct model *model, int components, const int *component, const struct innovation *found) {
    for (int i = 0; i < components; i++) model->whitened[i] = NAN;
    for (int i = 0; i < components * components; i++) model->factor[i] = i % (components + 1) == 0;
    for (int a = 0; a < found->used; a++) {
        model->whitened[component[a]] = found->weights[a];
        for (int b = 0; b <= a; b++) model->factor[component[a] * components + component[b]] = found->factor[a][b];
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
    struct innovation found;
    int component[COMPONENTS];
    found.used = 0;
    for (int i = 0; i < sensed->components; i++)
        if (isfinite(sensed->value[i]) && isfinite(sensed->expected[i])) component[found.used++] = i;
    if (found.used == 0) return -1;
    for (int a = 0; a < found.used; a++) {
        sensed_row(model, sensed, component[a], found.rows[a]);
        found.residual[a] = sensed->value[component[a]] - sensed->expected[component[a]];
        found.variance[a] = sensed->variance[component[a]];
    }
    const double nis = update(&found, model->covariance, model->error, scale, limit);
    if (model->whitened && !isnan(nis)) tell(model, sensed->components, component, &found);
    if (nis <= limit) carry_on(model);
    return nis;
}
