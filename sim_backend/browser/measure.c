/* The numbers of a verdict: rig.control._measure and _median in C, with the same operations in the same order. A page has no
 * late ticks and loses no samples, so the numbers about these are missing. */
#include <math.h>

#include "rig.h"

enum { /* of rig_meter, whose first nine are those of rig.control._measure.SETTINGS */
    TICK_S, RESOLUTION, FELT_VELOCITY, HIGHPASS_HZ, LOWPASS_HZ, TAIL_TICKS, LEAD_TICKS, PAD_TICKS, IMPACT_TICKS, SECTIONS
};
enum { HIGHPASS, BAND, COEFFICIENTS = 5 };
enum { FEWEST_TICKS = 8, IMPACT_LEAST = 4 };
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

/* First contact, exits, stay in the wall and peaks; returns the tick of the last exit. */
static int measure_contact(int ticks)
{
    const int begin = tail_of(ticks);
    int contact = -1, exits = 0, exits_in_tail = 0, inside_in_tail = 0, entries_in_tail = 0, entered = 0, left_at = 0;
    int stay = 0, was_inside = 0;
    double deepest = penetration[0], strongest = 0.0;
    for (int k = 0; k < ticks; k++) {
        const int inside = penetration[k] > 0.0, in_tail = k >= begin, left = was_inside && !inside;
        if (inside && contact < 0)
            contact = k;
        if (inside && !was_inside) {
            entered = k;
            entries_in_tail += in_tail;
        }
        if (left) {
            left_at = k;
            stay = k - entered;
        }
        exits += left;
        exits_in_tail += left && in_tail;
        inside_in_tail += inside && in_tail;
        was_inside = inside;
        deepest = penetration[k] > deepest ? penetration[k] : deepest;
        strongest = fabs(effort[k]) > strongest ? fabs(effort[k]) : strongest;
    }
    const int once = entries_in_tail == 0 && (exits_in_tail == 1 || inside_in_tail == 0);
    n[EXITS] = exits, n[EXITS_IN_TAIL] = exits_in_tail, n[INSIDE_TICKS_IN_TAIL] = inside_in_tail;
    n[STAY_TICKS] = once && stay * s[TICK_S] * s[HIGHPASS_HZ] >= 1.0 ? stay : 0;
    n[CONTACT_S] = contact >= 0 ? contact * s[TICK_S] : NAN;
    n[PEAK_PENETRATION] = deepest, n[PEAK_EFFORT] = strongest;
    return left_at;
}

