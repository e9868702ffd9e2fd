/* Operations of the errorEKF of a multibody car, each of which exists here once: for the observer in Python, which
 * calls them by car_live.c, and for that of `vsense export c`. On top of ../estimation/algebra.c.
 *
 * Jacobians come column-major from the model's functions. MODEL is the number of coordinates; the state begins with
 * coordinates, velocities, accelerations (MODEL each) and DISTURB disturbances, then come biases.
 *
 * The transition of the velocities' errors involves only the coordinates that forces depend on, the velocities, the
 * accelerations and the disturbances; the coordinates follow the velocities by a nearly diagonal map; everything else
 * decays on its own. That is about 40,000 multiplications for 52 states instead of the 280,000 of F P F'.
 *
 * LEARNING is 1 where parameters may be estimated along with the state, else 0.
 */
#define MODEL 14
#define DYNAMIC 7
#define DISTURB 7
#define ROAD 5    /* the first of the disturbances: slopes of the road along and across, their changes, height */
#define SURFACE 4 /* all of these but the height */
#define SLOW (2 * MODEL) /* the first of the states that decay on their own */
#define SPIN 10 /* the first of the wheels' spins among the coordinates */
#define GAIN (DYNAMIC + MODEL + MODEL + DISTURB)
#define BODY 6 /* the pose of the chassis, and how it moves */
#define FOLLOWED (BODY + SURFACE)
#define PADDED 16 /* MODEL, rounded up to whole vectors */

/* What the algebra works on; all arrays stay where they are. */
struct model {
    const double *by_q, *by_u, *by_disturbances, *by_q_rates; /* 14 x 7, 14, 4, 14 */
    double *by_angles, *by_velocity, *by_road;                /* 6 x 3, 6 x 6, 6 x 4: rates of the pose */
    double *road_rate, *road_by_velocity, *road_by_road;      /* 3, 3 x 6, 3 x 4: of slopes and height of the road */
    const double *levers;    /* 2: see add_noise */
    const double *roughness; /* what is known of roads, 2 x 3: see road_map */
    double *road_map;        /* ROAD x FOLLOWED: the road under the car by where it was and by how the car moved */
    double *inverse;                                          /* 14 x 14, column-major: (I - gamma h J)^-1 */
    double *gain; /* GAIN x PADDED: new errors of the velocities, a column each, by the old errors */
    double *covariance, *error;
    double *udot; /* 14 */
    double *whitened, *factor; /* COMPONENTS, COMPONENTS x COMPONENTS, or null: the last innovation */
};

/* A measurement of `components` and what was expected of it. */
struct sensed {
    int components, uses_acceleration, first_bias, biases;
    const double *value, *variance;
    double *expected, *by_q, *by_u, *by_udot, *by_disturbances, *by_biases; /* each component by its own bias */
};

/* Parameters that are estimated along with the state; parameter_filter.py says how. */
struct known {
    double *estimates, *covariance, *sensitivity, *information; /* k, k x k, n x k column-major, k x k */
};
struct learning {
    long long count, drifts;  /* of parameters; whether any drifts */
    const long long *columns; /* of the parameters in `physical` */
    struct known known;
    double *physical;
    double *gain, *decay;          /* arguments of `run_spread`: 14 x GAIN, n - SLOW */
    double *moved, *grown, *added; /* its results: sensitivity, covariance, columns for the state's covariance */
};

/* A filter: what lasts from call to call, and where the functions of the model leave what they find. */
struct filter {
    void *owner; /* of whoever defines the functions below */
    struct model model;
    double *state, *effects;
    double *reversion_mean;                                /* what states behind the velocities return to */
    long long effects_size;                                /* 0: nothing to remember */
    double gamma;                                          /* of the time integration, ROS2 */
    double *length;                                        /* [s] of the step, argument of the functions */
    double *coordinates, *velocities, *remembered, *added; /* after the step; forces of a correction */
    const struct learning *learning;                       /* or 0 */
};

