/* The active current is filtered by the amplifier's lag. The residual, measured less filtered current, is summed over a
 * window by magnitude, so that neither an oscillation nor noise averages it away. The largest one is left out, since it
 * may be a spike of the converter. The filter is also run with half the lag and twice the lag, and with half the delay of
 * the set-point and twice of it, in whole ticks around each; a measured current between all of these has no residual. The
 * sum is compared with the larger of the sensor's noise and a tenth of the expected current. Under voltage drive the
 * back-EMF is subtracted, behind the same lag: it is computed from the smoothed speed of the count. The residual is then
 * smoothed in the same way, so that a spike lasts into the next window. The host has the same rule
 * (rig/control/current.py), bit by bit. */
#include "current.h"

#include <math.h>

#include "wide.h"

#define WINDOWS_A_SECOND 100u /* of 10 ms */
#define FEWEST_TICKS 4u
#define SIGMAS 4.0
#define SHARE 10u
#define SPEED_LAG_S 2.5e-3
#define HALF 32768u /* of 65536 */
#define MOST (32767 * CURRENT_UNIT)
#define COUNT 16384
#define MOST_COUNTS 32767
#define ZERO_TICKS 64
#define ZERO_SHARE 16
#define ZERO_UNIT 256

/* Return the share of a step that a first-order lag follows in a tick (1/65536). */
static uint32_t share_of(double lag_s, uint32_t rate)
{
    return lag_s > 0.0 ? (uint32_t)floor(-expm1(-1.0 / (rate * lag_s)) * 65536.0 + 0.5) : 65536u;
}

/* Return the share of a linear change within a tick that a first-order lag has not followed at its end (1/65536). */
static uint32_t late_part(double lag_s, uint32_t rate)
{
    const double ticks = lag_s * rate;
    return lag_s > 0.0 ? (uint32_t)floor((ticks + 1.0 / expm1(-1.0 / ticks) + 1.0) * 65536.0 + 0.5) : 0u;
}

static uint32_t size_of(int32_t value)
{
    return value < 0 ? (uint32_t)-value : (uint32_t)value;
}

/* Return the distance between two currents (1/16384 quantum), rounded to quanta. */
static uint32_t distance_of(int32_t a, int32_t b)
{
    const uint32_t size = a > b ? (uint32_t)a - (uint32_t)b : (uint32_t)b - (uint32_t)a;
    return (size + CURRENT_UNIT / 2u) / CURRENT_UNIT;
}

static int32_t least(int32_t a, int32_t b)
{
    return a < b ? a : b;
}

static int32_t most(int32_t a, int32_t b)
{
    return a > b ? a : b;
}

/* Return by how much a current exceeds, away from zero, the larger of two others on the same side of zero. */
static uint32_t excess_of(int32_t current, int32_t low, int32_t other_low, int32_t high, int32_t other_high)
{
    if (current > 0)
        return current > high && current > other_high ? distance_of(current, most(0, most(high, other_high))) : 0;
    return current < low && current < other_low ? distance_of(current, least(0, least(low, other_low))) : 0;
}

/* Round to the nearest whole number, halves away from zero. */
static int32_t whole(int32_t value, int32_t unit)
{
    const int32_t size = (int32_t)((size_of(value) + (uint32_t)unit / 2u) / (uint32_t)unit);
    return value < 0 ? -size : size;
}

/* Set the output of each lag to a current. */
static void begin_at(struct current_check *check, int16_t current)
{
    check->expected = check->quick_low = check->quick_high = check->slow_low = check->slow_high = current * CURRENT_UNIT;
}

void current_configure(struct current_check *check, const struct board *board, uint32_t rate)
{
    const struct current_sensor *sensor = &board->current_sensor;
    const uint32_t ticks = rate / WINDOWS_A_SECOND;
    const double back_emf = floor(sensor->back_emf * rate * 256.0 + 0.5);
    check->decay = share_of(sensor->lag_s, rate);
    check->speed_decay = share_of(SPEED_LAG_S, rate);
    check->late = late_part(sensor->lag_s, rate);
    check->quick_decay = share_of(0.5 * sensor->lag_s, rate);
    check->slow_decay = share_of(2.0 * sensor->lag_s, rate);
    check->back_emf = back_emf < 2147483647.0 ? (uint32_t)back_emf : 2147483647u;
    check->encoder_sign = board->encoder_sign;
    check->ticks = (uint16_t)(ticks > FEWEST_TICKS ? ticks : FEWEST_TICKS);
    const double noise = ceil(SIGMAS * sensor->noise * check->ticks);
    check->noise = sensor->noise >= 0.0 && noise < (double)UINT32_MAX ? (uint32_t)noise : UINT32_MAX;
    check->largest_zero = board->over_current * ZERO_UNIT / ZERO_SHARE;
    delay_line_configure(&check->line, sensor->delay_s * rate);
    begin_at(check, 0);
    current_forget(check);
}

static void begin_window(struct current_check *check)
{
    check->last_largest = check->back_emf != 0 ? check->largest : 0;
    check->passed = 0;
    check->difference = 0;
    check->largest = 0;
    check->sum = 0;
}

