/* The set-point output of the board: the setting `output` selects output_pwm.c or output_dac.c. */
#ifndef RP2040_OUTPUT_H
#define RP2040_OUTPUT_H

#include <stdbool.h>
#include <stdint.h>

#include "board_config.h"

/* Largest set-point (quanta), the full scale of the output. */
#define MOST_QUANTA (BOARD_FULL_SCALE / BOARD_CURRENT_QUANTUM_A)
#define MOST ((uint32_t)(MOST_QUANTA < 32768.0 ? MOST_QUANTA : 32768.0))

/* Set-point of zero current. */
void output_start(void);

void output_set(int16_t quanta);

/* Return the set-point that was set last. */
int16_t output_active(void);

#ifdef BOARD_OUTPUT_DAC
/* Start the transfers to the converter; the wire enable, which holds it in reset while low, is high now. */
void output_begin(void);

/* Return true if no set-point was transferred since the last call. Called before each tick, it detects a stalled
 * transfer within two ticks. */
bool output_stalled(void);
#else
static inline void output_begin(void)
{
}

static inline bool output_stalled(void)
{
    return false;
}
#endif

#endif