/* A sensor, of which `index` tells the functions below what it is. */
struct sensor {
    long long index;
    struct sensed sensed;
    /* What it tells of the parameters: `width` columns. */
    long long width;
    double *variance, *weighted;     /* m, argument of `run_seen`; n x width, its result, ... */
    double *gained, *right, *spread; /* ... with these, which go on to `run_learn`: width x width, width, k x width */
    double *projected;              /* n x width, argument of `run_learn` */
    struct known results;             /* its results: what is known now, ... */
    double *change, *accelerations; /* ... and changes: n, of the state, accelerations in place of the forces; 14 */
};

/* Functions of the model, which whoever includes this file defines: each reads the filter and writes its results. */
static void run_linearize(const struct filter *filter);
static void run_kinematics(const struct filter *filter);
static void run_remember(const struct filter *filter);
static void run_advance(const struct filter *filter);
static void run_force(const struct filter *filter);
static void run_expect(const struct filter *filter, const struct sensor *sensor);
#if LEARNING
static void run_effect(const struct filter *filter);
static void run_spread(const struct filter *filter);
static void run_seen(const struct filter *filter, const struct sensor *sensor);
static void run_learn(const struct filter *filter, const struct sensor *sensor);
#endif

/* What tells brakes that may act from brakes that are released: the speed below which a car may be held by them [m/s],
 * gravity [m/s^2], deceleration by the air over the square of the speed [1/m], and that by the engine [m/s^2]. */
struct brakes {
    double standing, gravity, drag, engine_braking;
};

/* 1 while the car decelerates as if it were braked, or stands, else 0 (`wheel_torques.py: mode`). */
static int braking(const double *state, const double *udot, const struct brakes *brakes) {
    const double *const u = state + MODEL;
    if (u[0] < brakes->standing) return 1;
    const double along = udot[0] - u[5] * u[1] + brakes->gravity * sin(state[3 * MODEL]);
    return !(along + brakes->drag * u[0] * u[0] > -brakes->engine_braking);
}

static const int dynamic_coordinates[DYNAMIC] = {2, 3, 4, 6, 7, 8, 9};

/* The row to eliminate column k with: that of the diagonal as long as it has not lost much, else that of the largest
 * element. The matrix is 1 - gamma h J, and what is on its diagonal does not depend on the units of the velocities. */
static int pivot_row(double (*a)[PADDED], int k) {
    int best = k;
    if (fabs(a[k][k]) > 0.1) return k;
    for (int i = k + 1; i < MODEL; i++)
        if (fabs(a[i][k]) > fabs(a[best][k])) best = i;
    return best;
}

/* a := a^-1 by Gauss-Jordan elimination in place. Returns 0 if singular. */
static int invert(double (*a)[PADDED]) {
    int swapped[MODEL];
    for (int k = 0; k < MODEL; k++) {
        const int best = pivot_row(a, k);
        swapped[k] = best;
        if (!(fabs(a[best][k]) > 1e-300)) return 0;
        double pivot[PADDED], factor[MODEL];
        const double scale = 1 / a[best][k];
        for (int j = 0; j < PADDED; j++) pivot[j] = scale * (j == k ? 1 : a[best][j]);
        if (best != k) (void)memcpy(a[best], a[k], sizeof a[k]);
        for (int i = 0; i < MODEL; i++) {
            factor[i] = a[i][k];
            a[i][k] = 0;
        }
        for (int i = 0; i < MODEL; i++)
            for (int j = 0; j < PADDED; j += WIDE) *(lane *)(a[i] + j) -= factor[i] * *(lane *)(pivot + j);
        (void)memcpy(a[k], pivot, sizeof pivot);
    }
    for (int k = MODEL - 1; k >= 0; k--) /* rows that were exchanged are columns of the inverse */
        for (int i = 0; i < MODEL && swapped[k] != k; i++) {
            const double kept = a[i][k];
            a[i][k] = a[i][swapped[k]];
            a[i][swapped[k]] = kept;
        }
    return 1;
}

/* Fills `inverse` and `gain` for a step of `h`: the stability function of ROS2, and its response to a constant force,
 * applied to the linearised model. Everything is transposed here, as the Jacobians are. Returns 0 if singular. */
