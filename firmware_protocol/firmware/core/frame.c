#include "frame.h"

#include "bytes.h"

uint32_t crc_of(const uint8_t *bytes, size_t count)
{
    uint32_t crc = UINT32_MAX;
    for (size_t i = 0; i < count; i++)
        crc = crc >> 8 ^ hr_crc_table[(crc ^ bytes[i]) & 0xFFu];
    return ~crc;
}

/* Raw frames are so short that no run of 254 bytes without a zero exists: each code is the distance to the next
 * zero. */
static void stuff(uint8_t *bytes, size_t end)
{
    size_t code = 0;
    for (size_t i = 1; i < end; i++) {
        if (bytes[i] == 0) {
            bytes[code] = (uint8_t)(i - code);
            code = i;
        }
    }
    bytes[code] = (uint8_t)(end - code);
    bytes[end] = 0;
}

size_t frame_finish(struct packet *packet)
{
    uint8_t *raw = packet->bytes + HR_RAW_AT;
    put_u32(raw + packet->count, crc_of(raw, packet->count));
    const size_t end = HR_RAW_AT + packet->count + HR_CRC_BYTES;
    stuff(packet->bytes, end);
    return end + 1;
}

void splitter_reset(struct splitter *splitter)
{
    splitter->count = 0;
    splitter->skipping = false;
}

const uint8_t *splitter_raw(const struct splitter *splitter)
{
    return splitter->bytes + HR_RAW_AT;
}

/* Undo the stuffing in place; whether the codes add up. */
static bool unstuff(uint8_t *bytes, size_t count)
{
    size_t here = 0;
    while (here < count) {
        const uint8_t code = bytes[here];
        bytes[here] = 0;
        here += code; /* never 0: a zero would have ended the frame */
    }
    return here == count;
}

static size_t finish(struct splitter *splitter, struct counters *counters)
{
    const size_t count = splitter->count;
    const bool skipped = splitter->skipping;
    splitter_reset(splitter);
    if (skipped || count == 0)
        return 0;
    if (count < HR_RAW_AT + HR_RAW_MINIMUM || !unstuff(splitter->bytes, count)) {
        counters->framing_errors++;
        return 0;
    }
    const size_t raw = count - HR_RAW_AT - HR_CRC_BYTES;
    if (crc_of(splitter_raw(splitter), raw) != get_u32(splitter_raw(splitter) + raw)) {
        counters->crc_errors++;
        return 0;
    }
    counters->frames++;
    return raw;
}

size_t splitter_take(struct splitter *splitter, uint8_t byte, struct counters *counters)
{
    if (byte == 0)
        return finish(splitter, counters);
    if (splitter->skipping)
        return 0;
    if (splitter->count == sizeof splitter->bytes) {
        splitter->skipping = true;
        counters->framing_errors++;
        return 0;
    }
    splitter->bytes[splitter->count++] = byte;
    return 0;
}
