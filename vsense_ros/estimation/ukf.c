/* Operations of an unscented Kalman filter of a state space whose state is a vector, on top of algebra.c: ukf.py says
 * what each does, and does it for states that are not. */

enum { points = 2 * n + 1 };

/* A filter in Python's hands. */
struct live {
    struct kernel move, noise; /* of the state in `point` */
    long long size;            /* of memory */
    double *memory, *mean, *covariance, *inputs, *h, *point, *whitened, *factor;
    const double *moved, *q, *largest; /* results: state (n), noise (n x n); amounts beyond which no state is */
    double reach, weights[2], squares[2]; /* of the points: how far out; weights of the one in the middle, the others */
};

struct sensor {
    struct kernel expect;
    long long components;
    const double *expected, *used, *angles; /* results of `expect`; not zero for components that are angles */
};

/* U (n x n, row-major, zero below the diagonal) with U' U = P, rows of directions without variance zero. Returns 0 if
 * there is none. */
static int root_of(const double *p, double (*u)[STATES]) {
    const double *rows[STATES];
    double factors[STATES];
    for (int j = 0; j < n; j++) {
        for (int k = 0; k < j; k++) factors[k] = -u[k][j];
        rows[j] = u[j];
        (void)memcpy(u[j], p + j * n, n * sizeof(double));
        combine(n, u[j], j, factors, rows);
        const double pivot = u[j][j], variance = p[j * n + j];
        (void)memset(u[j], 0, j * sizeof(double));
        if (!isfinite(pivot)) return 0;
        if (pivot > 1e-14 * variance && variance > 0) {
            const double inverse = 1 / sqrt(pivot);
            for (int i = j; i < n; i++) u[j][i] *= inverse;
            continue;
        }
        if (pivot < -1e-9 * fabs(variance)) return 0;
        for (int i = j + 1; i < n; i++)
            if (fabs(u[j][i]) > 1e-6 * sqrt(fabs(variance * p[i * n + i]))) return 0;
        (void)memset(u[j], 0, n * sizeof(double));
    }
    return 1;
}

/* Puts the point of this index where the functions look for it: the mean, then plus, then minus the rows of `root`. */
static void place(const struct live *live, int index, const double (*root)[STATES]) {
    const double *const mean = live->mean;
    if (index == 0) {
        (void)memcpy(live->point, mean, n * sizeof(double));
        return;
    }
    const double *const row = root[(index - 1) % n], by = index <= n ? live->reach : -live->reach;
    for (int i = 0; i < n; i++) live->point[i] = mean[i] + by * row[i];
}

static int step(const struct live *live, const double *process) {
    double root[STATES][STATES], moved[points][STATES], weighted[points][STATES], sum = 0;
    double *const p = live->covariance, *const mean = live->mean;
    const double *from[points];
    (void)process;
    if (!root_of(p, root)) return 0;
    for (int k = 0; k < points; k++) {
        place(live, k, (const double(*)[STATES])root);
        run(&live->move);
        (void)memcpy(moved[k], live->moved, sizeof moved[k]);
        for (int i = 0; i < n; i++) sum += 0 * moved[k][i];
    }
    if (!(sum == 0)) return 0; /* not a number, or infinite */
    (void)memcpy(live->point, mean, n * sizeof(double));
    run(&live->noise);
    for (int i = 0; i < n; i++) {
        double at = 0;
        for (int k = 1; k < points; k++) at += moved[k][i];
        mean[i] = live->weights[0] * moved[0][i] + live->weights[1] * at;
    }
    for (int k = 0; k < points; k++) {
        const double weight = live->squares[k > 0];
        for (int i = 0; i < n; i++) {
            moved[k][i] -= mean[i];
            weighted[k][i] = weight * moved[k][i];
        }
        from[k] = moved[k];
    }
    (void)memcpy(p, live->q, n * n * sizeof(double));
    combine_rows(n, n, p, n, points, weighted[0], 1, n, from);
    for (int i = 1; i < n; i++)
        for (int j = 0; j < i; j++) p[i * n + j] = p[j * n + i] = 0.5 * (p[i * n + j] + p[j * n + i]);
    return 1;
}

static double wrapped(double angle) { return angle - 2 * M_PI * floor((angle + M_PI) / (2 * M_PI)); }

static double measure(const struct live *live, const struct sensor *sensor, const double *value,
                      const double *variance, double limit, double scale) {
    struct innovation innovation;
    double root[STATES][STATES], expected[points][COMPONENTS], projected[COMPONENTS][STATES] = {{0}}, error[STATES];
    double across[STATES], nis = -1;
    const double *from[STATES];
    const int m = (int)sensor->components;
    int component[COMPONENTS], used = 0;
    if (!root_of(live->covariance, root)) return NAN;
    for (int k = 0; k < points; k++) {
        place(live, k, (const double(*)[STATES])root);
        run(&sensor->expect);
        if (k == 0 && *sensor->used == 0) break;
        for (int a = 0; a < m; a++) expected[k][a] = sensor->expected[a];
        if (k > 0) continue;
        for (int a = 0; a < m; a++) {
            if (isfinite(value[a]) && isfinite(expected[0][a])) component[used++] = a;
        }
    }
    for (int b = 0; b < used; b++) { /* expected := how the points differ from their mean */
        const int a = component[b], angle = sensor->angles[a] != 0;
        const double middle = expected[0][a];
        double mean = 0;
        for (int k = 0; k < points; k++) {
            expected[k][a] -= middle;
            if (angle) expected[k][a] = wrapped(expected[k][a]);
            mean += live->weights[k > 0] * expected[k][a];
        }
        for (int k = 0; k < points; k++) {
            expected[k][a] -= mean;
            if (angle) expected[k][a] = wrapped(expected[k][a]);
        }
        innovation.residual[b] = value[a] - (middle + mean);
        if (angle) innovation.residual[b] = wrapped(innovation.residual[b]);
    }
    for (int i = 0; i < n; i++) from[i] = root[i];
    for (int a = 0; a < used; a++) {
        const int ca = component[a];
        for (int b = 0; b <= a; b++) {
            const int cb = component[b];
            double sum = 0;
            for (int k = 0; k < points; k++) sum += live->squares[k > 0] * expected[k][ca] * expected[k][cb];
            innovation.factor[a][b] = innovation.factor[b][a] = scale * (sum + (a == b ? variance[ca] : 0));
        }
        for (int i = 0; i < n; i++)
            across[i] = live->squares[1] * live->reach * (expected[1 + i][ca] - expected[1 + n + i][ca]);
        combine(n, projected[a], n, across, from);
    }
    innovation.used = used;
    if (used) nis = apply(&innovation, projected, live->covariance, error, limit);
    report(live->whitened, live->factor, m, &innovation, component);
    if (nis >= 0 && nis <= limit)
        for (int i = 0; i < n; i++) live->mean[i] += error[i];
    return nis;
}

static int is_valid(const struct live *live) {
    int within = 1;
    for (int i = 0; i < n; i++) within &= live->covariance[i * (n + 1)] >= 0 && fabs(live->mean[i]) < live->largest[i];
    return within;
}
