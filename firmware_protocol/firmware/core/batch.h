/* BATCH: every tick of a supervised law, packed as it happens.
 *
 * A frame is stuffed and its CRC computed sample by sample, so that no tick pays for a whole frame. One that is
 * finished waits beside the one that is being made until there is time to send it. */
#ifndef HR_BATCH_H
#define HR_BATCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "connection.h"
#include "faults.h"
#include "frame.h"
#include "protocol.h"

struct batch {
    uint8_t layout;
    uint8_t most;    /* samples in a frame */
    uint8_t samples; /* in the frame that is being made; 0: none is */
    uint8_t making;  /* which of both frames that is */
    bool begun;      /* it has its header, for tick `begun_index` */
    bool follows;    /* `count` is that of tick `next` - 1 */
    uint16_t ready;  /* bytes of the other frame that wait to be sent */
    uint32_t begun_index;
    uint32_t next;   /* tick that would follow without a gap */
    int32_t count;   /* of the last sample */
    struct builder builder;
    uint8_t frames[2][HR_ENCODED_LIMIT + 1u];
};

/* Set the layout, and how many samples a frame takes, if it holds as many. Forgets what was not sent. */
void batch_configure(struct batch *batch, uint8_t layout, uint8_t most);

/* Forget the last sample and what was not sent: a run begins. */
void batch_forget(struct batch *batch);

/* Begin a frame for the sample of a tick before it is there, so that the tick has less to do; false when there is nothing
 * to begin. */
bool batch_prepare(struct batch *batch, struct connection *connection, uint32_t index);

/* Whether the sample of a tick can be appended to the frame that is being made; if not, finish that first. */
bool batch_fits(const struct batch *batch, uint32_t index);

/* Append the sample of a tick; the first begins a frame of the session, with its device time. False, and nothing is
 * appended, when the difference of counts does not fit the layout. */
bool batch_push(struct batch *batch, struct connection *connection, const struct fault_entry *sample, uint32_t time);

/* Whether the frame is full. */
bool batch_is_full(const struct batch *batch);

/* Finish the frame that is being made, if there is one: batch->ready bytes of it wait at batch_frame, over one that
 * nobody has sent. */
void batch_finish(struct batch *batch);
const uint8_t *batch_frame(const struct batch *batch);

#endif
