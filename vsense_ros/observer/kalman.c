/* Covariance algebra of the errorEKF: the compiled twin of kalman.py, which says what each function does.
 *
 * Covariances are row-major n x n and exactly symmetric. Jacobians come column-major from the model's functions.
 * No allocation, no library but libm. MODEL is the number of coordinates; the state begins with
 * coordinates, velocities, accelerations (MODEL each) and SURROUND surroundings, then come biases.
 */
#include <math.h>
#include <string.h>

#define MODEL 14
#define DYNAMIC 7
#define SURROUND 4
#define GAIN (DYNAMIC + MODEL + MODEL + SURROUND)
enum { n = STATES }; /* the length of the state, given when compiling: loops of known length are twice as fast */

static const int dynamic_coordinates[DYNAMIC] = {2, 3, 4, 6, 7, 8, 9};

static void gain_columns(int *columns) {
    int k = 0;
    for (int i = 0; i < DYNAMIC; i++) columns[k++] = dynamic_coordinates[i];
    for (int i = MODEL; i < 3 * MODEL + SURROUND; i++) columns[k++] = i;
}

static void multiply(const double *a, const double *b, double *out) {
    for (int i = 0; i < MODEL; i++) {
        double row[MODEL] = {0};
        for (int k = 0; k < MODEL; k++) {
            const double f = a[i * MODEL + k];
            for (int j = 0; j < MODEL; j++) row[j] += f * b[k * MODEL + j];
        }
        memcpy(out + i * MODEL, row, sizeof row);
    }
}

/* Inverse by Gauss-Jordan elimination with partial pivoting; returns 0 if singular. */
static int invert(double *a, double *inverse) {
    memset(inverse, 0, MODEL * MODEL * sizeof *inverse);
    for (int i = 0; i < MODEL; i++) inverse[i * MODEL + i] = 1;
    for (int k = 0; k < MODEL; k++) {
        int best = k;
        for (int i = k + 1; i < MODEL; i++)
            if (fabs(a[i * MODEL + k]) > fabs(a[best * MODEL + k])) best = i;
        const double pivot = a[best * MODEL + k];
        if (!(fabs(pivot) > 1e-300)) return 0;
        for (int j = 0; j < MODEL; j++) {
            double t = a[best * MODEL + j];
            a[best * MODEL + j] = a[k * MODEL + j];
            a[k * MODEL + j] = t / pivot;
            t = inverse[best * MODEL + j];
            inverse[best * MODEL + j] = inverse[k * MODEL + j];
            inverse[k * MODEL + j] = t / pivot;
        }
        for (int i = 0; i < MODEL; i++) {
            const double f = a[i * MODEL + k];
            if (i == k || f == 0) continue;
            for (int j = 0; j < MODEL; j++) {
                a[i * MODEL + j] -= f * a[k * MODEL + j];
                inverse[i * MODEL + j] -= f * inverse[k * MODEL + j];
            }
        }
    }
    return 1;
}

int vsense_transition(double h, double gamma, const double *by_q, const double *by_u, const double *by_surroundings,
                      const double *by_q_rates, double *inverse_columns, double *gain) {
    double slope[MODEL * MODEL], matrix[MODEL * MODEL], inverse[MODEL * MODEL], w[MODEL * MODEL], response[MODEL * MODEL];
    for (int i = 0; i < MODEL; i++)
        for (int j = 0; j < MODEL; j++) {
            const double s = by_u[j * MODEL + i] + gamma * h * by_q_rates[j * MODEL + i];
            slope[i * MODEL + j] = s;
            matrix[i * MODEL + j] = (i == j) - gamma * h * s;
        }
    if (!invert(matrix, inverse)) return 0;
    for (int i = 0; i < MODEL; i++)
        for (int j = 0; j < MODEL; j++) {
            inverse_columns[j * MODEL + i] = inverse[i * MODEL + j];
            w[i * MODEL + j] = (inverse[i * MODEL + j] - (i == j)) / gamma;
        }
    multiply(w, inverse, response);
    for (int i = 0; i < MODEL * MODEL; i++) response[i] = h * (inverse[i] + (0.5 - gamma) * response[i]);
    multiply(response, slope, matrix);
    for (int i = 0; i < MODEL; i++) {
        double *row = gain + i * GAIN;
        memset(row, 0, GAIN * sizeof *row);
        for (int k = 0; k < MODEL; k++) {
            const double f = response[i * MODEL + k];
            for (int j = 0; j < DYNAMIC; j++) row[j] += f * by_q[j * MODEL + k];
            for (int j = 0; j < SURROUND; j++) row[DYNAMIC + 2 * MODEL + j] += f * by_surroundings[j * MODEL + k];
        }
        for (int j = 0; j < MODEL; j++) {
            row[DYNAMIC + j] = (i == j) + matrix[i * MODEL + j];
            row[DYNAMIC + MODEL + j] = response[i * MODEL + j];
        }
    }
    return 1;
}

