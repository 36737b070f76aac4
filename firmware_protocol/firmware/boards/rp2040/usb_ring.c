#include "usb_ring.h"

/* Bytes that are looked at as words. */
typedef uint32_t __attribute__((may_alias)) word;

static uint32_t word_of(const uint8_t *bytes, uint32_t count)
{
    uint32_t value = 0;
    for (uint32_t i = 0; i < count; i++)
        value |= (uint32_t)bytes[i] << 8u * i;
    return value;
}

/* Four at a time: a frame of 252 bytes is copied in a tick, and five cycles a word are less than nine. */
static void copy_words(uint32_t *to, const word *from, uint32_t count)
{
    const word *end = from + (count & ~3u);
    while (from != end) {
        to[0] = from[0];
        to[1] = from[1];
        to[2] = from[2];
        to[3] = from[3];
        to += 4;
        from += 4;
    }
    for (uint32_t i = 0; i < (count & 3u); i++)
        to[i] = from[i];
}

static void copy_bytes(uint32_t *to, const uint8_t *from, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++)
        to[i] = word_of(from + 4u * i, 4u);
}

void ring_put_words(struct ring *ring, const uint8_t *bytes, uint32_t count)
{
    const uint32_t at = (ring->written & (ring->size - 1u)) / 4u;
    const uint32_t whole = count / 4u;
    const uint32_t to_end = ring->size / 4u - at;
    const uint32_t first = whole < to_end ? whole : to_end;
    if ((uintptr_t)bytes % 4u == 0) {
        const void *aligned = bytes;
        copy_words(ring->words + at, aligned, first);
        copy_words(ring->words, (const word *)aligned + first, whole - first);
    } else {
        copy_bytes(ring->words + at, bytes, first);
        copy_bytes(ring->words, bytes + 4u * first, whole - first);
    }
    if (count % 4u != 0)
        ring->words[whole < to_end ? at + whole : whole - to_end] =
            word_of(bytes + 4u * whole, count % 4u);
    RING_KEEP_ORDER();
    ring->written += (count + 3u) & ~3u;
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
