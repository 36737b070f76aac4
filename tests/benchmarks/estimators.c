/* The estimators once more in C, as a careful programmer writes them: the yardstick of test_estimators.py, which compiles
   this with -O3. Parameters are those of the Python estimators; their places come from the modules themselves, by -D. The
   memory is C's own. Each function exists twice: `name` for the loop below, and `plug_name` for the plug point of rig,
   where numba hands over an array as seven values. */
#include <math.h>
#include <stdint.h>

typedef double update_t(int64_t count, double edge_age_s, int64_t elapsed, double *f, int64_t *i, const double *p);

void run(update_t *update, const int64_t *counts, int64_t n, double *f, int64_t *i, const double *p, double *out)
{
    for (int64_t k = 0; k < n; k++)
        out[k] = update(counts[k], 0.0, 1, f, i, p);
}

#define ARRAY(type, x) void *x##_memory, void *x##_parent, int64_t x##_items, int64_t x##_size, type *x, \
    int64_t x##_length, int64_t x##_stride
#define UNUSED(x) (void)x##_memory, (void)x##_parent, (void)x##_items, (void)x##_size, (void)x##_length, (void)x##_stride
#define ESTIMATOR(name) \
    static inline double name##_(int64_t, double, int64_t, double *, int64_t *, const double *); \
    double name(int64_t count, double edge_age_s, int64_t elapsed, double *f, int64_t *i, const double *p) \
    { \
        return name##_(count, edge_age_s, elapsed, f, i, p); \
    } \
    double plug_##name(int64_t count, double edge_age_s, int64_t elapsed, double effort, \
        ARRAY(double, f), ARRAY(int64_t, i), ARRAY(double, p)) \
    { \
        UNUSED(f), UNUSED(i), UNUSED(p), (void)effort; \
        return name##_(count, edge_age_s, elapsed, f, i, p); \
    } \
    static inline double name##_(int64_t count, double edge_age_s, int64_t elapsed, double *f, int64_t *i, const double *p)

/* i: window, started, previous count */
static inline int64_t moved_since(int64_t count, int64_t *i)
{
    int64_t moved = (int32_t)(uint32_t)(uint64_t)(count - i[2]);
    i[2] = count;
    return moved;
}

static inline int first_sample(int64_t count, int64_t *i)
{
    if (i[1])
        return 0;
    i[1] = 1;
    i[2] = count;
    return 1;
}

ESTIMATOR(fdm)
{
    (void)edge_age_s, (void)f;
    if (first_sample(count, i))
        return 0.0;
    i[0] = elapsed;
    return (double)moved_since(count, i) * p[RESOLUTION] / ((double)elapsed * p[PERIOD]);
}

ESTIMATOR(fdm_butterworth)
{
    double slope = fdm_(count, edge_age_s, elapsed, f, i, p), out = f[2], s1 = f[0], s2 = f[1];
    for (int64_t k = 0; k < elapsed; k++) {
        out = p[B0] * slope + s1;
        s1 = p[B1] * slope - p[A1] * out + s2;
        s2 = p[B2] * slope - p[A2] * out;
    }
    f[0] = s1, f[1] = s2, f[2] = out;
    return out;
}

