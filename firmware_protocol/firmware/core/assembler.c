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

static void mark(struct assembler *assembler, size_t at)
{
    const uint8_t bit = (uint8_t)(1u << at % 8u);
    if (assembler->there[at / 8u] & bit)
        return;
    assembler->there[at / 8u] |= bit;
    assembler->missing--;
}

enum hr_status assembler_chunk(struct assembler *assembler, uint16_t nonce, size_t offset, const uint8_t *data,
                               size_t count)
{
    if (!assembler->begun || nonce != assembler->nonce)
        return HR_STATUS_INCOMPLETE;
    if (offset + count > assembler->length)
        return HR_STATUS_BAD_LENGTH;
    for (size_t i = 0; i < count; i++) {
        assembler->block[offset + i] = data[i];
        mark(assembler, offset + i);
    }
    return HR_STATUS_OK;
}

enum hr_status assembler_commit(struct assembler *assembler, uint16_t nonce)
{
    if (!assembler->begun || nonce != assembler->nonce || assembler->missing > 0)
        return HR_STATUS_INCOMPLETE;
    assembler->begun = false;
    const bool same = crc_of(assembler->block, assembler->length) == assembler->crc;
    return same ? HR_STATUS_OK : HR_STATUS_BAD_CRC;
}