void current_forget(struct current_check *check)
{
    begin_window(check);
    check->last_largest = 0;
    check->known = 0;
    check->speed = check->moved = check->left = check->before = check->smooth = 0;
    check->quick_low_left = check->quick_high_left = check->slow_low_left = check->slow_high_left = 0;
    /* Earlier active currents are unknown and still in the delay line; with back-EMF a previous count is needed too. */
    check->awaited = (uint16_t)(check->line.reach + (check->back_emf != 0 ? 1u : 0u));
}

static int32_t clip(int32_t value, int32_t most)
{
    return value > most ? most : value < -most ? -most : value;
}

int16_t current_subtract_zero(struct current_check *check, int16_t measured, bool off)
{
    if (off) {
        const int32_t step = (measured * ZERO_UNIT - check->zero) / ZERO_TICKS;
        check->zero = clip(check->zero + step, check->largest_zero);
    }
    return (int16_t)clip(measured - whole(check->zero, ZERO_UNIT), INT16_MAX);
}

/* A share (1/65536) of a difference, rounded down: 25 cycles a tick less on a Cortex-M0+ than towards zero. */
static int32_t part(int32_t difference, uint32_t share)
{
    /* In two halves, for processors without a wide product. */
    return (difference >> 16) * (int32_t)share + (int32_t)(((uint32_t)difference & 0xFFFFu) * share >> 16);
}

/* Advance the output of a first-order lag by one tick. */
static int32_t follow(int32_t *behind, int32_t before, uint32_t share)
{
    *behind += part(before - *behind, share);
    return *behind;
}

/* Return the current that back-EMF subtracts under voltage drive. */
static int32_t back_emf(struct current_check *check, int32_t count)
{
    const int64_t counts = (int64_t)count - check->count;
    const int32_t step = (int32_t)(counts > MOST_COUNTS ? MOST_COUNTS : counts < -MOST_COUNTS ? -MOST_COUNTS : counts);
    check->count = count;
    const int32_t change = part(step * COUNT - check->speed, check->speed_decay);
    check->speed += change;
    follow(&check->moved, check->speed - part(change, check->late), check->decay);
    const uint64_t wide = wide_shift(wide_product(size_of(check->moved), check->back_emf), 8u);
    const int32_t size = wide < (uint64_t)MOST ? (int32_t)wide : MOST;
    return (check->moved > 0) == (check->encoder_sign > 0) ? size : -size;
}

/* Smooth the residual without back-EMF, and the expected current, with the lag of the speed. */
static void smooth(struct current_check *check, int16_t measured)
{
    const int32_t left = measured * CURRENT_UNIT - check->expected;
    /* Of a tick's speed it is the middle that follows; in the first tick all of it comes behind the lag. */
    const int32_t middle = left - part(left - check->before, check->known == 1u ? check->late : HALF);
    check->before = left;
    check->known = 2;
    follow(&check->left, middle, check->speed_decay);
    follow(&check->smooth, check->expected, check->speed_decay);
}

bool current_disagrees(struct current_check *check, int32_t count, int16_t active, int16_t measured)
{
    if (check->noise == UINT32_MAX)
        return false;
    /* Without a delay the line stays empty and highest is lowest: saves 200 of a Cortex-M0+'s 3200 cycles a tick. */
    const bool delays = check->line.reach > 0;
    if (delays)
        delay_line_put(&check->line, active);
    if (check->awaited > 0) {
        /* Residual and back-EMF have the same lag from here on, at any speed. */
        check->count = count;
        check->known = 1;
        check->awaited--;
        begin_at(check, measured);
        return false;
    }
    int32_t low = active * CURRENT_UNIT, high = low, middle = low;
    if (delays)
        middle = delay_line_look(&check->line, &low, &high);
    int32_t expected = follow(&check->expected, middle, check->decay);
    int32_t quick_low = follow(&check->quick_low, low, check->quick_decay) - expected;
    int32_t slow_low = follow(&check->slow_low, low, check->slow_decay) - expected;
    int32_t quick_high = quick_low, slow_high = slow_low;
    if (delays) {
        quick_high = follow(&check->quick_high, high, check->quick_decay) - expected;
        slow_high = follow(&check->slow_high, high, check->slow_decay) - expected;
    }
    int32_t left = measured * CURRENT_UNIT - expected;
    const uint32_t here = distance_of(left, 0);
    check->largest = here > check->largest ? here : check->largest;
    if (check->back_emf != 0) {
        const int32_t moving = back_emf(check, count);
        smooth(check, measured);
        left = check->left + moving;
        expected = check->smooth - moving;
        quick_low = follow(&check->quick_low_left, quick_low, check->speed_decay);
        slow_low = follow(&check->slow_low_left, slow_low, check->speed_decay);
        quick_high = delays ? follow(&check->quick_high_left, quick_high, check->speed_decay) : quick_low;
        slow_high = delays ? follow(&check->slow_high_left, slow_high, check->speed_decay) : slow_low;
    }
    check->difference += excess_of(left, quick_low, slow_low, quick_high, slow_high);
    check->sum += distance_of(expected, 0);
    if (++check->passed < check->ticks)
        return false;
    const uint32_t spike = check->largest > check->last_largest ? check->largest : check->last_largest;
    const uint32_t difference = check->difference > spike ? check->difference - spike : 0, sum = check->sum;
    begin_window(check);
    return difference > check->noise && difference * SHARE > sum;
}
