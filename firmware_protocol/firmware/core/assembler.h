/* SET_PARAMETERS: join the chunks of a parameter block, which may arrive in any order and more than once. */
#ifndef HR_ASSEMBLER_H
#define HR_ASSEMBLER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "protocol.h"

struct assembler {
    bool begun;
    uint16_t nonce;
    uint16_t length;
    uint32_t crc;
    uint16_t missing; /* bytes */
    uint8_t block[HR_BLOCK_LIMIT];
    uint8_t there[HR_BLOCK_LIMIT / 8u]; /* a bit for each byte */
};

void assembler_reset(struct assembler *assembler);

/* Begin a parameter block. A repeated BEGIN changes nothing, another BEGIN starts a new block. */
enum hr_status assembler_begin(struct assembler *assembler, uint16_t nonce, uint16_t length, uint32_t crc);

/* Store a chunk of the parameter block at its offset (bytes). */
enum hr_status assembler_chunk(struct assembler *assembler, uint16_t nonce, size_t offset, const uint8_t *data,
                               size_t count);

/* Return OK if all `length` bytes of `block` have arrived with the right CRC. The transfer ends unless bytes are
 * missing. */
enum hr_status assembler_commit(struct assembler *assembler, uint16_t nonce);

/* Do the same as assembler_commit without the CRC, which the caller must check. */
enum hr_status assembler_close(struct assembler *assembler, uint16_t nonce);

#endif