void vsense_propagate(double h, double *p, const double *gain, const double *by_angles,
                      const double *by_velocity, const double *decay, const double *noise) {
    int columns[GAIN];
    double rows[MODEL][STATES], corner[MODEL][MODEL], angles[6][3], velocity[6][6];
    gain_columns(columns);
    /* velocities */
    for (int i = 0; i < MODEL; i++) {
        double *row = rows[i];
        memset(row, 0, n * sizeof *row);
        for (int k = 0; k < GAIN; k++) {
            const double f = gain[i * GAIN + k];
            const double *from = p + (long)columns[k] * n;
            if (f == 0) continue;
            for (int j = 0; j < n; j++) row[j] += f * from[j];
        }
    }
    for (int i = 0; i < MODEL; i++)
        for (int j = 0; j <= i; j++) {
            double sum = 0;
            for (int k = 0; k < GAIN; k++) sum += rows[i][columns[k]] * gain[j * GAIN + k];
            corner[i][j] = corner[j][i] = sum;
        }
    for (int i = 0; i < MODEL; i++) {
        memcpy(rows[i] + MODEL, corner[i], sizeof corner[i]);
        memcpy(p + (long)(MODEL + i) * n, rows[i], n * sizeof(double));
    }
    for (int j = 0; j < n; j++)
        if (j < MODEL || j >= 2 * MODEL)
            for (int i = 0; i < MODEL; i++) p[(long)j * n + MODEL + i] = rows[i][j];
    /* coordinates */
    for (int i = 0; i < 6; i++) {
        for (int j = 0; j < 3; j++) angles[i][j] = h * by_angles[j * 6 + i];
        for (int j = 0; j < 6; j++) velocity[i][j] = h * by_velocity[j * 6 + i];
    }
    for (int i = 0; i < MODEL; i++) {
        double *row = rows[i];
        memcpy(row, p + (long)i * n, n * sizeof *row);
        if (i < 6) {
            for (int k = 0; k < 3; k++)
                for (int j = 0; j < n; j++) row[j] += angles[i][k] * p[(3 + k) * n + j];
            for (int k = 0; k < 6; k++)
                for (int j = 0; j < n; j++) row[j] += velocity[i][k] * p[(MODEL + k) * n + j];
        } else {
            for (int j = 0; j < n; j++) row[j] += h * p[(MODEL + i) * n + j];
        }
    }
    for (int i = 0; i < MODEL; i++)
        for (int j = 0; j < MODEL; j++) {
            double sum = rows[i][j];
            if (j < 6) {
                for (int k = 0; k < 3; k++) sum += rows[i][3 + k] * angles[j][k];
                for (int k = 0; k < 6; k++) sum += rows[i][MODEL + k] * velocity[j][k];
            } else {
                sum += h * rows[i][MODEL + j];
            }
            corner[i][j] = sum;
        }
    for (int i = 0; i < MODEL; i++) {
        for (int j = 0; j < MODEL; j++) rows[i][j] = 0.5 * (corner[i][j] + corner[j][i]);
        memcpy(p + (long)i * n, rows[i], n * sizeof(double));
        for (int j = MODEL; j < n; j++) p[(long)j * n + i] = rows[i][j];
    }
    /* forces, surroundings, biases */
    for (int i = 0; i < n; i++) {
        double *row = p + (long)i * n;
        if (i >= 2 * MODEL)
            for (int j = 0; j < n; j++) row[j] *= decay[i - 2 * MODEL];
        for (int j = 2 * MODEL; j < n; j++) row[j] *= decay[j - 2 * MODEL];
        if (i >= 2 * MODEL) row[i] += noise[i - 2 * MODEL];
    }
}

