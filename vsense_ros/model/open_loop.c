/* Many steps of the car without a word of Python between them: the compiled twin of open_loop.py, which says what it
 * does. It follows the code that CasADi generated for the car's functions, in the same file.
 */
#include <math.h>
#include <string.h>

#define COORDINATES 14
#define DYNAMIC 7
#define INPUTS 5
#define WHEELS 4
#define SURROUNDINGS 4

/* a becomes its inverse, by Gauss-Jordan elimination with row pivots; 0 if it has none. The order of rows or columns in
 * memory does not matter, since the inverse of the transpose is the transpose of the inverse. */
static int invert(double *a) {
    enum { n = COORDINATES };
    int pivot[n];
    for (int k = 0; k < n; k++) {
        int best = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(a[i * n + k]) > fabs(a[best * n + k])) best = i;
        pivot[k] = best;
        if (!(fabs(a[best * n + k]) > 0)) return 0;
        if (best != k)
            for (int j = 0; j < n; j++) {
                double t = a[k * n + j];
                a[k * n + j] = a[best * n + j];
                a[best * n + j] = t;
            }
        const double scale = 1 / a[k * n + k];
        a[k * n + k] = 1;
        for (int j = 0; j < n; j++) a[k * n + j] *= scale;
        for (int i = 0; i < n; i++) {
            if (i == k) continue;
            const double factor = a[i * n + k];
            a[i * n + k] = 0;
            for (int j = 0; j < n; j++) a[i * n + j] -= factor * a[k * n + j];
        }
    }
    for (int k = n - 1; k >= 0; k--)
        if (pivot[k] != k)
            for (int i = 0; i < n; i++) {
                double t = a[i * n + k];
                a[i * n + k] = a[i * n + pivot[k]];
                a[i * n + pivot[k]] = t;
            }
    return 1;
}

struct run {
    long long steps, keep; /* steps in all; every keep-th state is kept, and is where the car is linearised */
    double h;
    double *q, *u, *memory; /* the state: at the beginning, and at the end when done */
    const double *inputs, *surroundings, *target, *gain, *varying; /* one row per step */
    double *parameters;      /* those that vary are overwritten in each step … */
    long long varied;        /* … so many … */
    const long long *places; /* … which are these */
    double *kept_q, *kept_u, *kept_udot; /* one row of 14 per kept state */
    double *work;
    long long *integers;
};

/* Returns the number of steps done; fewer than asked for where the motion left the range of numbers. */
long long open_loop(struct run *r) {
    double force[COORDINATES] = {0}, inputs[INPUTS], before[INPUTS], between[INPUTS], inverse[COORDINATES * COORDINATES], udot[COORDINATES];
    double by_q[COORDINATES * DYNAMIC], by_u[COORDINATES * COORDINATES], by_surroundings[COORDINATES * SURROUNDINGS];
    double by_q_rates[COORDINATES * COORDINATES], next_q[COORDINATES], next_u[COORDINATES];
    double remembered[MEMORY > 0 ? MEMORY : 1];
    const double *argument[64] = {r->q, r->u, force, 0, inputs, r->parameters, r->memory};
    double *result[64];
    long long row = 0;
    for (long long i = 0; i < r->steps; i++) {
        memcpy(inputs, r->inputs + INPUTS * i, sizeof inputs);
        argument[3] = r->surroundings + SURROUNDINGS * i;
        for (long long k = 0; k < r->varied; k++) r->parameters[r->places[k]] = r->varying[r->varied * i + k];
        const double behind = r->target[i] - (r->u[10] + r->u[11] + r->u[12] + r->u[13]) / 4;
        for (int k = 0; k < WHEELS; k++) inputs[1 + k] += r->gain[WHEELS * i + k] * behind;
        if (MEMORY > 0) { /* which belongs to the beginning of the step, inputs to its middle */
            if (i > 0)
                for (int k = 0; k < INPUTS; k++) between[k] = (before[k] + inputs[k]) / 2;
            else
                memcpy(between, inputs, sizeof inputs);
            memcpy(before, inputs, sizeof inputs);
            argument[4] = between, argument[7] = &r->h;
            result[0] = remembered;
            remember(argument, result, r->integers, r->work, 0);
            memcpy(r->memory, remembered, MEMORY * sizeof(double));
            argument[4] = inputs;
        }
        if (i % r->keep == 0) {
            result[0] = udot, result[1] = by_q, result[2] = by_u, result[3] = by_surroundings, result[4] = by_q_rates;
            linearize(argument, result, r->integers, r->work, 0);
            memcpy(r->kept_q + COORDINATES * row, r->q, sizeof next_q);
            memcpy(r->kept_u + COORDINATES * row, r->u, sizeof next_u);
            memcpy(r->kept_udot + COORDINATES * row, udot, sizeof udot);
            row++;
            const double gh = GAMMA * r->h;
            for (int k = 0; k < COORDINATES * COORDINATES; k++) inverse[k] = -gh * (by_u[k] + gh * by_q_rates[k]);
            for (int k = 0; k < COORDINATES; k++) inverse[k * (COORDINATES + 1)] += 1;
            if (!invert(inverse)) return i;
        }
        argument[7] = &r->h, argument[8] = inverse, argument[9] = by_q;
        result[0] = next_q, result[1] = next_u;
        advance(argument, result, r->integers, r->work, 0);
        double sum = 0;
        for (int k = 0; k < COORDINATES; k++) sum += next_u[k] + next_q[k];
        if (!isfinite(sum)) return i;
        memcpy(r->q, next_q, sizeof next_q);
        memcpy(r->u, next_u, sizeof next_u);
    }
    return r->steps;
}
