#include "batch.h"

#include "bytes.h"

/* Bytes of one sample of each layout; see BATCH_LAYOUTS. */
static const uint8_t sample_bytes[] = {5, 3, 6};

enum { NARROW = 0, NO_MEASUREMENT = 1, WIDE = 2 };

void batch_configure(struct batch *batch, uint8_t layout, uint8_t most)
{
    const uint8_t room = (uint8_t)(HR_DATA_LIMIT_BATCH / sample_bytes[layout]);
    batch->layout = layout;
    batch->most = most < room ? most : room;
    batch_forget(batch);
}

void batch_forget(struct batch *batch)
{
    batch->samples = 0;
    batch->waiting = false;
    batch->follows = false;
}

/* Write header and fixed fields. After a gap the base is the count itself, since the difference over the gap may not fit
 * the layout. */
static void begin(struct batch *batch, struct connection *connection, uint32_t index, uint32_t time)
{
    struct batch_frame *frame = &batch->frames[batch->making];
    uint8_t *raw = frame->bytes + HR_RAW_AT;
    builder_begin(&frame->builder, frame->bytes);
    connection_header(connection, raw, HR_INDEX_BATCH);
    put_u32(raw + HR_AT_BATCH_FIRST_INDEX, index);
    put_u32(raw + HR_AT_BATCH_DEVICE_TIME, time);
    put_u32(raw + HR_AT_BATCH_BASE_COUNT, (uint32_t)batch->count);
    raw[HR_AT_BATCH_LAYOUT] = batch->layout;
    frame->laid = HR_RAW_AT + HR_BYTES_BATCH;
}

/* Return true if the sample may be appended as a difference from the last one. */
static bool follows(const struct batch *batch, uint32_t index)
{
    return batch->follows && index == batch->next;
}

bool batch_fits(const struct batch *batch, uint32_t index)
{
    return batch->samples == 0 || index == batch->next;
}

bool batch_push(struct batch *batch, struct connection *connection, const struct fault_entry *sample, uint32_t time)
{
    const uint32_t index = sample->sample_index;
    const int32_t most = batch->layout == WIDE ? INT16_MAX : INT8_MAX;
    if (!follows(batch, index))
        batch->count = sample->count;
    /* The counter may wrap between two samples. */
    const int32_t moved = signed_32((uint32_t)sample->count - (uint32_t)batch->count);
    if (moved > most || moved < -most - 1) {
        batch->follows = false;
        return false;
    }
    if (batch->samples == 0)
        begin(batch, connection, index, time);
    struct batch_frame *frame = &batch->frames[batch->making];
    uint8_t *at = frame->bytes + frame->laid;
    *at++ = (uint8_t)((uint32_t)moved & 0xFFu);
    if (batch->layout == WIDE)
        *at++ = (uint8_t)((uint32_t)moved >> 8 & 0xFFu);
    put_u16(at, (uint16_t)sample->current_commanded);
    if (batch->layout != NO_MEASUREMENT)
        put_u16(at + 2, (uint16_t)sample->current_measured);
    frame->laid = (uint16_t)(frame->laid + sample_bytes[batch->layout]);
    batch->samples++;
    batch->count = sample->count;
    batch->next = index + 1u;
    batch->follows = true;
    return true;
}

bool batch_is_full(const struct batch *batch)
{
    return batch->samples >= batch->most;
}

void batch_finish(struct batch *batch)
{
    if (batch->samples == 0)
        return;
    batch->samples = 0;
    batch->waiting = true;
    batch->making ^= 1u;
}

static void pack(struct batch_frame *frame, size_t count)
{
    struct builder *builder = &frame->builder;
    builder_append(builder, builder->bytes + builder->end, count);
}

bool batch_pack(struct batch *batch, size_t most)
{
    const bool making = batch->samples > 0;
    if (!batch->waiting && !making)
        return false;
    struct batch_frame *frame = &batch->frames[batch->waiting ? batch->making ^ 1u : batch->making];
    if (frame->laid - frame->builder.end < most)
        return false;
    pack(frame, most);
    return true;
}

const uint8_t *batch_take(struct batch *batch, size_t *count)
{
    if (!batch->waiting)
        return NULL;
    struct batch_frame *frame = &batch->frames[batch->making ^ 1u];
    batch->waiting = false;
    pack(frame, frame->laid - frame->builder.end);
    *count = builder_finish(&frame->builder);
    return frame->bytes;
}
