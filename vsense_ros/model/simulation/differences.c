/* Motions near a known one, side by side: the compiled twin of differences.py, which says what it does. It follows
 * open_loop.c in the same file.
 */
/* Jacobians along known motions, for `differences`: of each lane, its own inverse (14×14) and by_q (14×7) of every
 * `every`-th row. */
struct along {
    long long rows, every;
    double h;                                            /* of a row [s] */
    const anywhere *q, *u, *inputs, *gain, *disturbances, *varying; /* one row per row of the motions */
    const anywhere *parameters;
    long long varied;
    const long long *places;
    double *jacobians;
};

#define JACOBIAN (COORDINATES * COORDINATES + COORDINATES * DYNAMIC)

void jacobians_along(const struct along *r) {
    lanes work[LINEARIZE_WORK + ACCELERATIONS_WORK], parameters[PARAMETERS], memory[MEMORY + 1], force[COORDINATES];
    lanes udot[COORDINATES], pull[WHEELS];
    lanes q[COORDINATES], u[COORDINATES], inputs[INPUTS], disturbances[DISTURBANCES];
    lanes by_u[COORDINATES * COORDINATES], by_q_rates[COORDINATES * COORDINATES], found[JACOBIAN];
    lanes *inverse = found, *by_q = found + COORDINATES * COORDINATES;
    const lanes gh = all(GAMMA * r->h);
    const lanes *in[7] = {q, u, force, disturbances, inputs, parameters, memory};
    lanes *linearized[4] = {udot, by_q, by_u, by_q_rates};
    const long long kept = (r->rows + r->every - 1) / r->every;
    for (int k = 0; k < COORDINATES; k++) force[k] = all(0);
    for (int k = 0; k < PARAMETERS; k++) parameters[k] = r->parameters[k];
    for (int k = 0; k < MEMORY; k++) memory[k] = all(0);
    for (long long row = 0; row < r->rows; row += r->every) {
        for (int k = 0; k < COORDINATES; k++) q[k] = r->q[COORDINATES * row + k], u[k] = r->u[COORDINATES * row + k];
        for (int k = 0; k < INPUTS; k++) inputs[k] = r->inputs[INPUTS * row + k];
        for (int k = 0; k < DISTURBANCES; k++) disturbances[k] = r->disturbances[DISTURBANCES * row + k];
        for (long long k = 0; k < r->varied; k++) parameters[r->places[k]] = r->varying[r->varied * row + k];
        linearize(in, linearized, work);
        for (int k = 0; k < WHEELS; k++) pull[k] = r->gain[WHEELS * row + k];
        by_held_speed(in, inputs, pull, udot, by_u, work);
        for (int k = 0; k < COORDINATES * COORDINATES; k++) inverse[k] = -gh * (by_u[k] + gh * by_q_rates[k]);
        for (int k = 0; k < COORDINATES; k++) inverse[k * (COORDINATES + 1)] += 1;
        invert(inverse);
        for (int lane = 0; lane < LANES; lane++)
            for (int k = 0; k < JACOBIAN; k++)
                r->jacobians[(lane * kept + row / r->every) * JACOBIAN + k] = found[k][lane];
    }
}

struct difference {
    long long rows, every;
    double h;                                      /* of a row [s] */
    const double *known_q, *known_u, *known_udot;  /* the motion that is known, one row of 14 after the other */
    const double *known_disturbances, *jacobians;
    const anywhere *q, *u;                         /* where each lane begins */
    const anywhere *inputs, *disturbances, *target, *gain, *varying; /* one row per row of the motion */
    const anywhere *parameters;
    long long varied;
    const long long *places;
    double *kept_q, *kept_u, *kept_udot; /* of each lane, its own rows of 14, … */
    long long *kept;                     /* … of which these were reached */
};

struct cars {
    const struct difference *r;
    lanes parameters[PARAMETERS], memory[MEMORY + 1], force[COORDINATES], inputs[INPUTS], disturbances[DISTURBANCES];
    lanes work[ACCELERATIONS_WORK + RATES_WORK];
    lanes q[COORDINATES], u[COORDINATES], rate[COORDINATES], rate_u[COORDINATES];
};

/* How much faster the cars, by `apart_q` and `apart_u` from the known motion in a row, change than that does: `rate` and
 * `rate_u`. */
