/* In integers: a Cortex-M0+ does a double multiplication in a hundred cycles, and this runs in every tick. The
 * decay is a mantissa of 32 bits with its own exponent, for it spans 2⁻²⁹ … 2⁻³; the heat has 32 bits behind the
 * point, so that even the slowest motor at the highest rate has no rounding loss. The relative difference to the same
 * computation in doubles is below 1e-6. */
#include "thermal.h"

#include <math.h>

#include "wide.h"

#define FRACTION_BITS 32u
#define MANTISSA_END 4294967296.0

void thermal_configure(struct thermal *thermal, uint16_t continuous_current, float time_constant_s, uint32_t rate)
{
    double decay = -expm1(-1.0 / (rate * (double)time_constant_s)) * MANTISSA_END;
    uint8_t shift = FRACTION_BITS;
    while (decay < MANTISSA_END / 2.0 && shift < 60u) {
        decay *= 2.0;
        shift++;
    }
    thermal->decay = (uint32_t)decay;
    thermal->shift = shift;
    thermal->budget = (uint64_t)continuous_current * continuous_current << FRACTION_BITS;
    thermal->cut = thermal->budget > 0 ? thermal->budget + thermal->budget / 4u : UINT64_MAX;
}

/* Of 96 bits of a product those above `shift`; rounded down. */
static uint64_t scale(uint64_t value, uint32_t mantissa, uint8_t shift)
{
    const uint64_t low = wide_product((uint32_t)(value & UINT32_MAX), mantissa);
    const uint64_t high = wide_product((uint32_t)(value >> 32), mantissa) + (low >> 32);
    return wide_shift(high, shift - 32u);
}

void thermal_update(struct thermal *thermal, int16_t measured)
{
    const int32_t square = (int32_t)measured * measured;
    const uint64_t aim = (uint64_t)square << FRACTION_BITS;
    if (aim >= thermal->heat)
        thermal->heat += scale(aim - thermal->heat, thermal->decay, thermal->shift);
    else
        thermal->heat -= scale(thermal->heat - aim, thermal->decay, thermal->shift);
}
