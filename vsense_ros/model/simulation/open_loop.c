/* Many steps of several cars side by side without a word of Python between them: the compiled twin of open_loop.py,
 * which says what it does. It follows simd.c and what simd.py wrote of the car's functions, in the same file.
 *
 * Arrays from outside have one element of all lanes after the other and may lie anywhere. open_loop.py writes the sizes.
 */
typedef lanes anywhere __attribute__((aligned(sizeof(double))));

const long long lanes_at_once = LANES;

struct run {
    long long keep;  /* every keep-th state is kept */
    long long renew; /* every so many steps the car is linearised */
    double h;
    const long long *steps;      /* of each lane: it stands still after them */
    const anywhere *q, *u;       /* where it begins */
    const anywhere *inputs, *disturbances, *target, *gain, *varying; /* one row per step */
    const anywhere *parameters;
    long long varied;            /* so many of the parameters vary … */
    const long long *places;     /* … which are these */
    const anywhere *memory; /* of the effects, where it begins … */
    double *remembered;     /* … and in each lane's last step, its own MEMORY numbers; where it is lost they stay */
    double *kept_q, *kept_u, *kept_udot; /* of each lane, its own rows of 14 per kept state, … */
    long long rows;                      /* … so many … */
    long long *kept;                     /* … of which these were reached */
};

/* a becomes its inverse, by Gauss-Jordan elimination. It is nearly the unit matrix, or larger on its diagonal where
 * tyres and dampers are stiff: no pivots are needed. */
static void invert(lanes *a) {
    enum { n = COORDINATES };
    for (int k = 0; k < n; k++) {
        const lanes scale = 1 / a[k * n + k];
        a[k * n + k] = all(1);
        for (int j = 0; j < n; j++) a[k * n + j] *= scale;
        for (int i = 0; i < n; i++) {
            if (i == k) continue;
            const lanes factor = a[i * n + k];
            a[i * n + k] = all(0);
            for (int j = 0; j < n; j++) a[i * n + j] -= factor * a[k * n + j];
        }
    }
}

static void keep(double *kept, const lanes *state, const long long *alive, long long row, long long rows) {
    for (int lane = 0; lane < LANES; lane++)
        if (alive[lane])
            for (int k = 0; k < COORDINATES; k++) kept[(lane * rows + row) * COORDINATES + k] = state[k][lane];
}

/* Adds to `by_u` what torques do that hold a speed, as they follow the mean spin by the gains `pull`. Accelerations,
 * which are `udot` with the `inputs` of `in`, are linear in them. */
static void by_held_speed(
    const lanes *const *in, lanes *inputs, const lanes *pull, const lanes *udot, lanes *by_u, lanes *work
) {
    lanes pulled[COORDINATES], *accelerated[1] = {pulled};
    for (int k = 0; k < WHEELS; k++) inputs[TORQUES + k] += pull[k];
    accelerations(in, accelerated, work);
    for (int k = 0; k < WHEELS; k++) inputs[TORQUES + k] -= pull[k];
    for (int wheel = SPIN; wheel < SPIN + WHEELS; wheel++)
        for (int k = 0; k < COORDINATES; k++) by_u[wheel * COORDINATES + k] -= (pulled[k] - udot[k]) / WHEELS;
}

