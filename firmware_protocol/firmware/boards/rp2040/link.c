#include "link.h"

#include "uart.h"
#include "usb.h"

/* Bytes for one look at the link: enough for 800 kB/s at 50 kHz, and of two frames never more than one ends in them. */
#define BYTES_AT_ONCE 16u

static bool by_usb;

/* A board without a USB port, and the port's own tests, have no usb.c. */
__attribute__((weak)) void usb_start(uint64_t serial)
{
    (void)serial;
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
    uart_start();
    usb_start(serial);
}

size_t link_read(uint8_t *into, size_t capacity, bool armed)
{
    usb_hold(armed);
    const size_t room = capacity < BYTES_AT_ONCE ? capacity : BYTES_AT_ONCE;
    for (unsigned i = 0; i < 2u; i++) {
        const size_t count = by_usb ? usb_read(into, room) : uart_read(into, room);
        if (count > 0 || armed)
            return count;
        by_usb = !by_usb; /* silent: ask the other, and come back unless it answers */
    }
    return 0;
}

bool link_write(const uint8_t *frame, size_t count, bool lasts)
{
    return by_usb ? usb_write(frame, count) : uart_write(frame, count, lasts);
}

void link_pump(void)
{
    uart_pump();
}
