/* Algebra that every filter in C shares: linear combinations of rows, and the correction of an extended Kalman filter.
 *
 * Covariances are row-major n x n and exactly symmetric. No allocation, no library but libm, C99. STATES, the length of
 * the state, is given when compiling.
 *
 * Nearly all the work is linear combinations of rows. They are made in tiles, a few rows of so many columns that their
 * sums stay in registers while the terms go by: each number that is loaded then serves several products. GCC and Clang
 * get the columns as vectors of the processor's width, also where nothing beyond C99 is allowed; for other compilers,
 * and processors without vectors of such numbers, a `lane` is a single number. A last lane that would reach over the end of the row
 * begins earlier and makes some columns twice, to the same bits.
 */
#include <math.h>
#include <string.h>

#define COMPONENTS 16 /* at most, of a measurement */
enum { n = STATES };

/* WIDE numbers in a lane; ROWS x LANES sums in a tile, with the operands as many as there are registers. */
#if defined __GNUC__ && defined __AVX512F__ && STATES >= 8
#define WIDE 8
#define ROWS 4
#define LANES 7
#elif defined __GNUC__ && defined __AVX__ && STATES >= 4
#define WIDE 4
#define ROWS 2
#define LANES 6
#elif defined __GNUC__ && defined __ARM_NEON && !defined __aarch64__ && defined SINGLE && STATES >= 4
#define WIDE 4
#define ROWS 2
#define LANES 4
#elif defined __GNUC__ && (defined __SSE2__ || defined __aarch64__) && STATES >= 2
#define WIDE 2
#define ROWS 3
#define LANES 4
#elif defined __ARM_NEON && !defined __aarch64__ /* one number a lane, and 32 registers of them */
#define WIDE 1
#define ROWS 4
#define LANES 6
#else
#define WIDE 1
#define ROWS 2
#define LANES 4
#endif
#if WIDE > 1
typedef double lane __attribute__((vector_size(sizeof(double) * WIDE), aligned(sizeof(double)), may_alias));
#else
typedef double lane;
#endif
/* AS_IT_IS keeps a pointer in one register: else compilers keep a sum for every lane behind it, and add them anew for
 * every term, in place of the instruction that loads from so far behind a register. */
#ifdef __GNUC__
#define INLINE static inline __attribute__((always_inline))
#define AS_IT_IS(pointer) __asm__("" : "+r"(pointer))
#else
#define INLINE static inline
#define AS_IT_IS(pointer) (void)0
#endif
/* Where lane j begins, behind the first. */
#if WIDE > 1
#define COLUMN(j) ((j) < lanes - 1 ? (j) * WIDE : last - first)
#else
#define COLUMN(j) (j)
#endif

static inline int is_zero(double number) { return number <= 0 && number >= 0; }

/* Sums of terms: `count` rows, and their factors, which stand `by_row` apart from sum to sum and `by_term` from term to
 * term. */
struct terms {
    int count, by_row, by_term;
    const double *factor;
    const double *const *row;
};

/* Adds to as many of `left` rows, `stride` apart, as are full tiles, or, if `anew`, sets these; returns how many. `rows`,
 * `lanes` and `anew` are constants wherever this is called; columns begin with `first` in all rows, those of the last
 * lane with `last`. */
INLINE int tiles(const int anew, const int rows, const int lanes, int first, int last, int left, double *out, int stride,
                 const struct terms *terms) {
    int done = 0;
    (void)last; /* the lanes of single numbers never reach over the end */
    const double *factors = terms->factor;
    const lane nothing = {0};
    for (out += first; done + rows <= left; done += rows, factors += rows * terms->by_row) {
        const double *f = factors;
        double *to[ROWS];
        lane sum[ROWS][LANES];
        for (int r = 0; r < rows; r++, out += stride) {
            AS_IT_IS(out);
            to[r] = out;
            for (int j = 0; j < lanes; j++) sum[r][j] = anew ? nothing : *(const lane *)(to[r] + COLUMN(j));
        }
        for (int k = 0; k < terms->count; k++, f += terms->by_term) {
            const double *from = terms->row[k] + first;
            AS_IT_IS(from);
            for (int j = 0; j < lanes; j++) {
                const lane x = *(const lane *)(from + COLUMN(j));
                for (int r = 0; r < rows; r++) sum[r][j] += f[r * terms->by_row] * x;
            }
        }
        for (int r = 0; r < rows; r++)
            for (int j = 0; j < lanes; j++) *(lane *)(to[r] + COLUMN(j)) = sum[r][j];
    }
    return done;
}

