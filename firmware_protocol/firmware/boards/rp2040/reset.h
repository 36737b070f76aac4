/* The hardware watchdog, and why the board has started. */
#ifndef RP2040_RESET_H
#define RP2040_RESET_H

#include <stdbool.h>
#include <stdint.h>

/* Return true after a reset by this program's watchdog, with the address at which the processor had stopped, or 0. A
 * brown-out counts as a power-up: it clears the scratch registers. */
bool reset_by_watchdog(uint32_t *stopped_at);

/* Keep an address over the watchdog's reset. */
void processor_stopped(uint32_t at);

/* Reset everything, and let the boot ROM show its drive. */
void reset_to_bootloader(void);

/* Feed the watchdog: it resets everything this long (µs) after the last feed. */
void watchdog_start(uint32_t bite_us);
void watchdog_feed_hardware(uint32_t bite_us);

#endif
