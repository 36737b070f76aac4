/* Pins, and what is wired to them but for encoder, amplifier and link. */
#ifndef RP2040_PINS_H
#define RP2040_PINS_H

#include <stdbool.h>
#include <stdint.h>

/* Inputs of switches, encoder and sync; outputs of sync. Everything else stays as reset left it: pulled down. */
void pins_start(void);

/* Return bits of enum hr_input. A broken wire reads as stop pressed, hold-to-run released and limit switch pressed. */
uint8_t pins_inputs(void);

/* Show bits of enum hr_sync. */
void pins_sync(uint8_t bits);

/* Give a pin to a peripheral. */
void pin_function(uint32_t pin, uint32_t function);

/* Drive a pin, low at first. */
void pin_output(uint32_t pin);

void pin_write(uint32_t pin, bool high);

#endif
