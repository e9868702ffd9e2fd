/* Writes the results of a correction to where Python reads them: `Innovation` of filter.py. `component` has the indices
 * of the `innovation->used` components, of the m of a measurement, that were measured. */
static void report(double *whitened, double *factor, int m, const struct innovation *innovation, const int *component) {
    for (int a = 0; a < m; a++) {
        whitened[a] = (double)NAN;
        for (int b = 0; b < m; b++) factor[a * m + b] = a == b;
    }
    for (int a = 0; a < innovation->used; a++) {
        whitened[component[a]] = innovation->weights[a];
        for (int b = 0; b <= a; b++) factor[component[a] * m + component[b]] = innovation->factor[a][b];
    }
}
