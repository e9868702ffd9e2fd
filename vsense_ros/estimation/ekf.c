/* Operations of an extended Kalman filter of any state space, on top of algebra.c: dense.py says what each does.
 *
 * STATES is the number of elements of the error, whose covariance this is; the state itself may have more numbers, an
 * attitude four for three angles.
 */

/* A filter in Python's hands. */
struct live {
    struct kernel transition, retract;    /* no function to retract: the error is added */
    long long size, numbers, added;       /* of memory; of the state; of elements of the noise that are not zero */
    double *memory, *mean, *covariance, *inputs, *h, *error, *whitened, *factor;
    const double *moved, *f, *q, *off;    /* results: state, elements of F and Q that are not zero; state corrected */
    const double *largest;                /* numbers: amounts beyond which no state is */
    const long long *row, *column, *place; /* where each row of F begins, and its columns; of Q, places in the covariance */
};

struct sensor {
    struct kernel sense;
    long long components;
    double *value; /* argument of `sense` */
    const double *residual, *by_error, *used; /* by_error row-major, components x STATES */
};

/* out = F rows, where F is sparse. */
static void multiply(const struct live *live, double (*out)[STATES], const double *rows) {
    const double *from[STATES];
    for (int i = 0; i < n; i++) {
        const int first = (int)live->row[i], count = (int)live->row[i + 1] - first;
        for (int k = 0; k < count; k++) from[k] = rows + live->column[first + k] * n;
        (void)memset(out[i], 0, sizeof out[i]);
        combine(n, out[i], count, live->f + first, from);
    }
}

/* P := F P F' + Q, of which the half right of the diagonal is computed and the other copied. */
static void propagate(const struct live *live) {
    double product[STATES][STATES], turned[STATES][STATES], *const p = live->covariance;
    multiply(live, product, p);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) turned[j][i] = product[i][j];
    multiply(live, (double(*)[STATES])p, turned[0]);
    for (int i = 1; i < n; i++)
        for (int j = 0; j < i; j++) p[i * n + j] = p[j * n + i];
    for (int k = 0; k < live->added; k++) p[live->place[k]] += live->q[k];
}

static int step(const struct live *live, const double *process) {
    double sum = 0;
    (void)process; /* all is in the state space */
    run(&live->transition);
    for (int i = 0; i < live->numbers; i++) sum += 0 * live->moved[i];
    if (!is_zero(sum)) return 0; /* not a number, or infinite */
    propagate(live);
    (void)memcpy(live->mean, live->moved, (size_t)live->numbers * sizeof(double));
    return 1;
}

/* The components that are there; returns how many. `component` says which each of them is. */
static int sensed(const struct sensor *sensor, const double *variance, struct innovation *innovation, int *component) {
    int used = 0;
    run(&sensor->sense);
    for (int a = 0; a < sensor->components && !is_zero(*sensor->used); a++) {
        if (!isfinite(sensor->residual[a])) continue;
        (void)memcpy(innovation->rows[used], sensor->by_error + a * n, n * sizeof(double));
        innovation->residual[used] = sensor->residual[a];
        innovation->variance[used] = variance[a];
        component[used] = a;
        used++;
    }
    innovation->used = used;
    return used;
}

static double measure(const struct live *live, const struct sensor *sensor, const double *value,
                      const double *variance, double limit, double scale) {
    struct innovation innovation;
    int component[COMPONENTS] = {0};
    double nis = -1;
    (void)memcpy(sensor->value, value, (size_t)sensor->components * sizeof(double));
    if (sensed(sensor, variance, &innovation, component) > 0) {
        nis = update(&innovation, live->covariance, live->error, scale, limit);
    }
    report(live->whitened, live->factor, (int)sensor->components, &innovation, component);
    if (!(nis >= 0 && nis <= limit)) return nis;
    if (live->retract.function != 0) {
        run(&live->retract);
        (void)memcpy(live->mean, live->off, (size_t)live->numbers * sizeof(double));
    } else
        for (int i = 0; i < n; i++) live->mean[i] += live->error[i];
    return nis;
}

static int is_valid(const struct live *live) {
    for (int i = 0; i < n; i++)
        if (!(live->covariance[i * (n + 1)] >= 0)) return 0;
    for (int i = 0; i < live->numbers; i++)
        if (!(fabs(live->mean[i]) < live->largest[i])) return 0;
    return 1;
}
