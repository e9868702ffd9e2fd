/* A car's filter in Python's hands, on top of car_blocks.c: car_operations.py binds the functions of the model. */
struct live {
    struct filter filter; /* which it owns */
    struct kernel linearize, kinematics, advance, force, remember, effect, spread;
    const struct kernel *expect, *seen, *learn; /* of each sensor */
    long long size;                             /* of the memory */
    double *memory, *inputs, *h;
    const double *largest; /* n: amounts beyond which no car's state is */
    const struct brakes *brakes;
};

static const struct live *owner(const struct filter *filter) { return filter->owner; }

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

static int is_valid(const struct live *live) {
    return filter_is_valid(live->filter.state, live->filter.model.covariance, live->largest);
}

/* `process`, with brakes that are released and then with brakes that may act: decay and then variance of the states
 * behind the velocities, n - SLOW each, and 6 covariances as in `add_noise`. */
static int step(const struct live *live, const double *process) {
    process += braking(live->filter.state, live->filter.model.udot, live->brakes) * (2 * (n - SLOW) + 6);
    if (!filter_predict(&live->filter, *live->h, process, process + n - SLOW)) return 0;
    filter_linearize(&live->filter);
    return 1;
}

static double measure(const struct live *live, const struct sensor *sensor, const double *value,
                      const double *variance, double limit, double scale) {
    return filter_measure(&live->filter, sensor, value, variance, limit, scale);
}
