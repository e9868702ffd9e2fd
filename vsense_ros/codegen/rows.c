/* A function of many rows, as many side by side as there are lanes: it follows simd.c and the function `of_lanes`, as
 * simd.py wrote it, in the same file. rows.py writes the sizes.
 */
void of_rows(long long rows, const double *const *arguments, double *result) {
    static const long long sizes[ARGUMENTS] = {SIZES}, steps[ARGUMENTS] = {STEPS}; /* from one row to the next */
    lanes read[ALL_SIZES], made[RESULTS], work[OF_LANES_WORK + 1];
    const lanes *in[ARGUMENTS];
    lanes *out[1] = {made};
    for (long long a = 0, place = 0; a < ARGUMENTS; place += sizes[a++]) in[a] = read + place;
    for (long long begin = 0; begin < rows; begin += LANES) {
        for (int lane = 0; lane < LANES; lane++) {
            const long long row = begin + lane < rows ? begin + lane : rows - 1;
            for (long long a = 0, place = 0; a < ARGUMENTS; place += sizes[a++])
                for (long long k = 0; k < sizes[a]; k++) read[place + k][lane] = arguments[a][row * steps[a] + k];
        }
        of_lanes(in, out, work);
        for (int lane = 0; lane < LANES && begin + lane < rows; lane++)
            for (long long k = 0; k < RESULTS; k++) result[(begin + lane) * RESULTS + k] = made[k][lane];
    }
}
