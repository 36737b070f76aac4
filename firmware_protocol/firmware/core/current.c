/* The active current passes through the amplifier's lag; under voltage drive the back-EMF is taken off before it, from
 * the count's own speed. What is left between that and the measured current is added up over a window, by magnitude, so
 * that neither an oscillation nor noise averages it away, and compared with the larger of the sensor's noise and a tenth
 * of the current that was expected. The host has the same rule (rig/control/current.py), bit by bit. */
#include "current.h"

#include <math.h>

#include "wide.h"

#define WINDOWS_A_SECOND 100u /* of 10 ms */
#define FEWEST_TICKS 4u
#define SIGMAS 4.0
#define SHARE 10u
#define SPEED_LAG_S 2.5e-3
#define UNIT 16384
#define MOST (32767 * UNIT)
#define MOST_COUNTS 32767
#define ZERO_TICKS 64
#define ZERO_SHARE 16
#define ZERO_UNIT 256

/* Share of the way that a first-order lag goes in a tick. */
static uint32_t share_of(double lag_s, uint32_t rate)
{
    return lag_s > 0.0 ? (uint32_t)floor(-expm1(-1.0 / (rate * lag_s)) * 65536.0 + 0.5) : 65536u;
}

void current_configure(struct current_check *check, const struct board *board, uint32_t rate)
{
    const struct current_sensor *sensor = &board->current_sensor;
    const uint32_t ticks = rate / WINDOWS_A_SECOND;
    const double back_emf = floor(sensor->back_emf * rate * 256.0 + 0.5);
    check->decay = share_of(sensor->lag_s, rate);
    check->speed_decay = share_of(SPEED_LAG_S, rate);
    check->back_emf = back_emf < 2147483647.0 ? (uint32_t)back_emf : 2147483647u;
    check->encoder_sign = board->encoder_sign;
    check->ticks = (uint16_t)(ticks > FEWEST_TICKS ? ticks : FEWEST_TICKS);
    const double noise = ceil(SIGMAS * sensor->noise * check->ticks);
    check->noise = sensor->noise >= 0.0 && noise < (double)UINT32_MAX ? (uint32_t)noise : UINT32_MAX;
    check->largest_zero = board->over_current * ZERO_UNIT / ZERO_SHARE;
    check->expected = 0;
    current_forget(check);
}

void current_forget(struct current_check *check)
{
    check->passed = 0;
    check->difference = 0;
    check->sum = 0;
    check->known = false;
    check->speed = 0;
}

static int32_t clipped(int32_t value, int32_t most)
{
    return value > most ? most : value < -most ? -most : value;
}

static uint32_t size_of(int32_t value)
{
    return value < 0 ? (uint32_t)-value : (uint32_t)value;
}

/* To the nearest whole number, halves away from zero. */
static int32_t whole(int32_t value, int32_t unit)
{
    const int32_t size = (int32_t)((size_of(value) + (uint32_t)unit / 2u) / (uint32_t)unit);
    return value < 0 ? -size : size;
}

int16_t current_zeroed(struct current_check *check, int16_t measured, bool off)
{
    if (off) {
        const int32_t step = (measured * ZERO_UNIT - check->zero) / ZERO_TICKS;
        check->zero = clipped(check->zero + step, check->largest_zero);
    }
    return (int16_t)clipped(measured - whole(check->zero, ZERO_UNIT), INT16_MAX);
}

/* A share (1/65536) of a difference, towards zero. */
static int32_t part(int32_t difference, uint32_t share)
{
    const int32_t size = (int32_t)wide_shift(wide_product(size_of(difference), share), 16u);
    return difference > 0 ? size : -size;
}

/* Current that the motion takes off under voltage drive. */
static int32_t back_emf(struct current_check *check, int32_t count)
{
    int32_t step = 0;
    if (check->known) {
        const int64_t counts = (int64_t)count - check->count;
        step = (int32_t)(counts > MOST_COUNTS ? MOST_COUNTS : counts < -MOST_COUNTS ? -MOST_COUNTS : counts) * 4096;
    }
    check->count = count;
    check->known = true;
    check->speed += part(step - check->speed, check->speed_decay);
    const uint64_t wide = wide_shift(wide_product(size_of(check->speed), check->back_emf), 6u);
    const int32_t size = wide < 2u * (uint64_t)MOST ? (int32_t)wide : 2 * MOST;
    return (check->speed > 0) == (check->encoder_sign > 0) ? size : -size;
}

bool current_disagrees(struct current_check *check, int32_t count, int16_t active, int16_t measured)
{
    int32_t aim = active * UNIT;
    if (check->back_emf != 0) {
        const int64_t left = (int64_t)aim - back_emf(check, count);
        aim = (int32_t)(left > MOST ? MOST : left < -MOST ? -MOST : left);
    }
    check->expected += part(aim - check->expected, check->decay);
    const int32_t expected = whole(check->expected, UNIT);
    check->difference += size_of(measured - expected);
    check->sum += size_of(expected);
    if (++check->passed < check->ticks)
        return false;
    const uint32_t difference = check->difference, share = check->sum / SHARE;
    check->passed = 0;
    check->difference = 0;
    check->sum = 0;
    return check->noise < UINT32_MAX && difference > (share > check->noise ? share : check->noise);
}