static int transition(const struct model *model, double h, double gamma) {
    double inverse[MODEL][PADDED] = {{0}}, share[MODEL][PADDED], slope[MODEL * MODEL];
    const double *rows[MODEL];
    double (*const gain)[PADDED] = (double (*)[PADDED])model->gain, (*const response)[PADDED] = gain + DYNAMIC + MODEL;
    for (int i = 0; i < MODEL * MODEL; i++) slope[i] = model->by_u[i] + gamma * h * model->by_q_rates[i];
    for (int i = 0; i < MODEL; i++) {
        for (int j = 0; j < MODEL; j++) inverse[i][j] = -gamma * h * slope[i * MODEL + j];
        inverse[i][i] += 1;
    }
    if (!invert(inverse)) return 0;
    for (int i = 0; i < MODEL; i++) { /* h [S + (1/2 - gamma) W S] with W = (S - I) / gamma */
        rows[i] = inverse[i];
        for (int j = 0; j < PADDED; j++) {
            share[i][j] = h * (0.5 - gamma) / gamma * (inverse[i][j] - (i == j));
            response[i][j] = h * inverse[i][j];
        }
        (void)memcpy(model->inverse + i * MODEL, inverse[i], MODEL * sizeof(double));
    }
    combine_rows(MODEL, PADDED, response[0], PADDED, MODEL, share[0], PADDED, 1, rows);
    for (int i = 0; i < MODEL; i++) rows[i] = response[i];
    set_rows(DYNAMIC, PADDED, gain[0], PADDED, MODEL, model->by_q, MODEL, 1, rows);
    set_rows(MODEL, PADDED, gain[DYNAMIC], PADDED, MODEL, slope, MODEL, 1, rows);
    set_rows(DISTURB, PADDED, response[MODEL], PADDED, MODEL, model->by_disturbances, MODEL, 1, rows);
    for (int i = 0; i < MODEL; i++) gain[DYNAMIC + i][i] += 1;
    return 1;
}

/* Columns of p from `first` on are the `MODEL` rows: the matrix is symmetric. */
static void mirror(double (*rows)[STATES], double *p, int first) {
    for (int j = 0; j < n; j++)
        for (int i = 0; i < MODEL; i++) p[j * n + first + i] = rows[i][j];
}

/* Rows of p from `first` on: `rows`, and where they cross the columns of their own the lower triangle of `corner`. */
static void put_rows(double (*rows)[STATES], double (*corner)[PADDED], double *p, int first) {
    for (int i = 0; i < MODEL; i++)
        for (int j = 0; j <= i; j++) {
            rows[i][first + j] = corner[i][j];
            rows[j][first + i] = corner[i][j];
        }
    (void)memcpy(p + first * n, rows, MODEL * sizeof *rows);
}

/* Covariance after the velocities have moved: their rows, then what these make of themselves. */
static void propagate_velocities(const struct model *model) {
    enum { half = PADDED / 2 }; /* of the corner the lower triangle is needed: its first rows are short */
    double *const p = model->covariance, rows[MODEL][STATES], corner[MODEL][PADDED];
    const double *from[GAIN], *from_moved[GAIN];
    int k = 0;
    for (int i = 0; i < DYNAMIC; i++) from[k++] = p + dynamic_coordinates[i] * n;
    for (int i = MODEL; i < 3 * MODEL + DISTURB; i++) from[k++] = p + i * n;
    set_rows(MODEL, n, rows[0], n, GAIN, model->gain, 1, PADDED, from);
    mirror(rows, p, MODEL);
    for (k = 0; k < GAIN; k++) from_moved[k] = from[k] + MODEL;
    set_rows(half, half, corner[0], PADDED, GAIN, model->gain, 1, PADDED, from_moved);
    set_rows(MODEL - half, MODEL, corner[half], PADDED, GAIN, model->gain + half, 1, PADDED, from_moved);
    put_rows(rows, corner, p, MODEL);
}

/* The coordinates then follow: position and attitude the attitude and the velocity of the chassis and the form of the
 * road, each of the others its rate. */
