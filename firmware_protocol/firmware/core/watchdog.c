/* Effort is held over a tick, so everything is judged at the tick's end: the current is exactly zero when the
 * ramp ends, not a tick later. The ramp begins at the limited command, so that it falls in every
 * tick. A law on the device continues while its command fades: the ramp then scales its output. */
#include "watchdog.h"

#include "protocol.h"

/* Time for the first command after ARM, and for DISARM after STOP: half a second, at zero current. */
#define IDLE_LIFETIME (500000u * HR_TIME_UNITS_PER_US)

void watchdog_idle(struct watchdog *watchdog, uint64_t now)
{
    watchdog->lost = false;
    watchdog_feed(watchdog, now, 0, IDLE_LIFETIME, 0);
}

void watchdog_feed(struct watchdog *watchdog, uint64_t now, int16_t current, uint32_t lifetime, uint32_t ramp)
{
    watchdog->current = current;
    watchdog->expires = now + lifetime;
    watchdog->ramp = ramp;
    watchdog->applied = false;
    watchdog->ramping = false;
}

/* current * left / ramp, towards zero: bit by bit of the current, because a division of 64 bits takes a small processor
 * longer than it has in a tick. `left` is below `ramp`, and that below 2³⁰. */
static int16_t share(int16_t current, uint32_t left, uint32_t ramp)
{
    const uint32_t size = current < 0 ? 0u - (uint32_t)current : (uint32_t)current;
    uint32_t quotient = 0, rest = 0;
    for (uint32_t bit = UINT32_C(1) << 15; bit > 0; bit >>= 1) {
        quotient <<= 1;
        rest <<= 1;
        if (size & bit)
            rest += left;
        for (; rest >= ramp; rest -= ramp) /* twice at most */
            quotient++;
    }
    return (int16_t)(current < 0 ? -(int32_t)quotient : (int32_t)quotient);
}

int16_t watchdog_choose(struct watchdog *watchdog, uint64_t until, int16_t active)
{
    if (until <= watchdog->expires) {
        watchdog->applied = true;
        return watchdog->current;
    }
    if (!watchdog->ramping) {
        watchdog->ramping = true;
        watchdog->from = watchdog->applied ? active : watchdog->current;
    }
    const uint64_t end = watchdog->expires + watchdog->ramp;
    if (until >= end) {
        watchdog->lost = true;
        return 0;
    }
    return share(watchdog->from, (uint32_t)(end - until), watchdog->ramp);
}

int16_t watchdog_fade(struct watchdog *watchdog, uint64_t until, int16_t current)
{
    if (until <= watchdog->expires)
        return current;
    watchdog->ramping = true;
    const uint64_t end = watchdog->expires + watchdog->ramp;
    if (until >= end) {
        watchdog->lost = true;
        return 0;
    }
    return share(current, (uint32_t)(end - until), watchdog->ramp);
}
