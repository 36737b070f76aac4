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

/* Set zero current and wait for the host's next command: after ARM, after STOP. */
void watchdog_idle(struct watchdog *watchdog, uint64_t now);

/* Take a valid command; times in device time. */
void watchdog_feed(struct watchdog *watchdog, uint64_t now, int16_t current, uint32_t lifetime, uint32_t ramp);

/* The current for a tick that ends at `until`, when `active` flowed in the last one. */
int16_t watchdog_choose(struct watchdog *watchdog, uint64_t until, int16_t active);

/* The same for a law that the command supervises and that wants `current` now. */
int16_t watchdog_fade(struct watchdog *watchdog, uint64_t until, int16_t current);

#endif
