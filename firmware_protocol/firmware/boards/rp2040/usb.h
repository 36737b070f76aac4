/* A full-speed USB device that carries the bytes of the protocol, twice over: a vendor interface with a bulk pipe each
 * way (usb://), and a serial port (/dev/ttyACM0, COM3). The one that received last is the link, unless usb_hold keeps
 * the other.
 *
 * Everything of the controller happens in usb_interrupt, which must have the lowest priority there is and may be
 * interrupted by the tick at any moment; the functions beside it touch nothing but two rings. None waits. */
#ifndef HR_RP2040_USB_H
#define HR_RP2040_USB_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Plug in. `serial` is shown as sixteen hexadecimal digits; `words` hold what waits for the host, 2ⁿ of them. clk_usb runs at
 * 48 MHz and TIMER counts microseconds. */
void usb_start(uint64_t serial, uint32_t *words, uint32_t count);

/* Drop what waits for the host, because the UART takes over the memory. From the main loop, interrupts masked. */
void usb_drop(void);

/* The bytes of the host, at most `capacity`; from the main loop. */
size_t usb_read(uint8_t *into, size_t capacity);

/* Keep the link on its present interface while the device is armed: bytes on the other one are dropped. From the main
 * loop. */
void usb_hold(bool held);

/* A whole frame or nothing: false when no host is connected or the host has not fetched what the words hold. From the tick or
 * the main loop, of which one must not interrupt the other. Whole words (a frame at an address divisible by four)
 * go four times as fast. */
bool usb_write(const uint8_t *frame, size_t count);

/* Return true if a host has configured the device and the bus is awake. */
bool usb_is_up(void);

/* The vector of USBCTRL_IRQ, number 5 (RP2040 data sheet, 2.3.2). */
void usb_interrupt(void);

#endif
