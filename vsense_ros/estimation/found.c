/* Where Python looks for what a correction found: `Innovation` of filter.py. `component` (of `found->used`) says which of
 * the m components of a measurement were there. */
static void report(double *whitened, double *factor, int m, const struct innovation *found, const int *component) {
    for (int a = 0; a < m; a++) {
        whitened[a] = (double)NAN;
        for (int b = 0; b < m; b++) factor[a * m + b] = a == b;
    }
    for (int a = 0; a < found->used; a++) {
        whitened[component[a]] = found->weights[a];
        for (int b = 0; b <= a; b++) factor[component[a] * m + component[b]] = found->factor[a][b];
    }
}
