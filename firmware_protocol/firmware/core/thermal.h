/* I²t: the winding's temperature rise as a first-order lag of the squared current, in quanta². */
#ifndef HR_THERMAL_H
#define HR_THERMAL_H

#include <stdbool.h>
#include <stdint.h>

struct thermal {
    uint64_t heat;    /* quanta², in 1/2³² */
    uint64_t budget;  /* the same: the rise that continuous_current gives in the end */
    uint64_t cut;     /* 1.25 budgets; without a budget, never */
    uint32_t decay;   /* share of a tick, times 2^shift */
    uint8_t shift;    /* 32 … 60 */
};

/* Set the budget, and the lag for `rate` ticks a second. A motor does not cool by being configured: the heat
 * stays. */
void thermal_configure(struct thermal *thermal, uint16_t continuous_current, float time_constant_s, uint32_t rate);

/* Let one tick of the measured current pass. */
void thermal_update(struct thermal *thermal, int16_t measured);

/* Return true if the budget is used up: reduce the current. */
static inline bool thermal_is_spent(const struct thermal *thermal)
{
    return thermal->heat >= thermal->budget;
}

/* Return true if the heat is so far above the budget that reducing has failed. */
static inline bool thermal_is_overheated(const struct thermal *thermal)
{
    return thermal->heat > thermal->cut;
}

#endif
