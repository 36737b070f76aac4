#include "reset.h"

#include <stdint.h>

#include "registers.h"

/* The boot ROM ends a download by a watchdog reset too; this value marks a reset by this program's watchdog. Only a
 * power-up clears the scratch registers (4.7.5). */
#define OURS 0x48525744u

#define BOOTLOADER_WANTED 0x544F4F42u /* start.S */

bool reset_by_watchdog(uint32_t *stopped_at)
{
    const bool bitten = WATCHDOG_REASON != 0 && WATCHDOG_SCRATCH0 == OURS;
    *stopped_at = bitten ? WATCHDOG_SCRATCH2 : 0u;
    WATCHDOG_SCRATCH0 = 0;
    WATCHDOG_SCRATCH2 = 0;
    return bitten;
}

void reset_to_bootloader(void)
{
    WATCHDOG_SCRATCH0 = 0; /* what runs next was not bitten */
    WATCHDOG_SCRATCH1 = BOOTLOADER_WANTED;
    WATCHDOG_CONTROL = WATCHDOG_TRIGGER;
}

void processor_stopped(uint32_t at)
{
    WATCHDOG_SCRATCH2 = at;
}

void watchdog_start(uint32_t bite_us)
{
    WATCHDOG_CONTROL = 0;
    PSM_WATCHDOG_SELECT = PSM_ALL & ~PSM_OSCILLATORS; /* pins and peripherals with it: the amplifier's enable falls */
    WATCHDOG_SCRATCH0 = OURS;
    watchdog_feed_hardware(bite_us);
    WATCHDOG_CONTROL = WATCHDOG_ENABLE;
}

/* 4.7.2, and erratum RP2040-E1: it counts down twice a microsecond. */
void watchdog_feed_hardware(uint32_t bite_us)
{
    WATCHDOG_LOAD = bite_us * 2u;
}
