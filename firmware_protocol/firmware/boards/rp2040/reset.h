/* The hardware watchdog, and why the board has started. */
#ifndef RP2040_RESET_H
#define RP2040_RESET_H

#include <stdbool.h>
#include <stdint.h>

/* Whether it was our watchdog that has bitten, and where the processor had stopped, or 0. A brown-out is a power-up:
 * nothing that was there before is left. */
bool reset_by_watchdog(uint32_t *stopped_at);

/* Keep an address over the watchdog's reset. */
void processor_stopped(uint32_t at);

/* Reset everything, and let the boot ROM show its drive. */
void reset_to_bootloader(void);

/* From here on, reset everything so long (µs) after the last feed. */
void watchdog_start(uint32_t bite_us);
void watchdog_feed_hardware(uint32_t bite_us);

#endif
