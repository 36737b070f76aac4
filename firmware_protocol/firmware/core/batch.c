#include "batch.h"

#include "bytes.h"

/* What one sample of each layout takes; see BATCH_LAYOUTS. */
static const uint8_t sample_bytes[] = {5, 3, 6};

enum { MOST_SAMPLE_BYTES = 6 };
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
    batch->begun = false;
    batch->ready = 0;
    batch->follows = false;
}

/* Header and index of a first sample. */
static void begin(struct batch *batch, struct connection *connection, uint32_t index)
{
    uint8_t raw[HR_AT_BATCH_DEVICE_TIME];
    if (batch->begun) /* for another sample than the one that came */
        connection_take_back(connection, HR_INDEX_BATCH);
    connection_header(connection, raw, HR_INDEX_BATCH);
    put_u32(raw + HR_AT_BATCH_FIRST_INDEX, index);
    builder_begin(&batch->builder, batch->frames[batch->making]);
    builder_append(&batch->builder, raw, sizeof raw);
    batch->begun = true;
    batch->begun_index = index;
}

/* The fixed fields behind them. After a gap the base is the count itself: how far the handle has moved meanwhile need
 * not fit. */
static void begin_samples(struct batch *batch, uint32_t time)
{
    uint8_t raw[HR_BYTES_BATCH - HR_AT_BATCH_DEVICE_TIME];
    put_u32(raw, time);
    put_u32(raw + HR_AT_BATCH_BASE_COUNT - HR_AT_BATCH_DEVICE_TIME, (uint32_t)batch->count);
    raw[HR_AT_BATCH_LAYOUT - HR_AT_BATCH_DEVICE_TIME] = batch->layout;
    builder_append(&batch->builder, raw, sizeof raw);
}

bool batch_prepare(struct batch *batch, struct connection *connection, uint32_t index)
{
    if (batch->samples > 0 || (batch->begun && batch->begun_index == index))
        return false;
    begin(batch, connection, index);
    return true;
}

/* Whether the sample may be appended as a difference from the last one. */
static bool follows(const struct batch *batch, uint32_t index)
{
    return batch->follows && index == batch->next;
}

bool batch_fits(const struct batch *batch, uint32_t index)
{
    return batch->samples == 0 || index == batch->next;
}

/* Header and base of a frame that begins with this sample. */
static void begin_frame(struct batch *batch, struct connection *connection, uint32_t index, uint32_t time)
{
    batch_prepare(batch, connection, index);
    begin_samples(batch, time);
}

bool batch_push(struct batch *batch, struct connection *connection, const struct fault_entry *sample, uint32_t time)
{
    const uint32_t layout = batch->layout;
    const int32_t most = layout == WIDE ? INT16_MAX : INT8_MAX;
    if (!follows(batch, sample->sample_index))
        batch->count = sample->count;
    /* The counter may wrap between two samples. */
    const int32_t moved = signed_32((uint32_t)sample->count - (uint32_t)batch->count);
    if (moved > most || moved < -most - 1) {
        batch->follows = false;
        return false;
    }
    if (batch->samples == 0)
        begin_frame(batch, connection, sample->sample_index, time);
    batch->samples++;
    batch->count = sample->count;
    batch->next = sample->sample_index + 1u;
    batch->follows = true;
    uint8_t bytes[MOST_SAMPLE_BYTES];
    uint8_t *at = bytes;
    *at++ = (uint8_t)((uint32_t)moved & 0xFFu);
    if (layout == WIDE)
        *at++ = (uint8_t)((uint32_t)moved >> 8 & 0xFFu);
    put_u16(at, (uint16_t)sample->current_commanded);
    if (layout != NO_MEASUREMENT)
        put_u16(at + 2, (uint16_t)sample->current_measured);
    builder_append(&batch->builder, bytes, sample_bytes[layout]);
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
    batch->begun = false;
    batch->ready = (uint16_t)builder_finish(&batch->builder);
    batch->making ^= 1u;
}

const uint8_t *batch_frame(const struct batch *batch)
{
    return batch->frames[batch->making ^ 1u];
}
