#include "usb_ring.h"

#include <string.h>

static uint32_t word_of(const uint8_t *bytes, uint32_t count)
{
    uint32_t word = 0;
    for (uint32_t i = 0; i < count; i++)
        word |= (uint32_t)bytes[i] << 8u * i;
    return word;
}

void ring_put_words(struct ring *ring, const uint8_t *bytes, uint32_t count)
{
    const uint32_t mask = ring->size / 4u - 1u;
    uint32_t at = ring->written / 4u;
    uint32_t done = 0;
    if ((uintptr_t)bytes % 4u == 0) {
        for (; done + 4u <= count; done += 4u)
            memcpy(&ring->words[at++ & mask], __builtin_assume_aligned(bytes + done, 4), 4); /* one load, one store */
    } else {
        for (; done + 4u <= count; done += 4u)
            ring->words[at++ & mask] = word_of(bytes + done, 4u);
    }
    if (done < count)
        ring->words[at++ & mask] = word_of(bytes + done, count - done);
    RING_KEEP_ORDER();
    ring->written = 4u * at;
}

void ring_put(struct ring *ring, uint8_t byte)
{
    uint8_t *bytes = (uint8_t *)ring->words;
    bytes[ring->written & (ring->size - 1u)] = byte;
    RING_KEEP_ORDER();
    ring->written++;
}

uint32_t ring_take(struct ring *ring, uint8_t *into, uint32_t capacity)
{
    const uint8_t *bytes = (const uint8_t *)ring->words;
    const uint32_t here = ring_count(ring);
    const uint32_t count = here < capacity ? here : capacity;
    RING_KEEP_ORDER();
    for (uint32_t i = 0; i < count; i++)
        into[i] = bytes[(ring->read + i) & (ring->size - 1u)];
    ring_step(ring, count);
    return count;
}
