/* BATCH: every tick of a supervised law, packed as it happens.
 *
 * A frame is stuffed and its CRC computed sample by sample, so that no tick pays for a whole frame: the raw frame lies
 * one byte behind its beginning, where only zeros are replaced. */
#ifndef HR_BATCH_H
#define HR_BATCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "connection.h"
#include "protocol.h"

struct batch_sample {
    uint32_t index;       /* of the tick */
    uint32_t device_time; /* 1/16 µs */
    int32_t count;
    int16_t current_commanded;
    int16_t current_measured;
};

struct batch {
    uint8_t layout;
    uint8_t most;       /* samples in a frame */
    uint8_t samples;    /* in the frame that is being made; 0: none is */
    bool follows;       /* `count` is that of tick `next` - 1 */
    uint32_t next;      /* tick that would follow without a gap */
    int32_t count;      /* of the last sample */
    uint32_t crc;       /* of the raw frame so far */
    size_t end;         /* bytes so far */
    size_t code;        /* where the distance to the next zero goes */
    uint8_t bytes[HR_ENCODED_LIMIT + 1u];
};

/* Set the layout, and how many samples a frame takes, if it holds as many. Forgets what was not sent. */
void batch_configure(struct batch *batch, uint8_t layout, uint8_t most);

/* Forget the last sample and a frame that is being made: a run begins. */
void batch_forget(struct batch *batch);

/* Whether a sample can be appended to the frame that is being made; if not, finish that first. */
bool batch_fits(const struct batch *batch, const struct batch_sample *sample);

/* Append a sample; the first begins a frame of the session. False, and nothing is appended, when the difference of
 * counts does not fit the layout. */
bool batch_push(struct batch *batch, struct connection *connection, const struct batch_sample *sample);

/* Whether the frame is full. */
bool batch_is_full(const struct batch *batch);

/* Finish the frame that is being made: returns its bytes on the wire, from batch->bytes; 0 when there is none. */
size_t batch_finish(struct batch *batch);

#endif