/* A lane whose motion leaves the range of numbers goes no further. */
void open_loop(const struct run *r) {
    static const int of_work = LINEARIZE_WORK + ACCELERATIONS_WORK + ADVANCE_WORK + INTERNAL_STATE_WORK;
    lanes work[of_work], parameters[PARAMETERS], memory[MEMORY + 1], remembered[MEMORY + 1];
    lanes q[COORDINATES], u[COORDINATES], force[COORDINATES], udot[COORDINATES];
    lanes next_q[COORDINATES], next_u[COORDINATES], inputs[INPUTS], before[INPUTS], between[INPUTS];
    lanes disturbances[DISTURBANCES], by_q[COORDINATES * DYNAMIC], by_u[COORDINATES * COORDINATES];
    lanes by_q_rates[COORDINATES * COORDINATES], inverse[COORDINATES * COORDINATES], pull[WHEELS];
    const lanes h = all(r->h), gh = GAMMA * h;
    const lanes *in[10] = {q, u, force, disturbances, inputs, parameters, memory, &h, inverse, by_q};
    const lanes *in_between[8] = {q, u, force, disturbances, between, parameters, memory, &h};
    lanes *linearized[4] = {udot, by_q, by_u, by_q_rates}, *advanced[3] = {next_q, next_u, udot};
    long long alive[LANES], most = 0;
    for (int lane = 0; lane < LANES; lane++) {
        alive[lane] = -1, r->kept[lane] = 0;
        if (r->steps[lane] > most) most = r->steps[lane];
    }
    for (int k = 0; k < COORDINATES; k++) q[k] = r->q[k], u[k] = r->u[k], force[k] = all(0);
    for (int k = 0; k < PARAMETERS; k++) parameters[k] = r->parameters[k];
    for (int k = 0; k < MEMORY; k++) memory[k] = r->memory[k];
    for (long long i = 0; i < most; i++) {
        long long any = 0;
        for (int lane = 0; lane < LANES; lane++) {
            if (i >= r->steps[lane]) alive[lane] = 0;
            any |= alive[lane];
        }
        if (!any) return;
        for (int k = 0; k < DISTURBANCES; k++) disturbances[k] = r->disturbances[DISTURBANCES * i + k];
        for (long long k = 0; k < r->varied; k++) parameters[r->places[k]] = r->varying[r->varied * i + k];
        const lanes behind = r->target[i] - (u[SPIN] + u[SPIN + 1] + u[SPIN + 2] + u[SPIN + 3]) / 4;
        for (int k = 0; k < INPUTS; k++) inputs[k] = r->inputs[INPUTS * i + k];
        for (int k = 0; k < WHEELS; k++) inputs[TORQUES + k] += r->gain[WHEELS * i + k] * behind;
        if (MEMORY > 0) { /* which belongs to the beginning of the step, inputs to its middle */
            for (int k = 0; k < INPUTS; k++) {
                between[k] = i > 0 ? (before[k] + inputs[k]) / 2 : inputs[k];
                before[k] = inputs[k];
            }
            lanes *result[1] = {remembered};
            internal_state(in_between, result, work);
            for (int k = 0; k < MEMORY; k++) memory[k] = remembered[k];
            for (int lane = 0; lane < LANES; lane++)
                if (alive[lane] && i + 1 == r->steps[lane])
                    for (int k = 0; k < MEMORY; k++) r->remembered[lane * MEMORY + k] = memory[k][lane];
        }
        if (i % r->renew == 0) {
            linearize(in, linearized, work);
            for (int k = 0; k < WHEELS; k++) pull[k] = r->gain[WHEELS * i + k];
            by_held_speed(in, inputs, pull, udot, by_u, work);
            for (int k = 0; k < COORDINATES * COORDINATES; k++) inverse[k] = -gh * (by_u[k] + gh * by_q_rates[k]);
            for (int k = 0; k < COORDINATES; k++) inverse[k * (COORDINATES + 1)] += 1;
            invert(inverse);
        }
        advance(in, advanced, work);
        if (i % r->keep == 0) {
            const long long row = i / r->keep;
            keep(r->kept_q, q, alive, row, r->rows);
            keep(r->kept_u, u, alive, row, r->rows);
            keep(r->kept_udot, udot, alive, row, r->rows);
            for (int lane = 0; lane < LANES; lane++)
                if (alive[lane]) r->kept[lane] = row + 1;
        }
        lanes sum = all(0);
        for (int k = 0; k < COORDINATES; k++) sum += next_u[k] + next_q[k];
        for (int lane = 0; lane < LANES; lane++)
            if (!isfinite(sum[lane])) alive[lane] = 0;
        for (int k = 0; k < COORDINATES; k++) q[k] = next_q[k], u[k] = next_u[k];
    }
}
