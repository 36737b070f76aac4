/* The hardware watchdog, and why the board has started. */
#ifndef RP2040_RESET_H
#define RP2040_RESET_H

#include <stdbool.h>
#include <stdint.h>

/* Whether it was our watchdog that has bitten. A brown-out is a power-up: nothing that was there before is left. */
bool reset_by_watchdog(void);

/* From here on, reset everything so long (µs) after the last feed. */
void watchdog_start(uint32_t bite_us);
void watchdog_feed_hardware(uint32_t bite_us);

#endif
