/* Reset and exceptions of a Cortex-M: Armv7-M Architecture Reference Manual, B1.5.3 (vector table) and B1.5.5 (reset). */
#include "mps2.h"

#include <stdint.h>

extern uint32_t data_begins, data_ends, data_image, bss_begins, bss_ends, stack_top;

#define CPACR (*(volatile uint32_t *)0xE000ED88u) /* B3.2.20: who may use the floating-point unit */
#define FULL_ACCESS_TO_CP10_AND_CP11 (0xFu << 20)

void start(void)
{
    const uint32_t *from = &data_image;
    for (uint32_t *word = &data_begins; word < &data_ends; word++)
        *word = *from++;
    for (uint32_t *word = &bss_begins; word < &bss_ends; word++)
        *word = 0;
#ifdef __ARM_FP
    CPACR |= FULL_ACCESS_TO_CP10_AND_CP11;
    __asm volatile("dsb\n\tisb" ::: "memory");
#endif
    main();
    for (;;)
        continue;
}

/* A fault of the processor: stop here, and let a board's watchdog reset it. */
static void stand_still(void)
{
    for (;;)
        continue;
}

/* For programs without a timer. */
__attribute__((weak)) void tick(void)
{
    stand_still();
}

typedef void (*handler)(void);

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    handler handlers[15];
} vectors = {
    .stack = &stack_top,
    .handlers =
        {
            start,                                              /* 1 reset */
            stand_still, stand_still, stand_still, stand_still, /* NMI, HardFault, MemManage, BusFault */
            stand_still, 0, 0, 0, 0, stand_still,               /* UsageFault, reserved, SVCall */
            stand_still, 0, stand_still, tick,                  /* debug, reserved, PendSV, 15 SysTick */
        },
};
