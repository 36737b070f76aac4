/* Where the board's time comes from: one crystal of 12 MHz. */
#ifndef RP2040_CLOCKS_H
#define RP2040_CLOCKS_H

#include <stdint.h>

#define CLOCK_HZ 125000000u /* of the processor and all that hangs on its bus */

/* Start the crystal, 125 MHz for the processor, 48 MHz for USB and ADC, 1 MHz for timer and watchdog. */
void clocks_start(void);

/* Take blocks (RESET_… bits) out of reset. */
void clocks_release(uint32_t blocks);

#endif