/* f: position less the last count, velocity, acceleration; covariance p11 p12 p13 p22 p23 p33 */
ESTIMATOR(kalman)
{
    (void)edge_age_s;
    double r = p[R], k1 = p[GAIN1], k2 = p[GAIN2], k3 = p[GAIN3];
    if (first_sample(count, i)) {
        f[3] = r, f[4] = f[5] = f[7] = 0.0, f[6] = PRIOR, f[8] = p[PRIOR33];
        return 0.0;
    }
    i[0] = elapsed;
    double x = f[0], v = f[1], a = f[2];
    for (int64_t k = 0; k < elapsed; k++)
        x += v + 0.5 * a, v += a;
    double nu = (double)moved_since(count, i) - x;
    if (p[STEADY] == 0.0) {
        double p11 = f[3], p12 = f[4], p13 = f[5], p22 = f[6], p23 = f[7], p33 = f[8];
        for (int64_t k = 0; k < elapsed; k++) {
            double a12 = p12 + p22 + 0.5 * p23, a13 = p13 + p23 + 0.5 * p33, a23 = p23 + p33;
            p11 += p12 + 0.5 * p13 + a12 + 0.5 * a13 + p[Q11];
            p12 = a12 + a13 + p[Q12];
            p13 = a13 + p[Q13];
            p22 += p23 + a23 + p[Q22];
            p23 = a23 + p[Q23];
            p33 += p[Q33];
        }
        double s = p11 + r;
        k1 = p11 / s, k2 = p12 / s, k3 = p13 / s;
        p22 += k2 * (k2 * s - 2.0 * p12);
        p23 += k2 * (k3 * s - p13) - k3 * p12;
        p33 += k3 * (k3 * s - 2.0 * p13);
        f[3] = r * k1, f[4] = r * k2, f[5] = r * k3, f[6] = p22, f[7] = p23, f[8] = p33;
    }
    f[0] = (k1 - 1.0) * nu, f[1] = v + k2 * nu, f[2] = a + k3 * nu;
    return f[1] * p[RESOLUTION] / p[PERIOD];
}

/* f: x less the last count, u1 */
static inline double levant_step(double error, double *u1, double *left, double alpha, double lambda, int scheme)
{
    double u;
    if (scheme < 2) {
        double push = error > 0.0 ? 1.0 : error < 0.0 ? -1.0 : 0.0;
        if (scheme == 1)
            *u1 -= alpha * push;
        u = *u1 - lambda * sqrt(fabs(error)) * push;
        if (scheme == 0)
            *u1 -= alpha * push;
    } else {
        double b = -error - *u1, beyond = fabs(b) - alpha;
        if (beyond <= 0.0) {
            *u1 = u = -error;
            *left = 0.0;
            return u;
        }
        double push = b > 0.0 ? 1.0 : -1.0;
        *u1 += alpha * push;
        u = *u1 + lambda * push * 2.0 * beyond / (lambda + sqrt(lambda * lambda + 4.0 * beyond));
    }
    *left = error + u;
    return u;
}

ESTIMATOR(levant)
{
    (void)edge_age_s;
    if (first_sample(count, i))
        return 0.0;
    i[0] = elapsed;
    double slope = (double)moved_since(count, i) / (double)elapsed, error = f[0], u1 = f[1], u = u1;
    int scheme = (int)p[SCHEME];
    for (int64_t k = 0; k < elapsed; k++)
        u = levant_step(error - slope, &u1, &error, p[ALPHA], p[LAMBDA], scheme);
    f[0] = error, f[1] = u1;
    return (p[OUTPUT] != 0.0 ? u1 : u) * p[RESOLUTION] / p[PERIOD];
}

/* i: window, samples, previous, then rings of unwrapped counts and of periods */
#define SLOTS 128
ESTIMATOR(foaw_end)
{
    (void)edge_age_s, (void)f;
    int64_t *counts = i + 3, *periods = i + 3 + SLOTS, newest = i[1] & (SLOTS - 1), last = (newest - 1) & (SLOTS - 1);
    if (i[1]) {
        counts[newest] = counts[last] + moved_since(count, i);
        periods[newest] = periods[last] + elapsed;
    } else {
        i[2] = count, counts[newest] = 0, periods[newest] = 0;
    }
    int64_t samples = i[1]++, limit = (int64_t)p[LIMIT], position = counts[newest], now = periods[newest], window = 0;
    double band = p[BAND], slope = 0.0, lowest = -INFINITY, highest = INFINITY;
    for (int64_t n = 1; n <= (samples < limit ? samples : limit); n++) {
        int64_t oldest = (newest - n) & (SLOTS - 1), span = now - periods[oldest];
        if (span > limit && n > 1)
            break;
        double per_period = 1.0 / (double)span, chord = (double)(position - counts[oldest]) * per_period;
        if (!(lowest <= chord && chord <= highest))
            break;
        slope = chord, window = span;
        double low = chord - band * per_period, high = chord + band * per_period;
        lowest = low > lowest ? low : lowest, highest = high < highest ? high : highest;
    }
    i[0] = window;
    return slope * p[RESOLUTION] / p[PERIOD];
}
