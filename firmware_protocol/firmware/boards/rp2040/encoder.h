/* The quadrature encoder, four counts a line, counted by PIO0 without the processor. */
#ifndef RP2040_ENCODER_H
#define RP2040_ENCODER_H

#include <stdbool.h>
#include <stdint.h>

/* Which edges a state machine waits for, and which stamp the DMA takes down behind it, is decided here alone. */
void encoder_start(void);

int32_t encoder_count(void);

/* Device time of the last edge; 0 before the first. */
uint64_t encoder_edge_time(void);

/* Whether both channels have changed at once since the last question. */
bool encoder_failed(void);

/* Device time of the last rising edge of the sync input; 0 before the first. */
uint64_t encoder_sync_time(void);

#endif
