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

/* The index pulses that have begun, and the count at the last. Somebody has to look for them between two ticks: the count is
 * that of the look, so exact as long as no further edge comes in between. */
void encoder_look_for_index(void);
uint32_t encoder_index_edges(int32_t *count);

/* Device time of the last rising edge of the sync input; 0 before the first. */
uint64_t encoder_sync_time(void);

#endif