static void propagate_coordinates(const struct model *model, double h) {
    enum { followed = 3 + BODY + SURFACE };
    double *const p = model->covariance, rows[MODEL][STATES], corner[MODEL][PADDED], map[BODY][followed];
    const double *from[followed], *const by[] = {model->by_angles, model->by_velocity, model->by_road};
    const int first[] = {3, MODEL, 3 * MODEL}, count[] = {3, BODY, SURFACE};
    for (int part = 0, k = 0; part < 3; part++)
        for (int j = 0; j < count[part]; j++, k++) {
            from[k] = p + (first[part] + j) * n;
            for (int i = 0; i < BODY; i++) map[i][k] = h * by[part][j * BODY + i];
        }
    (void)memcpy(rows, p, sizeof rows);
    combine_rows(BODY, n, rows[0], n, followed, map[0], followed, 1, from);
    for (int i = BODY; i < MODEL; i++)
        for (int j = 0; j < n; j++) rows[i][j] += h * p[(MODEL + i) * n + j];
    mirror(rows, p, 0);
    for (int i = 0; i < MODEL; i++) (void)memcpy(corner[i], p + i * n, sizeof corner[i]);
    combine_rows(BODY, PADDED, corner[0], PADDED, followed, map[0], followed, 1, from);
    for (int i = BODY; i < MODEL; i++)
        for (int j = 0; j < MODEL; j++) corner[i][j] += h * p[(MODEL + i) * n + j];
    put_rows(rows, corner, p, 0);
}

/* Fills `road_map` for a step of `h` at a `speed`: what the road's slopes, their changes and its height become by how
 * the car then moves and by what the former were. A change of slope goes back to its mean with the distance, the
 * sooner the farther the slope is from its own: `roughness` holds for grade and bank one over that distance [1/m], the
 * variance of the change, and what the slope adds [1/m^2]. Returns in `noise` (2) the variances added to the changes. */
static void road_map(const struct model *model, double h, double speed, double *noise) {
    double *const map = model->road_map;
    const int slope_of[] = {0, 1, 4};
    (void)memset(map, 0, ROAD * FOLLOWED * sizeof *map);
    for (int i = 0; i < 3; i++) {
        double *const row = map + slope_of[i] * FOLLOWED;
        for (int j = 0; j < BODY; j++) row[j] = h * model->road_by_velocity[j * 3 + i];
        for (int j = 0; j < SURFACE; j++) row[BODY + j] = h * model->road_by_road[j * 3 + i];
        if (i < 2) row[BODY + i] += 1;
    }
    for (int i = 0; i < 2; i++) {
        const double *const known = model->roughness + 3 * i;
        const double way = h * fabs(speed), decay = 1.0 / (1.0 + way * known[0]);
        double *const row = map + (2 + i) * FOLLOWED + BODY;
        row[2 + i] = decay;
        row[i] = -decay * way * known[2];
        noise[i] = known[1] * (1 - decay * decay);
    }
}

/* The road follows: first the rows, then what they make of themselves. */
static void propagate_road(const struct model *model) {
    double *const p = model->covariance, rows[ROAD][STATES] = {{0}}, corner[ROAD][ROAD] = {{0}};
    const double *const map = model->road_map, *from[FOLLOWED], *from_moved[FOLLOWED];
    double *const height = p + (3 * MODEL + ROAD - 1) * n;
    const int first = 3 * MODEL;
    for (int k = 0; k < FOLLOWED; k++) from[k] = p + (k < BODY ? MODEL + k : first + k - BODY) * n;
    (void)memcpy(rows[ROAD - 1], height, n * sizeof(double));
    combine_rows(ROAD, n, rows[0], n, FOLLOWED, map, FOLLOWED, 1, from);
    for (int j = 0; j < n; j++)
        for (int i = 0; i < ROAD; i++) p[j * n + first + i] = rows[i][j];
    for (int k = 0; k < FOLLOWED; k++) from_moved[k] = from[k] + first;
    for (int j = 0; j < ROAD; j++) corner[ROAD - 1][j] = height[first + j];
    combine_rows(ROAD, ROAD, corner[0], ROAD, FOLLOWED, map, FOLLOWED, 1, from_moved);
    for (int i = 0; i < ROAD; i++)
        for (int j = 0; j <= i; j++) {
            rows[i][first + j] = corner[i][j];
            rows[j][first + i] = corner[i][j];
        }
    (void)memcpy(p + first * n, rows, sizeof rows);
}

/* Variances of the states behind the velocities, n - SLOW, and then covariances of the errors of two wheels' torques
 * each, 6: a differential drives two alike, brakes act on all. Errors of the forces along and across the car are the tyres',
 * which act on the road below cog: they turn the body too, by `levers` about x and y [rad/m]. */
