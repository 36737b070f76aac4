/* BATCH: every tick of a supervised law.
 *
 * A tick lays its sample behind the others and no more. CRC and stuffing follow between the ticks, piece by piece; a
 * frame that is full waits beside the one that is being made until that is done and it is sent. */
#ifndef HR_BATCH_H
#define HR_BATCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "connection.h"
#include "faults.h"
#include "frame.h"
#include "protocol.h"

/* A frame, and what has been packed of it. */
struct batch_frame {
    struct builder builder;
    uint16_t laid; /* where its raw bytes end */
    uint8_t bytes[HR_ENCODED_LIMIT + 1u];
};

struct batch {
    uint8_t layout;
    uint8_t most;    /* samples in a frame */
    uint8_t samples; /* in the frame that is being made; 0: none is */
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

/* Whether the sample of a tick can be appended to the frame that is being made; if not, finish that first. */
bool batch_fits(const struct batch *batch, uint32_t index);

/* Append the sample of a tick; the first begins a frame of the session, with its device time. False, and nothing is
 * appended, when the difference of counts does not fit the layout. */
bool batch_push(struct batch *batch, struct connection *connection, const struct fault_entry *sample, uint32_t time);

/* Whether the frame is full. */
bool batch_is_full(const struct batch *batch);

/* Let the frame that is being made wait to be sent, if there is one. No other may wait. */
void batch_finish(struct batch *batch);

/* Pack at most so many bytes more: of the frame that waits, else of the one that is being made. False when there are not
 * as many. */
bool batch_pack(struct batch *batch, size_t most);

/* Pack the rest of the frame that waits: returns its bytes on the wire, `*count` of them, which stay until the next but one
 * is begun; NULL when none waits. */
const uint8_t *batch_take(struct batch *batch, size_t *count);

#endif
