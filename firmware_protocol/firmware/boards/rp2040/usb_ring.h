/* A ring buffer of bytes between one writer and one reader; either may interrupt the other. */
#ifndef HR_RP2040_USB_RING_H
#define HR_RP2040_USB_RING_H

#include <stddef.h>
#include <stdint.h>

/* The data must be in memory before the index that publishes it. On one processor a compiler barrier suffices. */
#define RING_KEEP_ORDER() __asm__ volatile("" ::: "memory")

/* Indices run freely; the size is a power of two, so that their difference is what lies in the ring. */
struct ring {
    uint32_t *words;
    uint32_t size; /* bytes */
    volatile uint32_t written;
    volatile uint32_t read;
};

static inline uint32_t ring_count(const struct ring *ring)
{
    return ring->written - ring->read;
}

static inline uint32_t ring_room(const struct ring *ring)
{
    return ring->size - ring_count(ring);
}

/* Write `count` bytes, filled with zeros up to a whole word; the ring must have room for them. */
void ring_put_words(struct ring *ring, const uint8_t *bytes, uint32_t count);

/* Read the next word; the ring must contain one. */
static inline uint32_t ring_take_word(struct ring *ring)
{
    return ring->words[(ring->read & (ring->size - 1u)) / 4u];
}

static inline void ring_step(struct ring *ring, uint32_t count)
{
    RING_KEEP_ORDER();
    ring->read += count;
}

/* Read single bytes. */
void ring_put(struct ring *ring, uint8_t byte);
uint32_t ring_take(struct ring *ring, uint8_t *into, uint32_t capacity);

#endif
