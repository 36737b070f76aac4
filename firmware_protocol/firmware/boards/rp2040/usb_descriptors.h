/* The device's descriptors: USB 2.0 chapter 9.6, the CDC PSTN subclass 1.2, Microsoft's OS 2.0 descriptors. */
#ifndef HR_RP2040_USB_DESCRIPTORS_H
#define HR_RP2040_USB_DESCRIPTORS_H

#include <stdint.h>

/* Interfaces and endpoints. The vendor interface comes first: `rig` takes the first with a bulk pipe each way. */
enum usb_interface { USB_INTERFACE_RIG, USB_INTERFACE_SERIAL, USB_INTERFACE_SERIAL_DATA, USB_INTERFACES };
enum usb_pipe_number { USB_PIPE_RIG = 1, USB_PIPE_SERIAL, USB_PIPE_SERIAL_NOTES };

#define USB_CONFIGURATION 1u
#define USB_MICROSOFT_REQUEST 0x20u /* bRequest of ours by which Windows asks for its descriptors */
#define USB_MICROSOFT_INDEX 7u      /* MS_OS_20_DESCRIPTOR_INDEX */

struct usb_text {
    const uint8_t *bytes; /* NULL: no such descriptor */
    uint16_t count;
};

/* Descriptor `index` of a kind, as GET_DESCRIPTOR asks for it. A string is built in `room`, which lives as long as the
 * answer. */
#define USB_STRING_ROOM 64u
struct usb_text usb_descriptor(uint8_t kind, uint8_t index, uint64_t serial, uint8_t *room);

/* Makes Windows 8.1 and later take WinUSB for the vendor interface, without a file to install. */
struct usb_text usb_microsoft_descriptor(void);

#endif
