/* The quadrature encoder, four counts a line, counted by PIO0 without the processor. */
#ifndef RP2040_ENCODER_H
#define RP2040_ENCODER_H

#include <stdbool.h>
#include <stdint.h>

/* Start the state machines, and the DMA that stores the time of each edge. No other file sets up these. */
void encoder_start(void);

int32_t encoder_count(void);

/* Return the device time of the last encoder edge; 0 before the first. */
uint64_t encoder_edge_time(void);

/* Return true if both channels have changed at the same moment since the last call. */
bool encoder_failed(void);

/* Return the number of index pulses so far and the count at the last one. The main loop must call
 * encoder_look_for_index between two ticks: the count is read in that call, so it is exact while no further edge comes
 * in between. */
void encoder_look_for_index(void);
uint32_t encoder_index_edges(int32_t *count);

/* Return the device time of the last rising edge of the sync input; 0 before the first. */
uint64_t encoder_sync_time(void);

#endif