/* The same of `lanes` lanes for a constant number of rows. */
INLINE int strip(const int anew, const int rows, int lanes, int first, int last, int left, double *out, int stride,
                 const struct terms *terms) {
    switch (lanes) {
        case 1: return tiles(anew, rows, 1, first, last, left, out, stride, terms);
        case 2: return tiles(anew, rows, 2, first, last, left, out, stride, terms);
        case 3: return tiles(anew, rows, 3, first, last, left, out, stride, terms);
        case 4: return tiles(anew, rows, 4, first, last, left, out, stride, terms);
#if LANES > 4
        case 5: return tiles(anew, rows, 5, first, last, left, out, stride, terms);
        case 6: return tiles(anew, rows, 6, first, last, left, out, stride, terms);
#endif
#if LANES > 6
        case 7: return tiles(anew, rows, 7, first, last, left, out, stride, terms);
#endif
        default: return left;
    }
}

/* out += sums of factor * term, or, if `anew`, out = these: `rows` rows that are `width` long and `stride` apart, each of
 * `count` terms, whose factors stand `by_row` apart from row to row and `by_term` from term to term. */
INLINE void sum_rows(const int anew, int rows, int width, double *out, int stride, int count, const double *factor,
                     int by_row, int by_term, const double *const *term) {
    if (width < WIDE) {
        for (int i = 0; i < rows; i++) {
            for (int j = 0; j < width && anew; j++) out[i * stride + j] = 0;
            for (int k = 0; k < count; k++)
                for (int j = 0; j < width; j++) out[i * stride + j] += factor[i * by_row + k * by_term] * term[k][j];
        }
        return;
    }
    const int all = (width + WIDE - 1) / WIDE;
    for (int begin = 0, end; begin < all; begin = end) { /* the last two share what is left */
        const int left = all - begin;
        end = left <= LANES ? all : left < 2 * LANES ? begin + (left + 1) / 2 : begin + LANES;
        const int last = end < all ? (end - 1) * WIDE : width - WIDE;
        struct terms terms = {count, by_row, by_term, factor, term};
        int done = strip(anew, ROWS, end - begin, begin * WIDE, last, rows, out, stride, &terms);
        terms.factor = factor + done * by_row;
        if (ROWS > 2)
            done += strip(anew, 2, end - begin, begin * WIDE, last, rows - done, out + done * stride, stride, &terms);
        terms.factor = factor + done * by_row;
        strip(anew, 1, end - begin, begin * WIDE, last, rows - done, out + done * stride, stride, &terms);
    }
}

/* out += sums. */
static void combine_rows(int rows, int width, double *out, int stride, int count, const double *factor, int by_row,
                         int by_term, const double *const *term) {
    sum_rows(0, rows, width, out, stride, count, factor, by_row, by_term, term);
}

/* out = sums, whatever stood there. */
static void set_rows(int rows, int width, double *out, int stride, int count, const double *factor, int by_row,
                     int by_term, const double *const *term) {
    sum_rows(1, rows, width, out, stride, count, factor, by_row, by_term, term);
}

/* out += sum of factor[k] * row[k], all rows `width` long. */
static void combine(int width, double *out, int count, const double *factor, const double *const *row) {
    combine_rows(1, width, out, width, count, factor, 0, 1, row);
}

/* Sum of products; `width` is a constant wherever this is called. */
INLINE double dot(const int width, const double *a, const double *b) {
    enum { all = 8 };
    double sums[all] = {0}, rest = 0.0;
    for (int j = 0; j + all <= width; j += all)
        for (int k = 0; k < all; k++) sums[k] += a[j + k] * b[j + k];
    for (int j = width / all * all; j < width; j++) rest += a[j] * b[j];
    return ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7])) + rest;
}

/* A measurement in the filter's terms: of the `used` components that are there, their Jacobians by the errors of the
 * state, innovations and variances; and after `update` L^-1 innovation and the Cholesky factor L of their covariance. */
struct innovation {
    int used;
    double rows[COMPONENTS][STATES], residual[COMPONENTS], variance[COMPONENTS];
    double weights[COMPONENTS], factor[COMPONENTS][COMPONENTS];
};

/* projected (used x n) = H P, of which elements of H that are zero are left out: in all rows at once where they have
 * most of their elements in the same columns, else row by row. */
static void project(const struct innovation *innovation, const double *p, double (*projected)[STATES]) {
    double factors[STATES * COMPONENTS];
    const double *from[STATES];
    const int used = innovation->used;
    int count = 0, elements = 0;
    for (int k = 0; k < n; k++) {
        int here = 0;
        for (int a = 0; a < used; a++) {
            factors[count * used + a] = innovation->rows[a][k];
            here += is_zero(innovation->rows[a][k]) ? 0 : 1;
        }
        elements += here;
        if (here > 0) from[count++] = p + k * n;
    }
    if (2 * used * count <= 3 * elements) {
        set_rows(used, n, projected[0], n, count, factors, 1, used, from);
        return;
    }
    for (int a = 0; a < used; a++) {
        count = 0;
        for (int k = 0; k < n; k++)
            if (!is_zero(innovation->rows[a][k])) {
                factors[count] = innovation->rows[a][k];
                from[count++] = p + k * n;
            }
        set_rows(1, n, projected[a], n, count, factors, 0, 1, from);
    }
}