static void count_marks(int ticks)
{
    const int begin = tail_of(ticks);
    int saturated = 0, before = 0, slew_bound = 0, overruled = 0;
    for (int k = 0; k < ticks; k++) {
        const int marks = (int)flags[k];
        if (k == begin)
            before = saturated;
        saturated += (marks & RIG_SATURATED) != 0;
        slew_bound += (marks & RIG_SLEW_BOUND) != 0;
        overruled += (marks & RIG_OVERRULED) != 0;
    }
    n[TICKS] = ticks, n[TAIL_BEGINS_S] = begin * s[TICK_S];
    n[SATURATED_FRACTION] = (double)saturated / ticks;
    n[SATURATED_FRACTION_IN_TAIL] = (double)(saturated - before) / (ticks - begin);
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
    int calm = 0;
    if (n[INSIDE_TICKS_IN_TAIL] > 0 && n[STAY_TICKS] > 0)
        calm = begin + (int)n[INSIDE_TICKS_IN_TAIL] - (int)rint(1.0 / (s[HIGHPASS_HZ] * s[TICK_S]));
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
        if (k == calm - 1) {
            n[HEARD_IN_STAY] = sqrt((power_of_half + power) / (calm - begin));
            n[MOVED_IN_STAY] = fmax(0.0, highest - lowest - s[RESOLUTION]);
        }
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

static double end_slope(int first, int last)
{
    const double count = last - first + 1.0, half = 0.5 * (last - first), mean_square = (count * count - 1.0) / 12.0;
    double slope = 0.0, bend = 0.0;
    for (int k = first; k <= last; k++) {
        const double u = k - first - half, travel = position[k] - position[last];
        slope += u * travel;
        bend += (u * u - mean_square) * travel;
    }
    slope /= count * mean_square;
    bend /= count * mean_square * (count * count - 4.0) / 15.0;
    return slope + 2.0 * half * bend;
}

/* Hoare's selection; changes the order of the values. */
static double select_rank(double *values, int count, int rank)
{
    int low = 0, high = count - 1;
    while (low < high) {
        const double pivot = values[low + (high - low) / 2];
        int i = low, j = high;
        while (i <= j) {
            while (values[i] < pivot)
                i++;
            while (values[j] > pivot)
                j--;
            if (i <= j) {
                const double value = values[i];
                values[i++] = values[j];
                values[j--] = value;
            }
        }
        if (rank <= j)
            high = j;
        else if (rank >= i)
            low = i;
        else
            break;
    }
    return values[rank];
}

static double median(double *values, int count)
{
    const double upper = select_rank(values, count, count / 2);
    return count % 2 ? upper : 0.5 * (select_rank(values, count, count / 2 - 1) + upper);
}

static void measure_rest_and_impact(int ticks)
{
    const int begin = tail_of(ticks);
    for (int k = begin; k < ticks; k++)
        scratch[k - begin] = penetration[k];
    const double resting = median(scratch, ticks - begin);
    n[RESTING_PENETRATION] = resting, n[SETTLING_S] = n[IMPACT_VELOCITY] = NAN, n[SETTLING_IN_TAIL_S] = 0.0;
    if (isnan(n[CONTACT_S]))
        return;
    const int contact = (int)rint(n[CONTACT_S] / s[TICK_S]);
    const double band = fmax(2.0 * s[RESOLUTION], same_side * n[PEAK_PENETRATION]);
    int settled = ticks;
    while (settled > contact && !(fabs(penetration[settled - 1] - resting) > band))
        settled--;
    if (settled <= (begin + ticks) / 2) {
        n[SETTLING_S] = (settled - contact) * s[TICK_S];
        n[SETTLING_IN_TAIL_S] = largest(0, settled - begin) * s[TICK_S];
    }
    const int span = smallest(contact, (int)s[IMPACT_TICKS]);
    if (span >= IMPACT_LEAST)
        n[IMPACT_VELOCITY] = end_slope(contact - span, contact) / s[TICK_S];
}

static void write_nothing(int ticks)
{
    for (int i = 0; i < RIG_NUMBERS; i++)
        n[i] = 0.0;
    n[FELT] = n[CONTACT_S] = n[IMPACT_VELOCITY] = n[SETTLING_S] = n[TAIL_BEGINS_S] = NAN;
    n[TICKS] = ticks;
}

void rig_measure(int ticks)
{
    write_nothing(ticks);
    if (ticks < FEWEST_TICKS)
        return;
    const int left_at = measure_contact(ticks);
    count_marks(ticks);
    if (n[STAY_TICKS] > 0 && n[INSIDE_TICKS_IN_TAIL] == 0) {
        n[INSIDE_TICKS_IN_TAIL] = smallest(left_at, (int)s[TAIL_TICKS]);
        measure_ripple_and_travel(left_at);
        n[INSIDE_TICKS_IN_TAIL] = 0;
    }
    measure_ripple_and_travel(ticks);
    if (isnan(n[CONTACT_S]))
        n[TOGGLES] = count_toggles(ticks);
    n[FELT_FLOOR] = toggling_floor(toggling_hz(ticks));
    if (n[FELT_FLOOR] <= s[FELT_VELOCITY])
        n[FELT] = measure_felt(ticks);
    measure_rest_and_impact(ticks);
}
