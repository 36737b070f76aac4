/* BATCH: every tick of a supervised law.
 *
 * A tick only appends its sample. CRC and stuffing are done between the ticks, piece by piece; a full frame waits in
 * the second buffer until it is packed and sent. */
#ifndef HR_BATCH_H
#define HR_BATCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "connection.h"
#include "faults.h"
#include "frame.h"
#include "protocol.h"

/* A frame, and how much of it has been packed. */
struct batch_frame {
    struct builder builder;
    uint16_t laid; /* end of the raw bytes so far */
    uint8_t bytes[HR_ENCODED_LIMIT + 1u];
};

struct batch {
    uint8_t layout;
    uint8_t most;    /* largest number of samples in a frame */
    uint8_t samples; /* in the present frame; 0: no frame is begun */
    uint8_t making;  /* index of the present frame in `frames` */
    bool waiting;    /* the other frame is queued for sending */
    bool follows;    /* `count` is that of tick `next` - 1 */
    uint32_t next;   /* tick that would follow without a gap */
    int32_t count;   /* of the last sample */
    struct batch_frame frames[2];
};

/* Set the layout and the number of samples in a frame (fewer if they do not fit). Discards samples that were not
 * sent. */
void batch_configure(struct batch *batch, uint8_t layout, uint8_t most);

/* Discard the last sample and all frames that were not sent, at the beginning of a run. */
void batch_forget(struct batch *batch);

/* Return true if the sample of tick `index` can be appended to the present frame; if not, call batch_finish first. */
bool batch_fits(const struct batch *batch, uint32_t index);

/* Append the sample of a tick; the first sample begins a frame and gives its device time `time`. Returns false, and
 * appends nothing, if the difference of the counts does not fit the layout. */
bool batch_push(struct batch *batch, struct connection *connection, const struct fault_entry *sample, uint32_t time);

/* Return true if the present frame has no room for another sample. */
bool batch_is_full(const struct batch *batch);

/* Queue the present frame for sending, if it has samples. No other frame may be queued. */
void batch_finish(struct batch *batch);

/* Pack (CRC, stuffing) at most `most` more bytes of the queued frame, else of the present frame. Returns false if fewer
 * bytes are available. */
bool batch_pack(struct batch *batch, size_t most);

/* Pack the rest of the queued frame. Returns its `*count` bytes on the wire, valid until the frame after the next is
 * begun; NULL if no frame is queued. */
const uint8_t *batch_take(struct batch *batch, size_t *count);

#endif
