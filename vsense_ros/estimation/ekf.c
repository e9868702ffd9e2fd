/* Operations of an extended Kalman filter of any state space, on top of algebra.c: dense.py says what each does.
 *
 * STATES is the number of elements of the error, whose covariance this is; the state itself may have more numbers, an
 * attitude four for three angles.
 */

/* A function made from expressions, with its arguments, results and working memory. */
struct kernel {
    int (*function)(const double **arguments, double **results, long long *integers, double *numbers, int memory);
    const double **arguments;
    double **results;
    long long *integers;
    double *numbers;
};

struct system {
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
    double *value, *variance;
    const double *residual, *by_error, *used; /* by_error row-major, components x STATES */
};

/* A measurement, or inputs where there is no sensor, and the way to it. */
struct event {
    const struct sensor *sensor;
    double *kept; /* where the filter is kept before it moves on; 0: it is there already */
    double h, limit;
    long long steps, first, count; /* on the way; of the inputs or components */
};

static void run(const struct kernel *kernel) {
    kernel->function(kernel->arguments, kernel->results, kernel->integers, kernel->numbers, 0);
}

/* out = F rows, where F is sparse. */
static void multiply(const struct system *system, double (*out)[STATES], const double *rows) {
    const double *from[STATES];
    for (int i = 0; i < n; i++) {
        const int first = (int)system->row[i], count = (int)system->row[i + 1] - first;
        for (int k = 0; k < count; k++) from[k] = rows + system->column[first + k] * n;
        memset(out[i], 0, sizeof out[i]);
        combine(n, out[i], count, system->f + first, from);
    }
}

/* P := F P F' + Q, of which the half right of the diagonal is computed and the other copied. */
static void propagate(const struct system *system) {
    double product[STATES][STATES], turned[STATES][STATES], *const p = system->covariance;
    multiply(system, product, p);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) turned[j][i] = product[i][j];
    multiply(system, (double(*)[STATES])p, turned[0]);
    for (int i = 1; i < n; i++)
        for (int j = 0; j < i; j++) p[i * n + j] = p[j * n + i];
    for (int k = 0; k < system->added; k++) p[system->place[k]] += system->q[k];
}

int vsense_predict(const struct system *system, double h) {
    double sum = 0;
    *system->h = h;
    run(&system->transition);
    for (int i = 0; i < system->numbers; i++) sum += 0 * system->moved[i];
    if (!(sum == 0)) return 0; /* not a number, or infinite */
    propagate(system);
    memcpy(system->mean, system->moved, system->numbers * sizeof(double));
    return 1;
}

/* The components that are there; returns how many. `component` says which each of them is. */
static int sensed(const struct sensor *sensor, struct innovation *found, int *component) {
    int used = 0;
    run(&sensor->sense);
    for (int a = 0; a < sensor->components && *sensor->used != 0; a++) {
        if (!isfinite(sensor->residual[a])) continue;
        memcpy(found->rows[used], sensor->by_error + a * n, n * sizeof(double));
        found->residual[used] = sensor->residual[a];
        found->variance[used] = sensor->variance[a];
        component[used++] = a;
    }
    return found->used = used;
}

static void report(const struct system *system, const struct sensor *sensor, const struct innovation *found,
                   const int *component) {
    const int m = (int)sensor->components;
    double *const factor = system->factor;
    for (int a = 0; a < m; a++) {
        system->whitened[a] = NAN;
        for (int b = 0; b < m; b++) factor[a * m + b] = a == b;
    }
    for (int a = 0; a < found->used; a++) {
        system->whitened[component[a]] = found->weights[a];
        for (int b = 0; b <= a; b++) factor[component[a] * m + component[b]] = found->factor[a][b];
    }
}

double vsense_correct(const struct system *system, const struct sensor *sensor, double limit, double scale) {
    struct innovation found;
    int component[COMPONENTS];
    double nis = -1;
    if (sensed(sensor, &found, component)) nis = update(&found, system->covariance, system->error, scale, limit);
    report(system, sensor, &found, component);
    if (!(nis >= 0 && nis <= limit)) return nis;
    if (system->retract.function) {
        run(&system->retract);
        memcpy(system->mean, system->off, system->numbers * sizeof(double));
    } else
        for (int i = 0; i < n; i++) system->mean[i] += system->error[i];
    return nis;
}

int vsense_is_valid(const struct system *system) {
    int within = 1;
    for (int i = 0; i < n; i++) within &= system->covariance[i * (n + 1)] >= 0;
    for (int i = 0; i < system->numbers; i++) within &= fabs(system->mean[i]) < system->largest[i];
    return within;
}

int vsense_advance(const struct system *system, double *kept, long long steps, double h) {
    if (!vsense_is_valid(system)) return 0;
    memcpy(kept, system->memory, system->size * sizeof(double));
    for (int i = 0; i < steps; i++)
        if (!vsense_predict(system, h)) {
            memcpy(system->memory, kept, system->size * sizeof(double));
            return 0;
        }
    return 1;
}

int vsense_repeat(const struct system *system, int count, const struct event *events, const double *values,
                  const double *variances, double *nis, int *moved) {
    *moved = 0;
    for (int i = 0; i < count; i++) {
        const struct event *const event = events + i;
        if (event->kept && !vsense_advance(system, event->kept, event->steps, event->h)) return i;
        if (event->sensor) {
            memcpy(event->sensor->value, values, event->count * sizeof(double));
            memcpy(event->sensor->variance, variances, event->count * sizeof(double));
            nis[i] = vsense_correct(system, event->sensor, event->limit, 1);
            if (!(nis[i] <= event->limit)) {
                *moved = 1;
                return i;
            }
        } else {
            nis[i] = 0;
            for (int j = 0; j < event->count; j++)
                if (isfinite(values[j])) system->inputs[event->first + j] = values[j];
        }
        values += event->count;
        variances += event->count;
    }
    return count;
}
