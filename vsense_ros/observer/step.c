/* Operations of the errorEKF, and whole stretches of them, as one call each, on top of kalman.c: error_ekf.py, spi.py and
 * parameter_filter.py say what they do. */

/* A function made from the model's expressions, with its arguments, results and working memory. */
struct kernel {
    int (*function)(const double **arguments, double **results, long long *integers, double *numbers, int memory);
    const double **arguments;
    double **results;
    long long *integers;
    double *numbers;
};

/* Parameters that are estimated along with the state. */
struct learning {
    struct kernel effect, spread;
    long long count, drift, numbers; /* of parameters; whether they drift; of numbers that a measurement changes */
    const long long *columns;        /* of the parameters in `physical` */
    double *learned, *sensitivity, *covariance, *decay, *physical;
    const double *moved, *grown, *added; /* by a step: sensitivity, covariance, and columns for that of the state */
};

struct filter {
    struct model model;
    struct kernel linearize, kinematics, advance, force, remember; /* no function to remember: nothing to remember */
    long long size, effects_size;                                  /* of the memory, and of the effects' part of it */
    double gamma;                                                  /* of the time integration, ROS2 */
    double *memory, *state, *inputs, *effects, *length;            /* length: of the step that is advanced by */
    const double *coordinates, *velocities, *remembered, *added;   /* after the step; forces of a correction */
    const double *largest;                                         /* n: amounts beyond which no car's state is */
    const double *usual;                                           /* what the states behind the velocities go back to */
    const struct learning *learning;                               /* or 0 */
};

struct sensor {
    struct kernel expect;
    struct sensed sensed;
    /* What it tells of the parameters; of seen, variance is an argument, told_of (n x width) is a result. */
    struct kernel seen, learn;
    long long width;
    double *variance, *projected, *change;
    const double *told_of, *learned, *accelerations;
};

/* A measurement, or an input where there is no sensor, and the way to it. */
struct event {
    const struct sensor *sensor;
    double *kept; /* where the filter is kept before it moves on; 0: it is there already */
    const double *decay, *noise;
    double h, limit;
    long long steps, first, count; /* on the way; of the inputs or components */
};

static void run(const struct kernel *kernel) {
    kernel->function(kernel->arguments, kernel->results, kernel->integers, kernel->numbers, 0);
}

void vsense_linearize(const struct filter *filter) {
    run(&filter->linearize);
    if (filter->learning) run(&filter->learning->effect);
}

static void spread(const struct filter *filter, const double *decay) {
    const struct learning *const learning = filter->learning;
    const int count = learning->count;
    double *const p = filter->model.covariance;
    memcpy(learning->decay, decay, (n - 2 * MODEL) * sizeof(double));
    run(&learning->spread);
    memcpy(learning->sensitivity, learning->moved, n * count * sizeof(double));
    if (!learning->drift) return;
    memcpy(learning->covariance, learning->grown, count * count * sizeof(double));
    for (int k = 0; k < count; k++) {
        const double *const column = learning->added + k * n;
        for (int i = 0; i < n; i++) combine(n, p + i * n, 1, column + i, &column);
    }
}

int vsense_predict(const struct filter *filter, double h, const double *decay, const double *noise) {
    *filter->length = h;
    if (filter->effects_size) {
        run(&filter->remember);
        memcpy(filter->effects, filter->remembered, filter->effects_size * sizeof(double));
    }
    if (!vsense_transition(&filter->model, h, filter->gamma)) return 0;
    run(&filter->kinematics);
    run(&filter->advance);
    vsense_propagate(&filter->model, h, decay, noise);
    memcpy(filter->state, filter->coordinates, MODEL * sizeof(double));
    memcpy(filter->state + MODEL, filter->velocities, MODEL * sizeof(double));
    double *const slow = filter->state + 2 * MODEL;
    for (int i = 0; i < n - 2 * MODEL; i++) slow[i] = filter->usual[i] + decay[i] * (slow[i] - filter->usual[i]);
    if (filter->learning) spread(filter, decay);
    return 1;
}

static void learn(const struct filter *filter, const struct sensor *sensor, const double *variance) {
    const struct learning *const learning = filter->learning;
    const int width = sensor->width;
    double factors[STATES], column[STATES];
    const double *rows[STATES];
    memcpy(sensor->variance, variance, sensor->sensed.components * sizeof(double));
    run(&sensor->seen);
    for (int k = 0; k < n; k++) rows[k] = filter->model.covariance + k * n;
    for (int a = 0; a < width; a++) {
        for (int k = 0; k < n; k++) factors[k] = sensor->told_of[k * width + a];
        memset(column, 0, sizeof column);
        combine(n, column, n, factors, rows);
        for (int k = 0; k < n; k++) sensor->projected[k * width + a] = column[k];
    }
    run(&sensor->learn);
    memcpy(learning->learned, sensor->learned, learning->numbers * sizeof(double));
    for (int i = 0; i < learning->count; i++) learning->physical[learning->columns[i]] = learning->learned[i];
    memcpy(filter->model.error + 2 * MODEL, sensor->change + 2 * MODEL, MODEL * sizeof(double));
    run(&filter->force);
    memcpy(sensor->change + 2 * MODEL, filter->added, MODEL * sizeof(double));
    for (int i = 0; i < n; i++) filter->state[i] += sensor->change[i];
    for (int i = 0; i < MODEL; i++) filter->model.udot[i] += sensor->accelerations[i];
}

double vsense_measure(const struct filter *filter, const struct sensor *sensor, const double *value,
                      const double *variance, double limit, double scale) {
    struct sensed sensed = sensor->sensed;
    sensed.value = value;
    sensed.variance = variance;
    run(&sensor->expect);
    const double nis = vsense_correct(&filter->model, &sensed, scale, limit);
    if (!(nis >= 0 && nis <= limit)) return nis;
    run(&filter->force);
    for (int i = 0; i < n; i++)
        filter->state[i] += i / MODEL == 2 ? filter->added[i - 2 * MODEL] : filter->model.error[i];
    if (filter->learning && scale == 1) learn(filter, sensor, variance);
    return nis;
}

static int sane(const struct filter *filter) {
    int within = filter->model.covariance[MODEL * n + MODEL] > 0;
    for (int i = 0; i < n; i++) within &= fabs(filter->state[i]) < filter->largest[i];
    return within;
}

int vsense_move(const struct filter *filter, double *kept, int steps, double h, const double *decay,
                const double *noise) {
    if (!sane(filter)) return 0;
    memcpy(kept, filter->memory, filter->size * sizeof(double));
    for (int i = 0; i < steps; i++) {
        if (!vsense_predict(filter, h, decay, noise)) {
            memcpy(filter->memory, kept, filter->size * sizeof(double));
            return 0;
        }
        vsense_linearize(filter);
    }
    return 1;
}

int vsense_replay(const struct filter *filter, int count, const struct event *events, const double *values,
                  const double *variances, double *nis, int *moved) {
    for (int i = 0; i < count; i++) {
        const struct event *const event = events + i;
        *moved = !event->kept;
        if (event->kept && !vsense_move(filter, event->kept, event->steps, event->h, event->decay, event->noise))
            return i;
        *moved = 1;
        if (event->sensor) {
            nis[i] = vsense_measure(filter, event->sensor, values, variances, event->limit, 1);
            if (!(nis[i] <= event->limit)) return i;
        } else {
            for (int j = 0; j < event->count; j++)
                if (isfinite(values[j])) filter->inputs[event->first + j] = values[j];
        }
        values += event->count;
        variances += event->count;
    }
    *moved = 0;
    return count;
}
