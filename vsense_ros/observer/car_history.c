/* What Python calls of car_blocks.c: single operations, and whole stretches of a recording as one call. The functions of
 * the model are those that compiled_step.py binds to their arrays. */

/* A function made from the model's expressions, with its arguments, results and working memory. */
struct kernel {
    int (*function)(const double **arguments, double **results, long long *integers, double *numbers, int memory);
    const double **arguments;
    double **results;
    long long *integers;
    double *numbers;
};

/* A filter in Python's hands. */
struct live {
    struct filter filter; /* which it owns */
    struct kernel linearize, kinematics, advance, force, remember, effect, spread;
    const struct kernel *expect, *seen, *learn; /* of each sensor */
    long long size;                             /* of the memory */
    double *memory, *inputs;
    const double *largest; /* n: amounts beyond which no car's state is */
};

/* A measurement, or an input where there is no sensor, and the way to it. */
struct event {
    const struct sensor *sensor;
    double *kept; /* where the filter is kept before it moves on; 0: it is there already */
    const double *decay, *noise;
    double h, limit;
    long long steps, first, count; /* on the way; of the inputs or components */
};

static const struct live *owner(const struct filter *filter) { return filter->owner; }

static void run(const struct kernel *kernel) {
    kernel->function(kernel->arguments, kernel->results, kernel->integers, kernel->numbers, 0);
}

static void run_linearize(const struct filter *filter) { run(&owner(filter)->linearize); }
static void run_kinematics(const struct filter *filter) { run(&owner(filter)->kinematics); }
static void run_remember(const struct filter *filter) { run(&owner(filter)->remember); }
static void run_advance(const struct filter *filter) { run(&owner(filter)->advance); }
static void run_force(const struct filter *filter) { run(&owner(filter)->force); }
static void run_effect(const struct filter *filter) { run(&owner(filter)->effect); }
static void run_spread(const struct filter *filter) { run(&owner(filter)->spread); }
static void run_expect(const struct filter *filter, const struct sensor *sensor) {
    run(&owner(filter)->expect[sensor->index]);
}
static void run_seen(const struct filter *filter, const struct sensor *sensor) {
    run(&owner(filter)->seen[sensor->index]);
}
static void run_learn(const struct filter *filter, const struct sensor *sensor) {
    run(&owner(filter)->learn[sensor->index]);
}

int vsense_transition(const struct model *model, double h, double gamma) { return transition(model, h, gamma); }

void vsense_propagate(const struct model *model, double h, const double *decay, const double *noise) {
    propagate(model, h, decay, noise);
}

double vsense_correct(const struct model *model, const struct sensed *sensed, double scale, double limit) {
    return correct(model, sensed, scale, limit);
}

void vsense_linearize(const struct live *live) { filter_linearize(&live->filter); }

/* The length of the step stands where the filter has it: numbers are the slowest arguments for Python to hand over. */
int vsense_predict(const struct live *live, const double *decay, const double *noise) {
    return filter_predict(&live->filter, *live->filter.length, decay, noise);
}

/* Predict, then linearize; 0 where that is singular. */
int vsense_step(const struct live *live, const double *decay, const double *noise) {
    const int moved = vsense_predict(live, decay, noise);
    if (moved) filter_linearize(&live->filter);
    return moved;
}

/* A correction by one sensor, with its arguments and its result. */
struct call {
    const struct live *live;
    const struct sensor *sensor;
    double limit, scale, nis, value[COMPONENTS], variance[COMPONENTS];
};

void vsense_measure(struct call *call) {
    call->nis =
        filter_measure(&call->live->filter, call->sensor, call->value, call->variance, call->limit, call->scale);
}

/* Keeps the filter as it is, then moves it by `steps` steps. Returns 0, and the filter is as it was, where its state is
 * not a car's or cannot be moved. */
int vsense_move(const struct live *live, double *kept, int steps, double h, const double *decay, const double *noise) {
    const struct filter *const filter = &live->filter;
    if (!filter_is_valid(filter->state, filter->model.covariance, live->largest)) return 0;
    memcpy(kept, live->memory, live->size * sizeof(double));
    *filter->length = h;
    for (int i = 0; i < steps; i++)
        if (!vsense_step(live, decay, noise)) {
            memcpy(live->memory, kept, live->size * sizeof(double));
            return 0;
        }
    return 1;
}

/* Lets events happen, up to one that the filter cannot move to or does not believe; returns how many happened. `moved`
 * tells whether the filter moved to the one that did not; `nis` are the squared innovations of the measurements. */
int vsense_replay(const struct live *live, int count, const struct event *events, const double *values,
                  const double *variances, double *nis, int *moved) {
    for (int i = 0; i < count; i++) {
        const struct event *const event = events + i;
        *moved = !event->kept;
        if (event->kept && !vsense_move(live, event->kept, event->steps, event->h, event->decay, event->noise))
            return i;
        *moved = 1;
        if (event->sensor) {
            nis[i] = filter_measure(&live->filter, event->sensor, values, variances, event->limit, 1);
            if (!(nis[i] <= event->limit)) return i;
        } else {
            for (int j = 0; j < event->count; j++)
                if (isfinite(values[j])) live->inputs[event->first + j] = values[j];
        }
        values += event->count;
        variances += event->count;
    }
    *moved = 0;
    return count;
}
