/* The amplifier: the set-point, the current that flows, and the wire that switches it on. */
#ifndef RP2040_AMPLIFIER_H
#define RP2040_AMPLIFIER_H

#include <stdbool.h>
#include <stdint.h>

/* Start with a set-point of zero and the amplifier off. */
void amplifier_start(void);

void amplifier_set_current(int16_t quanta);
int16_t amplifier_measured_current(void);
void amplifier_enable(bool on);

#endif
