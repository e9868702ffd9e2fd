/* What corrects a filter, made of a sensor's reading: readings.py says what each is, and both are changed together. NaN:
 * the reading means nothing. SLOWEST_COURSE [m/s] and SPIN_SLIP are given when compiling. */
#include <math.h>

/* The greater of two, NaN where one is. */
static inline double greatest(const double *pair) { return pair[0] > pair[1] || isnan(pair[0]) ? pair[0] : pair[1]; }

static inline void reading_course(const double *value, const double *variance, double *made, double *variances) {
    const double speed = hypot(value[0], value[1]), noise = greatest(variance), sure = 2 * sqrt(noise);
    const int known = speed > (sure > SLOWEST_COURSE ? sure : SLOWEST_COURSE);
    made[0] = known ? atan2(value[1], value[0]) : (double)NAN;
    variances[0] = known ? noise / (speed * speed) : variance[0];
}

static inline void reading_speed_over_ground(const double *value, const double *variance, double *made, double *variances) {
    made[0] = hypot(value[0], value[1]);
    variances[0] = greatest(variance);
}

static inline void reading_heading(const double *value, const double *variance, double *made, double *variances) {
    made[0] = atan2(value[1], value[0]);
    variances[0] = variance[0];
}

static inline void reading_rear_spin(const double *value, const double *variance, double *made, double *variances) {
    const double mean = 0.5 * (value[2] + value[3]), slip = SPIN_SLIP * mean;
    made[0] = mean;
    variances[0] = 0.25 * (variance[2] + variance[3]) + slip * slip;
}
