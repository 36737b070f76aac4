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
    uint16_t laid; /* end of its raw bytes */
    uint8_t bytes[HR_ENCODED_LIMIT + 1u];
};

struct batch {
    uint8_t layout;
    uint8_t most;    /* samples in a frame */
    uint8_t samples; /* in the frame that is being made; 0: no frame is begun */
    uint8_t making;  /* which of both frames that is */
    bool waiting;    /* the other is to be sent */
    bool follows;    /* `count` is that of tick `next` - 1 */
    uint32_t next;   /* tick that would follow without a gap */
    int32_t count;   /* of the last sample */
    struct batch_frame frames[2];
};

/* Set the layout, and how many samples a frame takes, if it holds as many. Forgets what was not sent. */
void batch_configure(struct batch *batch, uint8_t layout, uint8_t most);

/* Forget the last sample and what was not sent: a run begins. */
void batch_forget(struct batch *batch);

/* Return true if the sample of a tick can be appended to the frame that is being made; if not, finish that first. */
bool batch_fits(const struct batch *batch, uint32_t index);

/* Append the sample of a tick; the first begins a frame of the session, with its device time. False, and nothing is
 * appended, when the difference of counts does not fit the layout. */
bool batch_push(struct batch *batch, struct connection *connection, const struct fault_entry *sample, uint32_t time);

/* Return true if the frame is full. */
bool batch_is_full(const struct batch *batch);

/* Queue the frame that is being made, if one is begun. No other frame may be queued. */
void batch_finish(struct batch *batch);

/* Pack at most `most` bytes more: of the queued frame, else of the one that is being made. False when fewer are there. */
bool batch_pack(struct batch *batch, size_t most);

/* Pack the rest of the queued frame. Returns its bytes on the wire, `*count` of them, valid until the next but one is
 * begun; NULL when no frame is queued. */
const uint8_t *batch_take(struct batch *batch, size_t *count);

#endif
