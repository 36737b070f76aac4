#include "assembler.h"

#include <string.h>

#include "frame.h"

void assembler_reset(struct assembler *assembler)
{
    assembler->begun = false;
}

enum hr_status assembler_begin(struct assembler *assembler, uint16_t nonce, uint16_t length, uint32_t crc)
{
    if (length > HR_BLOCK_LIMIT)
        return HR_STATUS_BAD_LENGTH;
    if (assembler->begun && assembler->nonce == nonce && assembler->length == length && assembler->crc == crc)
        return HR_STATUS_OK;
    assembler->begun = true;
    assembler->nonce = nonce;
    assembler->length = length;
    assembler->crc = crc;
    assembler->missing = length;
    memset(assembler->there, 0, sizeof assembler->there);
    return HR_STATUS_OK;
}

/* Mark the bytes from `first` to before `end` as received, eight bytes at a time. */
static void mark(struct assembler *assembler, size_t first, size_t end)
{
    static const uint8_t ones[16] = {0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4};
    for (size_t at = first / 8u; at * 8u < end; at++) {
        const uint32_t from = at * 8u < first ? (uint32_t)(first - at * 8u) : 0u;
        const uint32_t to = end < at * 8u + 8u ? (uint32_t)(end - at * 8u) : 8u;
        const uint32_t these = (0xFFu << from & 0xFFu) & 0xFFu >> (8u - to);
        const uint32_t fresh = these & ~(uint32_t)assembler->there[at];
        assembler->there[at] |= (uint8_t)these;
        assembler->missing = (uint16_t)(assembler->missing - ones[fresh & 15u] - ones[fresh >> 4]);
    }
}

enum hr_status assembler_chunk(struct assembler *assembler, uint16_t nonce, size_t offset, const uint8_t *data,
                               size_t count)
{
    if (!assembler->begun || nonce != assembler->nonce)
        return HR_STATUS_INCOMPLETE;
    if (offset + count > assembler->length)
        return HR_STATUS_BAD_LENGTH;
    memcpy(assembler->block + offset, data, count);
    mark(assembler, offset, offset + count);
    return HR_STATUS_OK;
}

enum hr_status assembler_close(struct assembler *assembler, uint16_t nonce)
{
    if (!assembler->begun || nonce != assembler->nonce || assembler->missing > 0)
        return HR_STATUS_INCOMPLETE;
    assembler->begun = false;
    return HR_STATUS_OK;
}

enum hr_status assembler_commit(struct assembler *assembler, uint16_t nonce)
{
    const enum hr_status closed = assembler_close(assembler, nonce);
    if (closed != HR_STATUS_OK)
        return closed;
    const bool same = crc_of(assembler->block, assembler->length) == assembler->crc;
    return same ? HR_STATUS_OK : HR_STATUS_BAD_CRC;
}
