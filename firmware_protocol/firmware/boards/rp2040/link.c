#include "link.h"

#include "uart.h"
#include "usb.h"

/* Bytes of one read: enough for 800 kB/s at 50 kHz, and few enough that at most one frame ends in them. */
#define BYTES_AT_ONCE 16u

/* What waits for the host: 100 ms of everything, which at 50 kHz are 28 KB by USB, and of BATCH at 3 Mbaud. USB and UART take
 * turns. The DMA wraps in it. */
static uint32_t send_ring[SEND_BYTES / 4u] __attribute__((section(".rings.32768"), aligned(SEND_BYTES)));

static bool by_usb;
static bool ring_is_usbs; /* the link whose bytes are in the ring */

/* A board without a USB port, and the port's own tests, have no usb.c. */
__attribute__((weak)) void usb_start(uint64_t serial, uint32_t *words, uint32_t count)
{
    (void)serial;
    (void)words;
    (void)count;
}

__attribute__((weak)) void usb_drop(void)
{
}

__attribute__((weak)) size_t usb_read(uint8_t *into, size_t capacity)
{
    (void)into;
    (void)capacity;
    return 0;
}

__attribute__((weak)) bool usb_write(const uint8_t *frame, size_t count)
{
    (void)frame;
    (void)count;
    return false;
}

__attribute__((weak)) void usb_hold(bool held)
{
    (void)held;
}

void link_start(uint64_t serial)
{
    uart_start((uint8_t *)send_ring);
    usb_start(serial, send_ring, SEND_BYTES / 4u);
}

size_t link_read(uint8_t *into, size_t capacity, bool armed)
{
    usb_hold(armed);
    const size_t room = capacity < BYTES_AT_ONCE ? capacity : BYTES_AT_ONCE;
    for (unsigned i = 0; i < 2u; i++) {
        const size_t count = by_usb ? usb_read(into, room) : uart_read(into, room);
        if (count > 0 || armed || (!by_usb && !uart_is_idle())) /* finish the frame in progress, above all a fault */
            return count;
        by_usb = !by_usb; /* no bytes: try the other link, and return if it has none either */
    }
    return 0;
}

bool link_write(const uint8_t *frame, size_t count, bool lasts)
{
    if (ring_is_usbs && !by_usb)
        usb_drop();
    ring_is_usbs = by_usb;
    return by_usb ? usb_write(frame, count) : uart_write(frame, count, lasts);
}

void link_pump(void)
{
    uart_pump();
}