static void apart_in(struct cars *c, long long row, const lanes *apart_q, const lanes *apart_u) {
    const struct difference *r = c->r;
    lanes around[DISTURBANCES], known_q[COORDINATES], known_u[COORDINATES], known[COORDINATES];
    for (int k = 0; k < COORDINATES; k++) {
        known_q[k] = all(r->known_q[COORDINATES * row + k]), known_u[k] = all(r->known_u[COORDINATES * row + k]);
        c->q[k] = known_q[k] + apart_q[k], c->u[k] = known_u[k] + apart_u[k];
    }
    for (int k = 0; k < DISTURBANCES; k++) {
        c->disturbances[k] = r->disturbances[DISTURBANCES * row + k];
        around[k] = all(r->known_disturbances[DISTURBANCES * row + k]);
    }
    for (long long k = 0; k < r->varied; k++) c->parameters[r->places[k]] = r->varying[r->varied * row + k];
    const lanes behind = r->target[row] - (c->u[SPIN] + c->u[SPIN + 1] + c->u[SPIN + 2] + c->u[SPIN + 3]) / 4;
    for (int k = 0; k < INPUTS; k++) c->inputs[k] = r->inputs[INPUTS * row + k];
    for (int k = 0; k < WHEELS; k++) c->inputs[TORQUES + k] += r->gain[WHEELS * row + k] * behind;
    const lanes *state[7] = {c->q, c->u, c->force, c->disturbances, c->inputs, c->parameters, c->memory};
    const lanes *of_known[3] = {known_q, known_u, around}, *own[3] = {c->q, c->u, c->disturbances};
    lanes *by_time[1] = {c->rate_u}, *moving[1] = {c->rate}, *moved[1] = {known};
    accelerations(state, by_time, c->work);
    rates(own, moving, c->work);
    rates(of_known, moved, c->work);
    for (int k = 0; k < COORDINATES; k++) {
        c->rate[k] -= known[k];
        c->rate_u[k] -= all(r->known_udot[COORDINATES * row + k]);
    }
}

/* A stage of the method with the Jacobian of the known motion: its rates, of `c->rate` and `c->rate_u` as right sides. */
static void stage(struct cars *c, const double *jacobian, lanes gh, lanes *rate_q, lanes *rate_u) {
    static const int dynamic[DYNAMIC] = {DYNAMIC_PLACES};
    const double *inverse = jacobian, *by_q = jacobian + COORDINATES * COORDINATES;
    lanes right[COORDINATES], moved[COORDINATES];
    for (int i = 0; i < COORDINATES; i++) {
        lanes sum = all(0);
        for (int j = 0; j < DYNAMIC; j++) sum += by_q[j * COORDINATES + i] * c->rate[dynamic[j]];
        right[i] = c->rate_u[i] + gh * sum;
    }
    for (int i = 0; i < COORDINATES; i++) {
        lanes sum = all(0);
        for (int j = 0; j < COORDINATES; j++) sum += inverse[j * COORDINATES + i] * right[j];
        rate_u[i] = sum;
    }
    const lanes *own[3] = {c->q, rate_u, c->disturbances};
    lanes *moving[1] = {moved};
    rates(own, moving, c->work);
    for (int i = 0; i < COORDINATES; i++) rate_q[i] = c->rate[i] + gh * moved[i];
}

/* Motions near a known one, by how far they are apart: what drives this changes so little from row to row that a step is
 * a row, and the Jacobian is that of the known motion. */
void differences(const struct difference *r) {
    struct cars c;
    lanes q[COORDINATES], u[COORDINATES], middle_q[COORDINATES], middle_u[COORDINATES];
    lanes first_q[COORDINATES], first_u[COORDINATES], second_q[COORDINATES], second_u[COORDINATES];
    const lanes h = all(r->h), gh = GAMMA * h;
    long long alive[LANES];
    c.r = r;
    for (int lane = 0; lane < LANES; lane++) alive[lane] = -1, r->kept[lane] = 0;
    for (int k = 0; k < PARAMETERS; k++) c.parameters[k] = r->parameters[k];
    for (int k = 0; k < MEMORY; k++) c.memory[k] = all(0); /* of effects without size */
    for (int k = 0; k < COORDINATES; k++) {
        c.force[k] = all(0);
        q[k] = r->q[k] - all(r->known_q[k]), u[k] = r->u[k] - all(r->known_u[k]);
    }
    for (long long row = 0; row < r->rows; row++) {
        const double *jacobian = r->jacobians + row / r->every * JACOBIAN;
        apart_in(&c, row, q, u);
        for (int k = 0; k < COORDINATES; k++) middle_u[k] = c.rate_u[k] + all(r->known_udot[COORDINATES * row + k]);
        keep(r->kept_q, c.q, alive, row, r->rows);
        keep(r->kept_u, c.u, alive, row, r->rows);
        keep(r->kept_udot, middle_u, alive, row, r->rows);
        for (int lane = 0; lane < LANES; lane++)
            if (alive[lane]) r->kept[lane] = row + 1;
        if (row + 1 == r->rows) return;
        stage(&c, jacobian, gh, first_q, first_u);
        for (int k = 0; k < COORDINATES; k++) middle_q[k] = q[k] + h * first_q[k], middle_u[k] = u[k] + h * first_u[k];
        apart_in(&c, row + 1, middle_q, middle_u);
        for (int k = 0; k < COORDINATES; k++) c.rate[k] -= 2 * first_q[k], c.rate_u[k] -= 2 * first_u[k];
        stage(&c, jacobian, gh, second_q, second_u);
        lanes sum = all(0);
        for (int k = 0; k < COORDINATES; k++) {
            q[k] += h * (1.5 * first_q[k] + 0.5 * second_q[k]), u[k] += h * (1.5 * first_u[k] + 0.5 * second_u[k]);
            sum += q[k] + u[k];
        }
        long long any = 0;
        for (int lane = 0; lane < LANES; lane++) {
            if (!isfinite(sum[lane])) alive[lane] = 0;
            any |= alive[lane];
        }
        if (!any) return;
    }
}
