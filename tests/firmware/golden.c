#include "golden.h"

#include <string.h>

enum { HEADER_BYTES = 64, RECORD_BYTES = 20, VERSION = 1 };

static uint32_t get_u32(const uint8_t *at)
{
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static int32_t get_i32(const uint8_t *at)
{
    const uint32_t bits = get_u32(at);
    return bits <= INT32_MAX ? (int32_t)bits : -1 - (int32_t)~bits;
}

/* CRC-32 of zlib, half a byte at a time. */
static uint32_t crc_word(uint32_t crc, uint32_t word)
{
    static const uint32_t table[16] = {
        0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4, 0x4DB26158, 0x5005713C,
        0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C, 0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C,
    };
    int half;
    crc ^= word;
    for (half = 0; half < 8; half++)
        crc = crc >> 4 ^ table[crc & 0xF];
    return crc;
}

static void judge(golden_result *result, const uint8_t *header, const uint8_t *record, const law_output *out)
{
    const int32_t tolerance = get_i32(header + 16), expected = get_i32(record + 8);
    const uint32_t flags = get_u32(header + 20);
    const int32_t difference = out->current > expected ? out->current - expected : expected - out->current;

    if (tolerance >= 0 && difference > result->worst)
        result->worst = difference;
    if ((tolerance >= 0 && difference > tolerance) || ((out->flags ^ get_u32(record + 12)) & flags) != 0
        || out->phase != get_u32(record + 16)) {
        if (result->wrong == 0)
            result->first = result->ticks;
        result->wrong++;
    }
}

golden_result golden_run(law_state *s, const uint8_t *file, size_t bytes)
{
    golden_result result = {GOLDEN_BAD_FILE, 0, 0, 0, 0, 0};
    const uint32_t ticks = bytes >= HEADER_BYTES ? get_u32(file + 12) : 0;
    const law_parameters *p = (const law_parameters *)(const void *)(file + HEADER_BYTES);
    const uint8_t *record = file + HEADER_BYTES + sizeof *p;
    uint32_t crc = UINT32_MAX;

    if (bytes < HEADER_BYTES || memcmp(file, "HRGV", 4) != 0 || file[4] != VERSION
        || get_u32(file + 8) != sizeof *p || bytes != HEADER_BYTES + sizeof *p + (size_t)ticks * RECORD_BYTES)
        return result;
    result.verdict = GOLDEN_REFUSED;
    if (law_check(p) != LAW_GOOD)
        return result;
    law_reset(s, p, NULL);
    for (; result.ticks < ticks; result.ticks++, record += RECORD_BYTES) {
        const law_input in = {get_i32(record), get_u32(record + 4), 0};
        const law_output out = law_tick(s, p, &in);
        judge(&result, file, record, &out);
        crc = crc_word(crc_word(crc_word(crc, (uint32_t)out.current), out.flags), out.phase);
    }
    result.crc = ~crc;
    result.verdict = result.wrong > 0 ? GOLDEN_DIFFERENT : result.crc != get_u32(file + 24) ? GOLDEN_OTHER_BITS : GOLDEN_MET;
    return result;
}
