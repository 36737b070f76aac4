/* The numbers that decide the verdict of a hit: rig.control._measure and _median in C. A page has no late ticks, loses no
 * samples and lets no person hit, so the numbers about these are missing. tests/sim_backend/test_browser.py compares the
 * others with Python's. */
#include <math.h>

#include "rig.h"

enum { /* of rig_meter, whose first nine are those of rig.control._measure.SETTINGS */
    TICK_S, RESOLUTION, FELT_VELOCITY, HIGHPASS_HZ, LOWPASS_HZ, TAIL_TICKS, LEAD_TICKS, PAD_TICKS, IMPACT_TICKS, SECTIONS
};
enum { HIGHPASS, BAND, COEFFICIENTS = 5 };
enum { FEWEST_TICKS = 8 };
static const double slow_share = 0.8, same_side = 0.05;

double rig_signals[4 * RIG_ROWS], rig_meter[SECTIONS + 3 * COEFFICIENTS], rig_numbers[RIG_NUMBERS];

static double scratch[2 * RIG_ROWS];
static const double *const position = rig_signals, *const effort = rig_signals + RIG_ROWS;
static const double *const penetration = rig_signals + 2 * RIG_ROWS, *const flags = rig_signals + 3 * RIG_ROWS;
static double *const n = rig_numbers;
static const double *const s = rig_meter;

static int largest(int a, int b)
{
    return a > b ? a : b;
}

static int smallest(int a, int b)
{
    return a < b ? a : b;
}

static int tail_of(int ticks)
{
    return largest(0, ticks - (int)s[TAIL_TICKS]);
}

/* First contact, and exits and stay in the tail; returns the greatest penetration. */
static double measure_contact(int ticks)
{
    const int begin = tail_of(ticks);
    int contact = -1, exits_in_tail = 0, inside_in_tail = 0, was_inside = 0;
    double deepest = penetration[0];
    for (int k = 0; k < ticks; k++) {
        const int inside = penetration[k] > 0.0, in_tail = k >= begin;
        if (inside && contact < 0)
            contact = k;
        exits_in_tail += was_inside && !inside && in_tail;
        inside_in_tail += inside && in_tail;
        was_inside = inside;
        deepest = penetration[k] > deepest ? penetration[k] : deepest;
    }
    n[EXITS_IN_TAIL] = exits_in_tail, n[INSIDE_TICKS_IN_TAIL] = inside_in_tail;
    n[CONTACT_S] = contact >= 0 ? contact * s[TICK_S] : NAN;
    return deepest;
}

static void count_marks(int ticks)
{
    const int begin = tail_of(ticks);
    int saturated_in_tail = 0, slew_bound = 0, overruled = 0;
    for (int k = 0; k < ticks; k++) {
        const int marks = (int)flags[k];
        saturated_in_tail += k >= begin && (marks & RIG_SATURATED) != 0;
        slew_bound += (marks & RIG_SLEW_BOUND) != 0;
        overruled += (marks & RIG_OVERRULED) != 0;
    }
    n[TICKS] = ticks, n[TAIL_BEGINS_S] = begin * s[TICK_S];
    n[SATURATED_FRACTION_IN_TAIL] = (double)saturated_in_tail / (ticks - begin);
    n[SLEW_BOUND_TICKS] = slew_bound, n[OVERRULED_TICKS] = overruled;
}

static double toggling_hz(int ticks)
{
    const int begin = tail_of(ticks), first = largest(0, begin - (int)s[LEAD_TICKS]);
    const double creeping = 0.5 / (s[HIGHPASS_HZ] * s[TICK_S]), slow = slow_share / (s[LOWPASS_HZ] * s[TICK_S]);
    int changes = 0, turned = first, changed = first;
    double direction = 0.0;
    for (int k = first + 1; k < ticks; k++) {
        const double step = position[k] - position[k - 1];
        if (step == 0.0)
            continue;
        if (step * direction <= 0.0) {
            changes += k >= begin;
            direction = step, turned = k;
        } else if (k - turned > creeping && k - changed > slow) {
            changes += k >= begin;
        }
        changed = k;
    }
    return changes / (2.0 * (ticks - begin) * s[TICK_S]);
}

static int count_toggles(int ticks)
{
    int most = 0, changes = 0;
    double low = position[0];
    for (int k = 1; k < ticks; k++) {
        const double away = (position[k] - low) / s[RESOLUTION];
        if (!(-0.5 < away && away < 1.5)) {
            changes = 0;
            low = away < 0.0 ? position[k] : position[k] - s[RESOLUTION];
        } else if (position[k] != position[k - 1]) {
            most = largest(most, ++changes);
        }
    }
    return most;
}

static double toggling_floor(double frequency_hz)
{
    int harmonics = 0;
    for (double hz = frequency_hz; 0.0 < hz && hz <= s[LOWPASS_HZ]; hz += 2.0 * frequency_hz)
        harmonics += hz >= s[HIGHPASS_HZ];
    return 2.0 * sqrt(2.0 * largest(1, harmonics)) * frequency_hz * s[RESOLUTION];
}

/* A second-order section (transposed direct form II). */
static double pass(const double *c, double *memory, double x)
{
    const double y = c[0] * x + memory[0];
    memory[0] = (c[1] * x + memory[1]) - c[3] * y;
    memory[1] = c[2] * x - c[4] * y;
    return y;
}