#if WIDE == 1
/* Columns of p from `first` up to `end` become what the rows are, before these. */
static void mirror_rows(double *p, int first, int end) {
    if (end - first == ROWS) {
        const double *from = p + first * n;
        double *to = p + first;
        for (int j = 0; j < first; j++, from++, to += n)
            for (int k = 0; k < ROWS; k++) to[k] = from[k * n];
        return;
    }
    for (int k = first; k < end; k++)
        for (int j = 0; j < first; j++) p[j * n + k] = p[k * n + j];
}
#endif

/* p += sums of factor * row, which are symmetric: `count` rows, the factors of each n apart. */
static void add_symmetric(double *p, int count, const double *factor, const double *const *row) {
#if WIDE > 1
    combine_rows(n, n, p, n, count, factor, 1, n, row);
#else /* half of it, and the other half copied: vectors would spend more on the ends of rows than they save */
    for (int i = 0; i < n; i += ROWS) {
        const int end = i + ROWS < n ? i + ROWS : n;
        combine_rows(end - i, end, p + i * n, n, count, factor + i, 1, n, row);
        mirror_rows(p, i, end);
    }
#endif
}

/* L L' = total in place, below the diagonal, and weights = L^-1 innovation; returns their squared norm, or NaN. */
static double whiten(struct innovation *innovation, double *inverse_diagonal) {
    double (*const total)[COMPONENTS] = innovation->factor, nis = 0;
    for (int a = 0; a < innovation->used; a++) {
        double sum, w = innovation->residual[a];
        for (int b = 0; b < a; b++) {
            sum = total[a][b];
            for (int k = 0; k < b; k++) sum -= total[a][k] * total[b][k];
            total[a][b] = sum * inverse_diagonal[b];
        }
        sum = total[a][a];
        for (int k = 0; k < a; k++) {
            sum -= total[a][k] * total[a][k];
            w -= total[a][k] * innovation->weights[k];
        }
        if (!(sum > 0.0)) return (double)NAN;
        total[a][a] = sqrt(sum);
        inverse_diagonal[a] = 1 / total[a][a];
        innovation->weights[a] = w * inverse_diagonal[a];
        nis += innovation->weights[a] * innovation->weights[a];
    }
    return nis;
}

/* Corrects the covariance, P - W W' with W = P H' L^-T, and writes the error of the state (n), of an innovation whose
 * covariance stands in `innovation->factor` and that with the state in `projected`, which is used up.
 *
 * Returns the squared norm of the innovation in units of its standard deviation; the correction is made only where that
 * is at most `limit`. NaN: the covariance of the innovation is not positive definite. */
static double apply(struct innovation *innovation, double (*projected)[STATES], double *p, double *error, double limit) {
    double negative[COMPONENTS][STATES], inverse[COMPONENTS], factors[COMPONENTS] = {0};
    double (*const total)[COMPONENTS] = innovation->factor;
    const double *from[COMPONENTS] = {0};
    const int used = innovation->used;
    const double nis = whiten(innovation, inverse);
    if (!(nis <= limit)) return nis;
    for (int a = 0; a < used; a++) { /* projected := L^-1 H P = W' */
        for (int k = 0; k < a; k++) factors[k] = -total[a][k];
        from[a] = projected[a];
        combine(n, projected[a], a, factors, from);
        for (int j = 0; j < n; j++) {
            projected[a][j] *= inverse[a];
            negative[a][j] = -projected[a][j];
        }
    }
    (void)memset(error, 0, n * sizeof *error);
    combine(n, error, used, innovation->weights, from);
    add_symmetric(p, used, negative[0], from);
    return nis;
}

/* `apply` of what an innovation's rows say; `scale` multiplies its covariance. */
static double update(struct innovation *innovation, double *p, double *error, double scale, double limit) {
    double projected[COMPONENTS][STATES];
    double (*const total)[COMPONENTS] = innovation->factor;
    project(innovation, p, projected);
    for (int a = 0; a < innovation->used; a++) {
        for (int b = 0; b <= a; b++) {
            total[a][b] = scale * dot(n, projected[a], innovation->rows[b]);
            total[b][a] = total[a][b];
        }
        total[a][a] += scale * innovation->variance[a];
    }
    return apply(innovation, projected, p, error, limit);
}
