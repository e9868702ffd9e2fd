/* What Python calls of a filter, whole stretches of a recording as one call: operations.py. It comes after the filter's
 * own operations (ekf.c, ../observer/car_live.c), which define
 *
 *   struct live    a filter in Python's hands, with `size` and `memory`: all that changes; `inputs`, a part of it; and
 *                  `h`, the length of the next step [s]
 *   struct sensor  of which C knows what to do with a measurement
 *   is_valid       whether the state is one that can be
 *   step           0 where that is impossible; `process` is what it reads besides `h`, or 0
 *   measure        a correction, which returns the normalized innovation squared
 */

/* A correction by one sensor, with its arguments and its result. */
struct call {
    const struct live *live;
    const struct sensor *sensor;
    double limit, scale, nis, value[COMPONENTS], variance[COMPONENTS];
};

/* A measurement, or inputs where there is no sensor, and the way to it. */
struct event {
    const struct sensor *sensor;
    double *kept; /* where the filter is kept before it moves on; 0: it is there already */
    const double *process;
    double h, limit;
    long long steps, first, count; /* on the way; of the inputs or components */
};

int vsense_is_valid(const struct live *live) { return is_valid(live); }

int vsense_step(const struct live *live, const double *process) { return step(live, process); }

void vsense_measure(struct call *call) {
    call->nis = measure(call->live, call->sensor, call->value, call->variance, call->limit, call->scale);
}

/* Keeps the filter as it is, then moves it by `steps` steps. Returns 0, and the filter is as it was, where its state is
 * none that can be or cannot be moved. */
int vsense_advance(const struct live *live, double *kept, int steps, double h, const double *process) {
    if (!is_valid(live)) return 0;
    memcpy(kept, live->memory, live->size * sizeof(double));
    *live->h = h;
    for (int i = 0; i < steps; i++)
        if (!step(live, process)) {
            memcpy(live->memory, kept, live->size * sizeof(double));
            return 0;
        }
    return 1;
}

/* Lets events happen, up to one that the filter cannot move to or does not believe; returns how many happened. `moved`
 * tells whether the filter moved to the one that did not; `nis` are the squared innovations of the measurements. */
int vsense_repeat(const struct live *live, int count, const struct event *events, const double *values,
                  const double *variances, double *nis, int *moved) {
    *moved = 0;
    for (int i = 0; i < count; i++) {
        const struct event *const event = events + i;
        if (event->kept && !vsense_advance(live, event->kept, (int)event->steps, event->h, event->process)) return i;
        if (event->sensor) {
            nis[i] = measure(live, event->sensor, values, variances, event->limit, 1);
            if (!(nis[i] <= event->limit)) {
                *moved = 1;
                return i;
            }
        } else
            for (int j = 0; j < event->count; j++)
                if (isfinite(values[j])) live->inputs[event->first + j] = values[j];
        values += event->count;
        variances += event->count;
    }
    return count;
}

/* A sensor at a constant rate: `count` samples `h` apart, of `width` inputs and of one measurement each. Inputs change
 * linearly from sample to sample, and a step has their mean. The memory before every `every`-th correction is copied to
 * `kept`, one after the other, if `every` is not 0. Returns how many corrections were made, `count` if nothing went
 * wrong. */
int vsense_follow(const struct live *live, const struct sensor *sensor, int count, int width, int components, double h,
                  const double *process, const double *inputs, const double *values, const double *variance,
                  double *nis, int every, double *kept) {
    *live->h = h;
    for (int k = 0; k < count; k++) {
        const double *const now = inputs + k * width;
        memcpy(live->inputs, now, width * sizeof(double));
        if (!is_valid(live)) return k;
        if (every && k % every == 0) {
            memcpy(kept, live->memory, live->size * sizeof(double));
            kept += live->size;
        }
        nis[k] = measure(live, sensor, values + k * components, variance, INFINITY, 1);
        if (nis[k] != nis[k]) return k;
        if (k + 1 == count) break;
        for (int i = 0; i < width; i++) live->inputs[i] = (now[i] + now[width + i]) / 2;
        if (!step(live, process)) return k;
    }
    return is_valid(live) ? count : count - 1;
}
