/* The active command, and how it fades once its lifetime is over. */
#ifndef HR_WATCHDOG_H
#define HR_WATCHDOG_H

#include <stdbool.h>
#include <stdint.h>

struct watchdog {
    int16_t current; /* quanta */
    int16_t from;    /* where the ramp begins */
    uint32_t ramp;   /* device time */
    uint64_t expires;
    bool applied; /* the command has been active for a tick */
    bool ramping; /* its lifetime is over */
    bool lost;    /* the ramp has ended: latch LINK_LOST */
};

/* Set the current to zero and wait for the host's next command, after ARM and after STOP. */
void watchdog_idle(struct watchdog *watchdog, uint64_t now);

/* Store a valid command; times are device times. */
void watchdog_feed(struct watchdog *watchdog, uint64_t now, int16_t current, uint32_t lifetime, uint32_t ramp);

/* Return the current for a tick that ends at `until`; `active` is the current of the last tick. */
int16_t watchdog_choose(struct watchdog *watchdog, uint64_t until, int16_t active);

/* Return the current for a tick of a law that the command supervises; `current` is the law's result for the tick. */
int16_t watchdog_fade(struct watchdog *watchdog, uint64_t until, int16_t current);

#endif