static void add_noise(const struct model *model, const double *noise) {
    double *const p = model->covariance + SLOW * (n + 1);
    const int turning[] = {1, 0};
    for (int i = SLOW; i < n; i++) model->covariance[i * n + i] += noise[i - SLOW];
    for (int i = 0; i < 2; i++) {
        const int turned = 3 + i;
        const double shared = model->levers[i] * noise[turning[i]];
        p[turned * n + turning[i]] += shared;
        p[turning[i] * n + turned] += shared;
    }
    for (int i = 0, pair = n - SLOW; i < 4; i++)
        for (int j = 0; j < i; j++, pair++) {
            p[(SPIN + i) * n + SPIN + j] += noise[pair];
            p[(SPIN + j) * n + SPIN + i] += noise[pair];
        }
}

/* Covariance after the step; `decay` (n - SLOW) and `noise` as in `add_noise` belong to the states behind the
 * velocities, of which the road under the car has its own. */
static void propagate(const struct model *model, double h, double speed, const double *decay, const double *noise) {
    double *const p = model->covariance, one[STATES], changes[2];
    road_map(model, h, speed, changes);
    propagate_velocities(model);
    propagate_coordinates(model, h);
    propagate_road(model);
    for (int j = 0; j < n; j++) one[j] = j < SLOW ? 1 : decay[j - SLOW];
#if WIDE > 1
    for (int i = 0; i < n; i++) {
        const double own = one[i];
        for (int j = i < SLOW ? SLOW : 0; j < n; j++) p[i * n + j] *= own * one[j];
    }
#else /* half of it, and the other half copied */
    for (int i = SLOW; i < n; i++) {
        const double own = one[i];
        for (int j = 0; j < i; j++) p[j * n + i] = p[i * n + j] *= own * one[j];
        p[i * n + i] *= own * own;
    }
#endif
    add_noise(model, noise);
    for (int i = 0; i < 2; i++) p[(3 * MODEL + 2 + i) * (n + 1)] += changes[i];
}

/* The road under a car that has moved from the velocities `before` to those `after`. Slopes and their changes have a
 * `mean`, of which the slopes change on the way, too. */
static void move_road(const struct model *model, double h, const double *before, const double *after, double *mean,
                      double *road) {
    double next[ROAD];
    const double *const map = model->road_map;
    for (int i = 0; i < 2; i++) {
        const double *const row = map + (2 + i) * FOLLOWED + BODY;
        next[i] = road[i];
        next[2 + i] = mean[2 + i] + row[2 + i] * (road[2 + i] - mean[2 + i]) + row[i] * (road[i] - mean[i]);
        mean[i] += h * before[0] * mean[2 + i];
    }
    next[ROAD - 1] = road[ROAD - 1];
    for (int i = 0; i < 3; i++) {
        double *const to = next + (i < 2 ? i : ROAD - 1);
        *to += h * model->road_rate[i];
        for (int j = 0; j < BODY; j++) *to += h * model->road_by_velocity[j * 3 + i] * (after[j] - before[j]);
    }
    (void)memcpy(road, next, sizeof next);
}

/* One row of the measurement's Jacobian by the whole state. */
static void sensed_row(const struct model *model, const struct sensed *sensed, int i, double *row) {
    const int m = sensed->components;
    (void)memset(row, 0, n * sizeof *row);
    for (int j = 0; j < MODEL; j++) {
        row[j] = sensed->by_q[j * m + i];
        row[MODEL + j] = sensed->by_u[j * m + i];
    }
    for (int j = 0; j < DISTURB; j++) row[3 * MODEL + j] = sensed->by_disturbances[j * m + i];
    if (sensed->uses_acceleration != 0)
        for (int k = 0; k < MODEL; k++) {
            const double f = sensed->by_udot[k * m + i];
            if (is_zero(f) != 0) continue;
            for (int j = 0; j < DYNAMIC; j++) row[dynamic_coordinates[j]] += f * model->by_q[j * MODEL + k];
            for (int j = 0; j < MODEL; j++) row[MODEL + j] += f * model->by_u[j * MODEL + k];
            row[2 * MODEL + k] = f;
            for (int j = 0; j < DISTURB; j++) row[3 * MODEL + j] += f * model->by_disturbances[j * MODEL + k];
        }
    if (sensed->biases > 0) row[sensed->first_bias + i] = sensed->by_biases[i];
}

