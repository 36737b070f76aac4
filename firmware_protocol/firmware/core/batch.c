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
    batch->follows = false;
}

static void append(struct batch *batch, const uint8_t *bytes, size_t count)
{
    uint8_t *at = batch->bytes + batch->end, *code = batch->bytes + batch->code;
    uint32_t crc = batch->crc;
    for (const uint8_t *end = bytes + count; bytes < end; bytes++) {
        const uint8_t byte = *bytes;
        crc = crc >> 8 ^ hr_crc_table[(crc ^ byte) & 0xFFu];
        if (byte == 0) {
            *code = (uint8_t)(at - code);
            code = at;
        }
        *at++ = byte;
    }
    batch->crc = crc;
    batch->end = (size_t)(at - batch->bytes);
    batch->code = (size_t)(code - batch->bytes);
}

/* Header and fixed fields. After a gap the base is the count itself: how far the handle has moved meanwhile need not
 * fit. */
static void begin(struct batch *batch, struct connection *connection, const struct batch_sample *sample)
{
    uint8_t raw[HR_BYTES_BATCH];
    connection_header(connection, raw, HR_INDEX_BATCH);
    put_u32(raw + HR_AT_BATCH_FIRST_INDEX, sample->index);
    put_u32(raw + HR_AT_BATCH_DEVICE_TIME, sample->device_time);
    put_u32(raw + HR_AT_BATCH_BASE_COUNT, (uint32_t)batch->count);
    raw[HR_AT_BATCH_LAYOUT] = batch->layout;
    batch->crc = UINT32_MAX;
    batch->code = 0;
    batch->end = HR_RAW_AT;
    append(batch, raw, sizeof raw);
}

bool batch_fits(const struct batch *batch, const struct batch_sample *sample)
{
    return batch->samples == 0 || sample->index == batch->next;
}

bool batch_push(struct batch *batch, struct connection *connection, const struct batch_sample *sample)
{
    if (!batch->follows || sample->index != batch->next)
        batch->count = sample->count;
    const int32_t most = batch->layout == WIDE ? INT16_MAX : INT8_MAX;
    /* The counter may wrap between two samples. */
    const int32_t moved = signed_32((uint32_t)sample->count - (uint32_t)batch->count);
    if (moved > most || moved < -most - 1) {
        batch->follows = false;
        return false;
    }
    if (batch->samples == 0)
        begin(batch, connection, sample);
    uint8_t bytes[MOST_SAMPLE_BYTES];
    uint8_t *at = bytes;
    *at++ = (uint8_t)((uint32_t)moved & 0xFFu);
    if (batch->layout == WIDE)
        *at++ = (uint8_t)((uint32_t)moved >> 8 & 0xFFu);
    put_u16(at, (uint16_t)sample->current_commanded);
    if (batch->layout != NO_MEASUREMENT)
        put_u16(at + 2, (uint16_t)sample->current_measured);
    append(batch, bytes, sample_bytes[batch->layout]);
    batch->samples++;
    batch->count = sample->count;
    batch->next = sample->index + 1u;
    batch->follows = true;
    return true;
}

bool batch_is_full(const struct batch *batch)
{
    return batch->samples >= batch->most;
}

size_t batch_finish(struct batch *batch)
{
    if (batch->samples == 0)
        return 0;
    batch->samples = 0;
    uint8_t crc[HR_CRC_BYTES];
    put_u32(crc, ~batch->crc);
    append(batch, crc, sizeof crc);
    batch->bytes[batch->code] = (uint8_t)(batch->end - batch->code);
    batch->bytes[batch->end] = 0;
    return batch->end + 1u;
}
