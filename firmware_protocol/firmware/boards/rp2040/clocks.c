#include "clocks.h"

#include "registers.h"
#include "start.h"

/* 2.16.3: 47 · 256 cycles of 12 MHz are 1 ms. Slow crystals take several, so that the maker's SDK waits six. */
#define CRYSTAL_START_DELAY (6u * 47u)
#define CRYSTAL_MHZ 12u
#define SETTLES_US 1000u

/* 2.10.2: 1.15 V. Raspberry Pi has certified 200 MHz at that voltage (release notes of its SDK 2.1.1, 2025-02-19). */
#define VOLTS_1_15 0xCu

/* 2.18.2: 12 MHz · feedback / (first · second). */
AT_START static void start_pll(uint32_t pll, uint32_t feedback, uint32_t first, uint32_t second)
{
    PLL_CONTROL(pll) = 1; /* the crystal, not divided */
    PLL_FEEDBACK(pll) = feedback;
    CLEAR_BITS(pll + PLL_POWER) = PLL_POWER_MAIN | PLL_POWER_OSCILLATOR;
    while (!(PLL_CONTROL(pll) & PLL_LOCKED))
        continue;
    PLL_POST_DIVIDERS(pll) = first << 16 | second << 12;
    CLEAR_BITS(pll + PLL_POWER) = PLL_POWER_POST_DIVIDERS;
}

#ifdef BOARD_CLOCK_200MHZ
/* The processor runs on the crystal here. A crystal that runs already, as behind a watchdog's reset or the boot ROM's
 * own, gives the regulator no time by itself. 2.10.6: the voltage is in regulation; then a millisecond more. */
AT_START static void wait_for_regulator(void)
{
    while (!(REGULATOR & REGULATOR_IN_REGULATION))
        continue;
    for (uint32_t turns = SETTLES_US * CRYSTAL_MHZ / 3u; turns > 0; turns--)
        __asm volatile("" ::: "memory"); /* a turn takes three cycles at least */
}
#endif

AT_START void clocks_start(void)
{
    CLOCK_RESUSCITATION = 0;
#ifdef BOARD_CLOCK_200MHZ
    REGULATOR = VOLTS_1_15 << 4 | REGULATOR_ON;
#endif
    CRYSTAL_STARTUP = CRYSTAL_START_DELAY;
    CRYSTAL_CONTROL = CRYSTAL_ENABLE_1_TO_15_MHZ;
    while (!(CRYSTAL_STATUS & CRYSTAL_STABLE))
        continue;
    /* Off the loops, which a debugger may have left running, before they are set up. */
    CLOCK_SYSTEM_CONTROL = SYSTEM_FROM_REFERENCE;
    while (!(CLOCK_SYSTEM_SELECTED & (1u << SYSTEM_FROM_REFERENCE)))
        continue;
    CLOCK_REFERENCE_CONTROL = REFERENCE_FROM_CRYSTAL;
    while (!(CLOCK_REFERENCE_SELECTED & (1u << REFERENCE_FROM_CRYSTAL)))
        continue;
    CLOCK_REFERENCE_DIVIDER = CLOCK_DIVIDED_BY_ONE;
#ifdef BOARD_CLOCK_200MHZ
    wait_for_regulator();
#endif
    SET_BITS(RESETS) = RESET_PLL_SYS | RESET_PLL_USB;
    clocks_release(RESET_PLL_SYS | RESET_PLL_USB);
#ifdef BOARD_CLOCK_200MHZ
    start_pll(PLL_SYSTEM, 100, 6, 1); /* 1200 MHz, 200 MHz */
#else
    start_pll(PLL_SYSTEM, 125, 6, 2); /* 1500 MHz, 125 MHz */
#endif
    start_pll(PLL_USB, 100, 5, 5);    /* 1200 MHz, 48 MHz */
    CLOCK_SYSTEM_DIVIDER = CLOCK_DIVIDED_BY_ONE;
    CLOCK_SYSTEM_CONTROL = SYSTEM_FROM_PLL;
    while (!(CLOCK_SYSTEM_SELECTED & (1u << SYSTEM_FROM_PLL)))
        continue;
    /* Auxiliary source 0: the processor's clock for the peripherals, the USB loop for USB and ADC. */
    CLOCK_PERIPHERALS_CONTROL = CLOCK_ENABLE;
    CLOCK_USB_DIVIDER = CLOCK_DIVIDED_BY_ONE;
    CLOCK_USB_CONTROL = CLOCK_ENABLE;
    CLOCK_ADC_DIVIDER = CLOCK_DIVIDED_BY_ONE;
    CLOCK_ADC_CONTROL = CLOCK_ENABLE;
    WATCHDOG_TICK = CRYSTAL_MHZ | WATCHDOG_TICK_ENABLE; /* 4.7.2: also the timer's microsecond */
}
