#include "reset.h"

#include <stdint.h>

#include "registers.h"

/* The boot ROM ends a download by a watchdog reset of its own; this says that the watchdog was ours. The scratch registers are
 * cleared by power-up alone (4.7.5). */
#define OURS 0x48525744u

bool reset_by_watchdog(void)
{
    const bool bitten = WATCHDOG_REASON != 0 && WATCHDOG_SCRATCH0 == OURS;
    WATCHDOG_SCRATCH0 = 0;
    return bitten;
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