/* Returns the squared norm of the innovation in units of its standard deviation, negative if nothing was measured;
 * the correction is made, and error filled, only where that is at most limit. */
double vsense_correct(int m, int uses_acceleration, int first_bias, int biases, const double *value,
                      const double *variance, double scale, double limit, const double *expected, const double *by_q,
                      const double *by_u, const double *by_udot, const double *by_surroundings,
                      const double *model_by_q, const double *model_by_u, const double *model_by_surroundings,
                      double *p, double *error) {
    double jacobian[STATES], projected[16][STATES], total[16][16], innovation[16], weights[16];
    int used = 0, component[16];
    for (int i = 0; i < m; i++)
        if (isfinite(value[i]) && isfinite(expected[i])) component[used++] = i;
    if (used == 0) return -1;
    double rows[16][STATES];
    for (int a = 0; a < used; a++) {
        const int i = component[a];
        memset(jacobian, 0, n * sizeof *jacobian);
        for (int j = 0; j < MODEL; j++) {
            jacobian[j] = by_q[j * m + i];
            jacobian[MODEL + j] = by_u[j * m + i];
        }
        for (int j = 0; j < SURROUND; j++) jacobian[3 * MODEL + j] = by_surroundings[j * m + i];
        if (uses_acceleration)
            for (int k = 0; k < MODEL; k++) {
                const double f = by_udot[k * m + i];
                if (f == 0) continue;
                for (int j = 0; j < DYNAMIC; j++) jacobian[dynamic_coordinates[j]] += f * model_by_q[j * MODEL + k];
                for (int j = 0; j < MODEL; j++) jacobian[MODEL + j] += f * model_by_u[j * MODEL + k];
                jacobian[2 * MODEL + k] = f;
                for (int j = 0; j < SURROUND; j++) jacobian[3 * MODEL + j] += f * model_by_surroundings[j * MODEL + k];
            }
        if (biases) jacobian[first_bias + i] = 1;
        memcpy(rows[a], jacobian, n * sizeof *jacobian);
        innovation[a] = value[i] - expected[i];
        double *out = projected[a];
        memset(out, 0, n * sizeof *out);
        for (int k = 0; k < n; k++) {
            const double f = jacobian[k];
            if (f == 0) continue;
            for (int j = 0; j < n; j++) out[j] += f * p[(long)k * n + j];
        }
    }
    for (int a = 0; a < used; a++)
        for (int b = 0; b <= a; b++) {
            double sum = 0;
            for (int k = 0; k < n; k++) sum += rows[a][k] * projected[b][k];
            total[a][b] = total[b][a] = sum;
        }
    for (int a = 0; a < used; a++) {
        total[a][a] += variance[component[a]];
        for (int b = 0; b < used; b++) total[a][b] *= scale;
    }
    /* Whitening by the Cholesky factor: with L L' = total, projected := L^-1 H P and weights := L^-1 innovation. */
    double nis = 0;
    for (int a = 0; a < used; a++) {
        for (int b = 0; b < a; b++) {
            double sum = total[a][b];
            for (int k = 0; k < b; k++) sum -= total[a][k] * total[b][k];
            total[a][b] = sum / total[b][b];
        }
        double sum = total[a][a];
        for (int k = 0; k < a; k++) sum -= total[a][k] * total[a][k];
        if (!(sum > 0)) return NAN;
        total[a][a] = sqrt(sum);
        double w = innovation[a];
        for (int k = 0; k < a; k++) w -= total[a][k] * weights[k];
        weights[a] = w / total[a][a];
        nis += weights[a] * weights[a];
    }
    if (!(nis <= limit)) return nis;
    for (int a = 0; a < used; a++) {
        for (int k = 0; k < a; k++) {
            const double f = total[a][k];
            for (int j = 0; j < n; j++) projected[a][j] -= f * projected[k][j];
        }
        const double f = 1 / total[a][a];
        for (int j = 0; j < n; j++) projected[a][j] *= f;
    }
    memset(error, 0, n * sizeof *error);
    for (int a = 0; a < used; a++)
        for (int j = 0; j < n; j++) error[j] += weights[a] * projected[a][j];
    for (int i = 0; i < n; i++) {
        double *row = p + (long)i * n;
        for (int a = 0; a < used; a++) {
            const double f = projected[a][i];
            for (int j = 0; j < n; j++) row[j] -= f * projected[a][j];
        }
    }
    return nis;
}
