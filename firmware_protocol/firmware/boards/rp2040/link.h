/* The link is UART0 or USB: the one that received last. While the device is armed it stays the one that armed it. */
#ifndef RP2040_LINK_H
#define RP2040_LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

void link_start(uint64_t serial);

size_t link_read(uint8_t *into, size_t capacity, bool armed);

/* Accept a whole frame for sending, or nothing (return false). `lasts`: the frame's bytes stay unchanged until the next
 * tick. */
bool link_write(const uint8_t *frame, size_t count, bool lasts);

/* Called at every tick. */
void link_pump(void);

#endif
