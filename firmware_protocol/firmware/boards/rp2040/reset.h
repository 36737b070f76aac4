/* The hardware watchdog, and why the board has started. */
#ifndef RP2040_RESET_H
#define RP2040_RESET_H

#include <stdbool.h>

/* Whether it was our watchdog that has bitten. A brown-out is a power-up: nothing that was there before is left. */
bool reset_by_watchdog(void);

/* From here on, reset everything 40 ms after the last feed. */
void watchdog_start(void);
void watchdog_feed_hardware(void);

#endif
