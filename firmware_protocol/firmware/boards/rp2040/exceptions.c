/* Exceptions and interrupts of the processor (2.3.2 "Interrupts"; Armv6-M Architecture Reference Manual, B1.5). */
#include <stdint.h>

#include "board_config.h"
#include "registers.h"
#include "reset.h"

typedef void (*handler)(void);

extern uint32_t stack_top;
void start(void);
void tick_interrupt(void);
void usb_interrupt(void);

/* An exception that should not occur: switch the amplifier off, then wait for the watchdog to reset the board. */
__attribute__((noreturn)) static void stand_still(void)
{
    SIO_OUT_CLEAR = 1u << BOARD_ENABLE_PIN;
    __asm volatile("cpsid i" ::: "memory");
    for (;;)
        continue;
}

__attribute__((weak)) void usb_interrupt(void)
{
    stand_still();
}

/* HardFault: an M0+ has no register with its cause, so the address is stored. `place` is the address of the
 * instruction that faulted. */
__attribute__((used, noreturn)) void hard_fault_at(uint32_t at)
{
    processor_stopped(at);
    stand_still();
}

__attribute__((naked)) static void hard_fault(void)
{
    __asm volatile("ldr r0, [sp, #24]\n" /* of the frame that the processor has laid down: B1.5.6 */
                   "ldr r1, =hard_fault_at\n"
                   "bx r1\n"
                   ".ltorg");
}

#define S stand_still

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    handler exceptions[15];
    handler interrupts[32];
} vectors = {
    .stack = &stack_top,
    .exceptions = {start, S, hard_fault, S, S, S, S, S, S, S, S, S, S, S, S},
    .interrupts =
        {
            S, S, S, S, tick_interrupt, usb_interrupt, S, S, /* 4: PWM_IRQ_WRAP, 5: USBCTRL_IRQ */
            S, S, S, S, S, S, S, S, S, S, S, S, S, S, S, S, S, S, S, S, S, S, S, S,
        },
};
