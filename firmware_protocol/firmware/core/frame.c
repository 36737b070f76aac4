#include "frame.h"

#include "bytes.h"

/* CRC of a frame followed by its own CRC, before the last inversion: a constant. */
#define RESIDUE 0xDEBB20E3u

static inline uint32_t crc_step(uint32_t crc, uint8_t byte)
{
    return crc >> 8 ^ hr_crc_table[(crc ^ byte) & 0xFFu];
}

uint32_t crc_more(uint32_t crc, const uint8_t *bytes, size_t count)
{
    for (size_t i = 0; i < count; i++)
        crc = crc_step(crc, bytes[i]);
    return crc;
}

uint32_t crc_of(const uint8_t *bytes, size_t count)
{
    return ~crc_more(UINT32_MAX, bytes, count);
}

/* ------------------------------------------------------------------ to send */

void builder_begin(struct builder *builder, uint8_t *bytes)
{
    builder->bytes = bytes;
    builder->crc = UINT32_MAX;
    builder->end = HR_RAW_AT;
    builder->code = 0;
}

/* Raw frames are so short that no run of 254 bytes without a zero exists: each code is the distance to the next
 * zero. */
void builder_append(struct builder *builder, const uint8_t *raw, size_t count)
{
    uint8_t *at = builder->bytes + builder->end, *code = builder->bytes + builder->code;
    uint32_t crc = builder->crc;
    for (const uint8_t *end = raw + count; raw < end; raw++) {
        const uint8_t byte = *raw;
        crc = crc_step(crc, byte);
        if (byte == 0) {
            *code = (uint8_t)(at - code);
            code = at;
        }
        *at++ = byte;
    }
    builder->crc = crc;
    builder->end = (size_t)(at - builder->bytes);
    builder->code = (size_t)(code - builder->bytes);
}

size_t builder_finish(struct builder *builder)
{
    uint8_t crc[HR_CRC_BYTES];
    put_u32(crc, ~builder->crc);
    builder_append(builder, crc, sizeof crc);
    builder->bytes[builder->code] = (uint8_t)(builder->end - builder->code);
    builder->bytes[builder->end] = 0;
    return builder->end + 1u;
}

size_t frame_finish(struct packet *packet)
{
    struct builder builder;
    builder_begin(&builder, packet->bytes);
    builder_append(&builder, packet->bytes + HR_RAW_AT, packet->count);
    return builder_finish(&builder);
}

/* ------------------------------------------------------------------ to receive */

void splitter_reset(struct splitter *splitter)
{
    splitter->count = 0;
    splitter->zero = 0;
    splitter->crc = UINT32_MAX;
    splitter->skipping = false;
}

const uint8_t *splitter_raw(const struct splitter *splitter)
{
    return splitter->bytes + HR_RAW_AT;
}

/* The end of a frame: good when its codes add up, and its CRC. */
static size_t finish(struct splitter *splitter, struct counters *counters)
{
    const size_t count = splitter->count;
    const bool skipped = splitter->skipping, adds_up = splitter->zero == count, same = splitter->crc == RESIDUE;
    splitter_reset(splitter);
    if (skipped || count == 0)
        return 0;
    if (count < HR_RAW_AT + HR_RAW_MINIMUM || !adds_up) {
        counters->framing_errors++;
        return 0;
    }
    if (!same) {
        counters->crc_errors++;
        return 0;
    }
    counters->frames++;
    return count - HR_RAW_AT - HR_CRC_BYTES;
}

size_t splitter_take(struct splitter *splitter, uint8_t byte, struct counters *counters)
{
    const size_t at = splitter->count;
    if (byte == 0)
        return finish(splitter, counters);
    if (splitter->skipping)
        return 0;
    if (at == sizeof splitter->bytes) {
        splitter->skipping = true;
        counters->framing_errors++;
        return 0;
    }
    uint8_t raw = byte;
    if (at == splitter->zero) {
        splitter->zero = at + byte;
        raw = 0;
    }
    splitter->bytes[at] = raw;
    splitter->count = at + 1u;
    if (at > 0) /* the first code stands for no byte */
        splitter->crc = crc_step(splitter->crc, raw);
    return 0;
}