/* Keeps the whitened innovation and the factor of its covariance. */
static void tell(const struct model *model, int components, const int *component, const struct innovation *innovation) {
    for (int i = 0; i < components; i++) model->whitened[i] = (double)NAN;
    for (int i = 0; i < components * components; i++) model->factor[i] = i % (components + 1) == 0;
    for (int a = 0; a < innovation->used; a++) {
        model->whitened[component[a]] = innovation->weights[a];
        for (int b = 0; b <= a; b++) model->factor[component[a] * components + component[b]] = innovation->factor[a][b];
    }
}

/* Adds what the error makes of the accelerations, with which the sensor that comes next is compared. */
static void carry_on(const struct model *model) {
    enum { all = DYNAMIC + MODEL + DISTURB };
    const double *const error = model->error, *column[all];
    double factor[all];
    int count = 0;
    for (int j = 0; j < DYNAMIC; j++) {
        column[count] = model->by_q + j * MODEL;
        factor[count++] = error[dynamic_coordinates[j]];
    }
    for (int j = 0; j < MODEL; j++) {
        column[count] = model->by_u + j * MODEL;
        factor[count++] = error[MODEL + j];
    }
    for (int j = 0; j < DISTURB; j++) {
        column[count] = model->by_disturbances + j * MODEL;
        factor[count++] = error[3 * MODEL + j];
    }
    for (int i = 0; i < MODEL; i++) model->udot[i] += error[2 * MODEL + i];
    combine(MODEL, model->udot, all, factor, column);
}

/* Returns the squared norm of the innovation in units of its standard deviation, negative if nothing was measured;
 * the correction is made, and carried into error and accelerations, only where that is at most limit. */
static double correct(const struct model *model, const struct sensed *sensed, double scale, double limit) {
    struct innovation innovation;
    int component[COMPONENTS];
    innovation.used = 0;
    for (int i = 0; i < sensed->components; i++)
        if (isfinite(sensed->value[i]) && isfinite(sensed->expected[i])) component[innovation.used++] = i;
    if (innovation.used == 0) return -1;
    for (int a = 0; a < innovation.used; a++) {
        sensed_row(model, sensed, component[a], innovation.rows[a]);
        innovation.residual[a] = sensed->value[component[a]] - sensed->expected[component[a]];
        innovation.variance[a] = sensed->variance[component[a]];
    }
    const double nis = update(&innovation, model->covariance, model->error, scale, limit);
    if (model->whitened && !isnan(nis)) tell(model, sensed->components, component, &innovation);
    if (nis <= limit) carry_on(model);
    return nis;
}

static void filter_linearize(const struct filter *filter) {
    run_linearize(filter);
#if LEARNING
    if (filter->learning != 0) run_effect(filter);
#endif
}

#if LEARNING
/* What a step does to the sensitivity to parameters and, where they drift, to both covariances. */
static void spread(const struct filter *filter, const double *decay) {
    const struct learning *const learning = filter->learning;
    const int count = (int)learning->count;
    const size_t vector = (size_t)count * sizeof(double);
    double *const p = filter->model.covariance;
    for (int i = 0; i < MODEL; i++)
        for (int k = 0; k < GAIN; k++) learning->gain[i * GAIN + k] = filter->model.gain[k * PADDED + i];
    (void)memcpy(learning->decay, decay, (n - SLOW) * sizeof(double));
    run_spread(filter);
    (void)memcpy(learning->known.sensitivity, learning->moved, n * vector);
    if (!learning->drifts) return;
    (void)memcpy(learning->known.covariance, learning->grown, (size_t)count * vector);
    for (int k = 0; k < count; k++) {
        const double *const column = learning->added + k * n;
        combine_rows(n, n, p, n, 1, column, 1, 1, &column);
    }
}

