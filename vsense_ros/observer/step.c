/* Both operations of the errorEKF as one call each, on top of kalman.c: error_ekf.py says what they do. */

/* A function made from the model's expressions, with its arguments, results and working memory. */
struct kernel {
    int (*function)(const double **arguments, double **results, long long *integers, double *numbers, int memory);
    const double **arguments;
    double **results;
    long long *integers;
    double *numbers;
};

struct filter {
    struct model model;
    struct kernel kinematics, advance, force;
    double *state, *length;                         /* n, and 1: of the step that is advanced by */
    const double *coordinates, *velocities, *added; /* MODEL each: after the step, and forces of a correction */
};

struct sensor {
    struct kernel expect;
    struct sensed sensed;
};

static void run(const struct kernel *kernel) {
    kernel->function(kernel->arguments, kernel->results, kernel->integers, kernel->numbers, 0);
}

int vsense_predict(const struct filter *filter, double h, double gamma, const double *decay, const double *noise) {
    if (!vsense_transition(&filter->model, h, gamma)) return 0;
    run(&filter->kinematics);
    *filter->length = h;
    run(&filter->advance);
    vsense_propagate(&filter->model, h, decay, noise);
    memcpy(filter->state, filter->coordinates, MODEL * sizeof(double));
    memcpy(filter->state + MODEL, filter->velocities, MODEL * sizeof(double));
    for (int i = 2 * MODEL; i < n; i++) filter->state[i] *= decay[i - 2 * MODEL];
    return 1;
}

double vsense_measure(const struct filter *filter, const struct sensor *sensor, double scale, double limit) {
    run(&sensor->expect);
    const double nis = vsense_correct(&filter->model, &sensor->sensed, scale, limit);
    if (!(nis >= 0 && nis <= limit)) return nis;
    run(&filter->force);
    for (int i = 0; i < n; i++)
        filter->state[i] += i / MODEL == 2 ? filter->added[i - 2 * MODEL] : filter->model.error[i];
    return nis;
}
