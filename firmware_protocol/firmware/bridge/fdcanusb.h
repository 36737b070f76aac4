/* CAN frames as lines of text, as mjbots' fdcanusb and mjcanfd-usb-1x have them on their serial port:
 *
 *     can send 8001 0100001100 BF *7A     to the adapter
 *     OK *..                              it has sent it
 *     rcv 100 21000022 E B F *..          from the bus
 *
 * The checksum is a CRC-8 (polynomial 0x97) of all that stands before its star. An adapter that has received one requires it on
 * every line, and appends it to its own.
 *
 * Source: mjbots/moteus, lib/python/moteus/fdcanusb_device.py (firmware 1.1.0), opened. */
#ifndef HR_FDCANUSB_H
#define HR_FDCANUSB_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "can_frame.h"

#define FDCANUSB_LINE_BYTES 256u /* the longest line of either side has some 170 */

struct fdcanusb {
    bool checksum; /* on every line */
    bool overlong; /* the line that comes is too long to be one */
    size_t count;
    char line[FDCANUSB_LINE_BYTES];
    uint32_t sent;    /* lines that the adapter acknowledged */
    uint32_t refused; /* lines that it did not understand, or could not send */
    uint32_t garbled; /* malformed lines, and lines with a wrong checksum */
};

/* Process a byte from the adapter; returns true if the byte ends a frame of the bus. */
bool fdcanusb_take(struct fdcanusb *port, uint8_t byte, struct can_frame_bytes *frame);

/* Write the line that sends a frame; returns its length (bytes), at most FDCANUSB_LINE_BYTES. */
size_t fdcanusb_make(const struct fdcanusb *port, const struct can_frame_bytes *frame, uint8_t *into);

#endif
