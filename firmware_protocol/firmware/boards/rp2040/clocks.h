/* Clocks of the board, all from one crystal of 12 MHz. */
#ifndef RP2040_CLOCKS_H
#define RP2040_CLOCKS_H

#include <stdint.h>

#include "board_config.h"
#include "registers.h"

/* Clock frequency of the processor and of the peripherals on its bus (Hz). */
#ifdef BOARD_CLOCK_200MHZ
#define CLOCK_HZ 200000000u
#else
#define CLOCK_HZ 125000000u
#endif

/* Start the crystal, the processor's clock, 48 MHz for USB and ADC, 1 MHz for timer and watchdog. Runs from the flash. */
void clocks_start(void);

/* Take peripherals (RESET_… bits) out of reset. Callers may be in flash or in RAM. */
static inline __attribute__((always_inline)) void clocks_release(uint32_t blocks)
{
    CLEAR_BITS(RESETS) = blocks;
    while ((RESETS_DONE & blocks) != blocks)
        continue;
}

#endif
