/* How a set-point leaves the board: the setting `output` says which of the two files behind this is compiled. */
#ifndef RP2040_OUTPUT_H
#define RP2040_OUTPUT_H

#include <stdbool.h>
#include <stdint.h>

#include "board_config.h"

/* Quanta at full scale, as far as a set-point goes. */
#define MOST_QUANTA (BOARD_FULL_SCALE / BOARD_CURRENT_QUANTUM_A)
#define MOST ((uint32_t)(MOST_QUANTA < 32768.0 ? MOST_QUANTA : 32768.0))

/* No current. */
void output_start(void);

void output_set(int16_t quanta);

/* What was set last. */
int16_t output_active(void);

#ifdef BOARD_OUTPUT_DAC
/* From here on a converter that enable has held in reset accepts frames. */
void output_begin(void);

/* Whether no set-point has left since the last question. Asked before each tick, it notices within two. */
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