static void measure_ripple_and_travel(int ticks)
{
    const int begin = tail_of(ticks), first = largest(0, begin - (int)s[LEAD_TICKS]), half = begin + (ticks - begin) / 2;
    const double *section = s + SECTIONS + HIGHPASS * COEFFICIENTS;
    double of_effort[2] = {0.0, 0.0}, of_position[2] = {0.0, 0.0};
    double power = 0.0, power_of_half = 0.0, lowest = 0.0, highest = 0.0;
    for (int k = first; k < ticks; k++) {
        const double ripple = pass(section, of_effort, effort[k] - effort[first]);
        const double travelled = pass(section, of_position, position[k] - position[first]);
        if (k < begin)
            continue;
        if (k == begin)
            lowest = highest = travelled;
        if (k == half)
            power_of_half = power, power = 0.0;
        power += ripple * ripple;
        lowest = travelled < lowest ? travelled : lowest;
        highest = travelled > highest ? travelled : highest;
    }
    n[HEARD] = sqrt((power_of_half + power) / (ticks - begin));
    n[GROWTH] = power_of_half > 0.0 ? sqrt(power / (ticks - half) / (power_of_half / (half - begin))) : 0.0;
    n[MOVED] = fmax(0.0, highest - lowest - s[RESOLUTION]);
}

/* Velocity at tick k by the central difference, mirrored beyond both ends. */
static double velocity_at(int ticks, double rate_hz, int k)
{
    const int last = ticks - 1;
    k = k <= last ? (k < 0 ? -k : k) : 2 * last - k;
    if (k == 0)
        return (position[1] - position[0]) * rate_hz;
    if (k == last)
        return (position[last] - position[last - 1]) * rate_hz;
    return (position[k + 1] - position[k - 1]) * (0.5 * rate_hz);
}

static double measure_felt(int ticks)
{
    const double rate_hz = 1.0 / s[TICK_S], *a = s + SECTIONS + BAND * COEFFICIENTS, *b = a + COEFFICIENTS;
    const int begin = tail_of(ticks), pad = smallest((int)s[PAD_TICKS], ticks - 1);
    const int first = largest(-pad, begin - (int)s[LEAD_TICKS]), end = ticks + pad;
    double memory[4] = {0.0, 0.0, 0.0, 0.0}, back[4] = {0.0, 0.0, 0.0, 0.0}, power = 0.0;
    double start = velocity_at(ticks, rate_hz, first);
    for (int k = first; k < end; k++) {
        const double z = pass(b, memory + 2, pass(a, memory, velocity_at(ticks, rate_hz, k) - start));
        if (k >= begin)
            scratch[k - begin] = z;
    }
    start = scratch[end - 1 - begin];
    for (int i = end - 1 - begin; i >= 0; i--) {
        const double z = pass(b, back + 2, pass(a, back, scratch[i] - start));
        if (i < ticks - begin)
            power += z * z;
    }
    return sqrt(power / (ticks - begin));
}

/* Move values below the pivot, and equal ones if `equal`, to the front; returns the index after them. */
static int partition(double *values, int low, int high, double pivot, int equal)
{
    int front = low;
    for (int i = low; i < high; i++) {
        const double value = values[i];
        values[i] = values[front];
        values[front] = value;
        front += value < pivot || (equal && value == pivot);
    }
    return front;
}

/* Hoare's selection, which changes the order of the values. */
static double median(double *values, int count)
{
    const int middle = count / 2;
    int low = 0, high = count;
    unsigned draw = 1;
    while (high - low > 1) {
        /* A pivot from random values: with fixed ones a regular oscillation would make the time quadratic. */
        double a = values[low], b = a, c = a;
        for (int i = 0; i < 3; i++) {
            draw = (draw * 1103515245u + 12345u) & 0x7fffffffu;
            a = b, b = c, c = values[low + (int)(draw >> 8) % (high - low)];
        }
        const double pivot = fmax(fmin(a, b), fmin(fmax(a, b), c));
        const int below = partition(values, low, high, pivot, 0);
        if (middle < below) {
            high = below;
            continue;
        }
        const int upto = partition(values, below, high, pivot, 1);
        if (middle < upto || upto == low)
            break;
        low = upto;
    }
    if (count % 2)
        return values[middle];
    double lower = values[0];
    for (int i = 1; i < middle; i++)
        lower = values[i] > lower ? values[i] : lower;
    return 0.5 * (lower + values[middle]);
}

/* How long the penetration settles within the tail. */
static double settling_in_tail_s(int ticks, double deepest)
{
    const int begin = tail_of(ticks), contact = (int)rint(n[CONTACT_S] / s[TICK_S]);
    const double band = fmax(2.0 * s[RESOLUTION], same_side * deepest);
    for (int k = begin; k < ticks; k++)
        scratch[k - begin] = penetration[k];
    const double resting = median(scratch, ticks - begin);
    int settled = ticks;
    while (settled > contact && !(fabs(penetration[settled - 1] - resting) > band))
        settled--;
    return settled <= (begin + ticks) / 2 ? largest(0, settled - begin) * s[TICK_S] : 0.0;
}

static void write_nothing(int ticks)
{
    for (int i = 0; i < RIG_NUMBERS; i++)
        n[i] = 0.0;
    n[FELT] = n[CONTACT_S] = n[TAIL_BEGINS_S] = NAN;
    n[TICKS] = ticks;
}

void rig_measure(int ticks)
{
    write_nothing(ticks);
    if (ticks < FEWEST_TICKS)
        return;
    const double deepest = measure_contact(ticks);
    count_marks(ticks);
    measure_ripple_and_travel(ticks);
    if (isnan(n[CONTACT_S]))
        n[TOGGLES] = count_toggles(ticks);
    else
        n[SETTLING_IN_TAIL_S] = settling_in_tail_s(ticks, deepest);
    if (toggling_floor(toggling_hz(ticks)) <= s[FELT_VELOCITY])
        n[FELT] = measure_felt(ticks);
}
