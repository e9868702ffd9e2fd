/* Arithmetic on LANES numbers at once, which stand in lanes side by side: simd.py and native.py write what is made of it.
 *
 * The vector types are those of GCC and Clang, for any processor; a truth is 1 or 0 in a lane, as CasADi has it. With
 * VECTOR_MATH the compiler is told that the C library has sine and the like for whole vectors (glibc: -lmvec).
 */
#include <math.h>
#include <string.h>

#if defined(LANES)
#elif defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif

typedef double lanes __attribute__((vector_size(8 * LANES)));
typedef double apart __attribute__((vector_size(8 * LANES), aligned(8), may_alias)); /* anywhere in memory */
typedef long long mask __attribute__((vector_size(8 * LANES)));

#if defined(VECTOR_MATH) && !defined(__clang__)
#define OF_LANES __attribute__((simd("notinbranch")))
OF_LANES double sin(double);
OF_LANES double cos(double);
OF_LANES double tan(double);
OF_LANES double asin(double);
OF_LANES double acos(double);
OF_LANES double atan(double);
OF_LANES double sinh(double);
OF_LANES double cosh(double);
OF_LANES double tanh(double);
OF_LANES double exp(double);
OF_LANES double log(double);
OF_LANES double atan2(double, double);
OF_LANES double pow(double, double);
#endif

static inline lanes all(double x) { return (lanes){0} + x; }
static inline lanes one_where(mask m) { return (lanes)(m & (mask)all(1)); }
static inline lanes zero_unless(mask m, lanes x) { return (lanes)(m & (mask)x); }
static inline lanes either(mask m, lanes x, lanes y) { return (lanes)((m & (mask)x) | (~m & (mask)y)); }
static inline lanes greater(lanes x, lanes y) { return either(x > y, x, y); }
static inline lanes smaller(lanes x, lanes y) { return either(x < y, x, y); }
static inline lanes size_of(lanes x) { return either(x < 0, -x, x); }
static inline lanes sign_of(lanes x) { return one_where(x > 0) - one_where(x < 0); }

#define EACH(name, f)                                          \
    static __attribute__((noinline)) lanes name(lanes x) {     \
        double a[LANES];                                       \
        memcpy(a, &x, sizeof a);                               \
        for (int i = 0; i < LANES; i++) a[i] = f(a[i]);        \
        memcpy(&x, a, sizeof a);                               \
        return x;                                              \
    }
#define EACH_PAIR(name, f)                                          \
    static __attribute__((noinline)) lanes name(lanes x, lanes y) { \
        double a[LANES], b[LANES];                                  \
        memcpy(a, &x, sizeof a);                                    \
        memcpy(b, &y, sizeof b);                                    \
        for (int i = 0; i < LANES; i++) a[i] = f(a[i], b[i]);       \
        memcpy(&x, a, sizeof a);                                    \
        return x;                                                   \
    }
#pragma GCC diagnostic ignored "-Wunused-function"
static inline lanes lanes_sqrt(lanes x) {
    for (int i = 0; i < LANES; i++) x[i] = sqrt(x[i]);
    return x;
}
EACH(lanes_sin, sin)
EACH(lanes_cos, cos)
EACH(lanes_tan, tan)
EACH(lanes_asin, asin)
EACH(lanes_acos, acos)
EACH(lanes_atan, atan)
EACH(lanes_sinh, sinh)
EACH(lanes_cosh, cosh)
EACH(lanes_tanh, tanh)
EACH(lanes_exp, exp)
EACH(lanes_log, log)
EACH_PAIR(lanes_atan2, atan2)
EACH_PAIR(lanes_pow, pow)
