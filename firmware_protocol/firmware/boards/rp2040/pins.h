/* Pins, and all that is wired to them except encoder, amplifier and link. */
#ifndef RP2040_PINS_H
#define RP2040_PINS_H

#include <stdbool.h>
#include <stdint.h>

/* Configure the inputs of switches, encoder and sync, and the sync outputs. All other pins stay pulled down, as after
 * reset. */
void pins_start(void);

/* Return bits of enum hr_input. A broken wire reads as stop pressed, hold-to-run released and limit switch pressed. */
uint8_t pins_inputs(void);

/* Set the sync outputs to bits of enum hr_sync. */
void pins_sync(uint8_t bits);

/* Connect a pin to a peripheral of the processor. */
void pin_function(uint32_t pin, uint32_t function);

/* Drive a pin, low at first. */
void pin_output(uint32_t pin);

void pin_write(uint32_t pin, bool high);

#endif
