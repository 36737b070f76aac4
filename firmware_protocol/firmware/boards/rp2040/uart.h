/* UART0 as the link: both ways by DMA, through rings, so that neither tick nor conversation waits for a byte. */
#ifndef RP2040_UART_H
#define RP2040_UART_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define SEND_BITS 15u
#define SEND_BYTES (1u << SEND_BITS)

/* `send_ring`: SEND_BYTES at a multiple of them, for what waits for the line. */
void uart_start(uint8_t *send_ring);

/* Return true if nothing waits for the line. */
bool uart_is_idle(void);

size_t uart_read(uint8_t *into, size_t capacity);

/* Take a whole frame or nothing. One that lasts (its bytes stay for a tick) is copied behind the caller's back. */
bool uart_write(const uint8_t *frame, size_t count, bool lasts);

/* Let the line have what is there. At every tick: the line's own 32 bytes last for 100 µs at 3 Mbaud. */
void uart_pump(void);

#endif
