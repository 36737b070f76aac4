/* Code shared by the ports to a computer: a board given as a structure, and a link whose bytes are in memory. */
#ifndef HR_ON_A_COMPUTER_H
#define HR_ON_A_COMPUTER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "board.h"

struct board_setup {
    const uint8_t *dictionary;
    uint64_t dictionary_hash;
    uint32_t dictionary_bytes;
    uint32_t rate_initial;
    int32_t encoder_sign;
    uint32_t over_current;
    struct mechanics mechanics;
    struct current_sensor current_sensor;
};

static inline void board_set_up(struct board *board, const struct board_setup *setup)
{
    board->dictionary = setup->dictionary;
    board->dictionary_bytes = (uint16_t)setup->dictionary_bytes;
    board->dictionary_hash = setup->dictionary_hash;
    board->rate_initial = setup->rate_initial;
    board->encoder_sign = (int8_t)setup->encoder_sign;
    board->over_current = (uint16_t)setup->over_current;
    board->mechanics = setup->mechanics;
    board->current_sensor = setup->current_sensor;
}

/* Read the bytes that the host has passed in. */
static inline size_t memory_read(const uint8_t **input, size_t *there, uint8_t *into, size_t capacity)
{
    const size_t count = *there < capacity ? *there : capacity;
    if (count > 0)
        memcpy(into, *input, count);
    *input += count;
    *there -= count;
    return count;
}

/* Append a whole frame to the output; returns false, and appends nothing, if there is no room. */
static inline bool memory_write(uint8_t *output, size_t *there, size_t room, const uint8_t *frame, size_t count)
{
    if (*there > room || count > room - *there)
        return false;
    memcpy(output + *there, frame, count);
    *there += count;
    return true;
}

/* Remove up to `capacity` bytes from the front of the output. */
static inline size_t memory_take(uint8_t *output, size_t *there, uint8_t *into, size_t capacity)
{
    const size_t count = *there < capacity ? *there : capacity;
    memcpy(into, output, count);
    memmove(output, output + count, *there - count);
    *there -= count;
    return count;
}

#endif
