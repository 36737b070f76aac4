#ifndef HR_RP2040_USB_H
#define HR_RP2040_USB_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

void usb_start(uint64_t serial);
size_t usb_read(uint8_t *into, size_t capacity);
bool usb_write(const uint8_t *frame, size_t count);

#endif
