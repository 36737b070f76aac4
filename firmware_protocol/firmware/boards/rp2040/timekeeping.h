/* Device time, and the timer of the tick. Two slices of the PWM block, which no pin shows, all of one crystal:
 *
 * - slice 6 counts 16 MHz, 16 bits wide: device time itself. The microsecond timer says how often it has wrapped.
 * - slice 7 wraps once a tick and interrupts. Its period may alternate between two neighbouring numbers of cycles, so
 *   that any whole rate is kept exactly on average, and every tick to a cycle. */
#ifndef RP2040_TIMEKEEPING_H
#define RP2040_TIMEKEEPING_H

#include <stdbool.h>
#include <stdint.h>

#define TIME_SLICE 6u
#define TICK_SLICE 7u

/* A time in the hardware's format. DMA stores it when an edge comes. */
struct stamp {
    volatile uint32_t fine;   /* 1/16 µs, modulo 2¹⁶ */
    volatile uint32_t coarse; /* µs, modulo 2³² */
};

void time_start(void);

/* Device time now, 1/16 µs. Call it at most 4 ms after the last reading of the clock, and not from two places that may
 * interrupt each other. */
uint64_t time_now(void);

/* Read the clock, however long ago the last reading was. */
void time_look(void);

/* Device time of a stamp taken less than an hour ago. */
uint64_t time_of(uint32_t fine, uint32_t coarse);

/* Read a stamp that may be written meanwhile. */
void stamp_read(const struct stamp *stamp, uint32_t *fine, uint32_t *coarse);

/* Tick at this rate (Hz) from now on. False for one that the timer cannot keep. */
bool tick_set_rate(uint32_t rate);

/* Enable the interrupt; the first comes after a whole period or later. */
void tick_start(void);

/* In the interrupt: read the clock, acknowledge the tick, and set the length of the period after the next. */
void tick_taken(void);

/* Cycles of the processor until the next tick is due; 0 when it waits already. */
uint32_t tick_cycles_left(void);

#endif