/* Parameters by what a measurement tells of them, and the state as it would have been with these parameters. */
static void learn(const struct filter *filter, const struct sensor *sensor, const double *variance) {
    const struct learning *const learning = filter->learning;
    const int width = (int)sensor->width, count = (int)learning->count;
    const size_t vector = (size_t)count * sizeof(double);
    double column[STATES], factors[STATES];
    const double *rows[STATES];
    (void)memcpy(sensor->variance, variance, (size_t)sensor->sensed.components * sizeof(double));
    run_seen(filter, sensor);
    for (int k = 0; k < n; k++) rows[k] = filter->model.covariance + k * n;
    for (int a = 0; a < width; a++) {
        for (int k = 0; k < n; k++) factors[k] = sensor->weighted[k * width + a];
        (void)memset(column, 0, sizeof column);
        combine(n, column, n, factors, rows);
        for (int k = 0; k < n; k++) sensor->projected[k * width + a] = column[k];
    }
    run_learn(filter, sensor);
    (void)memcpy(learning->known.estimates, sensor->results.estimates, vector);
    (void)memcpy(learning->known.covariance, sensor->results.covariance, (size_t)count * vector);
    (void)memcpy(learning->known.sensitivity, sensor->results.sensitivity, n * vector);
    (void)memcpy(learning->known.information, sensor->results.information, (size_t)count * vector);
    for (int i = 0; i < count; i++) learning->physical[learning->columns[i]] = learning->known.estimates[i];
    (void)memcpy(filter->model.error + SLOW, sensor->change + SLOW, MODEL * sizeof(double));
    run_force(filter);
    (void)memcpy(sensor->change + SLOW, filter->added, MODEL * sizeof(double));
    for (int i = 0; i < n; i++) filter->state[i] += sensor->change[i];
    for (int i = 0; i < MODEL; i++) filter->model.udot[i] += sensor->accelerations[i];
}
#endif

/* Moves model and covariance ahead by `h` from the last linearization. Returns 0, with nothing changed, where that is
 * singular. */
static int filter_predict(const struct filter *filter, double h, const double *decay, const double *noise) {
    *filter->length = h;
    if (!transition(&filter->model, h, filter->gamma)) return 0;
    if (filter->effects_size > 0) {
        run_remember(filter);
        (void)memcpy(filter->effects, filter->remembered, (size_t)filter->effects_size * sizeof(double));
    }
    run_kinematics(filter);
    run_advance(filter);
    propagate(&filter->model, h, filter->state[MODEL], decay, noise);
    double *const slow = filter->state + SLOW;
    double *const mean = filter->reversion_mean;
    move_road(&filter->model, h, filter->state + MODEL, filter->velocities, mean + MODEL, slow + MODEL);
    (void)memcpy(filter->state, filter->coordinates, MODEL * sizeof(double));
    (void)memcpy(filter->state + MODEL, filter->velocities, MODEL * sizeof(double));
    for (int i = 0; i < n - SLOW; i++) slow[i] = mean[i] + decay[i] * (slow[i] - mean[i]);
#if LEARNING
    if (filter->learning != 0) spread(filter, decay);
#endif
    return 1;
}

/* A correction; that of the accelerations becomes one of the forces, M times it (Rodriguez 2020, step 4). */
static double filter_measure(const struct filter *filter, const struct sensor *sensor, const double *value,
                             const double *variance, double limit, double scale) {
    struct sensed sensed = sensor->sensed;
    sensed.value = value;
    sensed.variance = variance;
    run_expect(filter, sensor);
    const double nis = correct(&filter->model, &sensed, scale, limit);
    if (!(nis >= 0 && nis <= limit)) return nis;
    run_force(filter);
    for (int i = 0; i < SLOW; i++) filter->state[i] += filter->model.error[i];
    for (int i = 0; i < MODEL; i++) filter->state[SLOW + i] += filter->added[i];
    for (int i = SLOW + MODEL; i < n; i++) filter->state[i] += filter->model.error[i];
#if LEARNING
    if (filter->learning && is_zero(scale - 1)) learn(filter, sensor, variance); /* what is forced upon it tells nothing */
#endif
    return nis;
}

/* Whether the state is within its bounds (n), beyond which no car's is. */
static int filter_is_valid(const double *state, const double *covariance, const double *largest) {
    if (!(covariance[MODEL * n + MODEL] > 0)) return 0;
    for (int i = 0; i < n; i++)
        if (!(fabs(state[i]) < largest[i])) return 0;
    return 1;
}
