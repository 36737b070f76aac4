/* An endpoint with two alternating buffers of 64 bytes: which buffers the controller owns, and the next data toggle.
 *
 * RP2040 data sheet, 4.1.2.5 and 4.1.2.6; the toggles are those of chapter 8.6 of the USB 2.0 specification. */
#ifndef HR_RP2040_USB_ENDPOINT_H
#define HR_RP2040_USB_ENDPOINT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define USB_PACKET 64u /* the largest packet, of endpoint 0 and of bulk at full speed */

enum usb_type { USB_BULK = 2, USB_PERIODIC = 3 };

struct usb_endpoint {
    uint8_t number;
    bool out;
    uint16_t buffers; /* offset of the first in the shared memory */
    bool halted;
    bool fresh;      /* nothing was armed since the last reset: begin with buffer 0 */
    uint8_t toggle;  /* of the next packet to be armed */
    uint8_t next;    /* buffer to be armed next */
    uint8_t oldest;  /* buffer that is used first of those armed */
    uint8_t armed;   /* buffers that are the controller's */
};

/* Enable the endpoint in the controller, from DATA0. */
void endpoint_open(struct usb_endpoint *endpoint, enum usb_type type);

/* Take back the armed buffers, and begin with DATA0, as SET_CONFIGURATION, SET_INTERFACE and CLEAR_FEATURE require. */
void endpoint_reset(struct usb_endpoint *endpoint);

/* Reset the endpoint like endpoint_reset, and reply STALL until endpoint_reset is called. */
void endpoint_halt(struct usb_endpoint *endpoint);

/* Reset after a reset of the bus: no buffer is armed, and the controller does not serve the endpoint. */
void endpoint_forget(struct usb_endpoint *endpoint);

static inline bool endpoint_is_free(const struct usb_endpoint *endpoint)
{
    return !endpoint->halted && endpoint->armed < 2u;
}

/* Return the address of the buffer that is armed next. */
size_t endpoint_next(const struct usb_endpoint *endpoint);

/* Arm that buffer: the controller sends its `count` bytes, or receives up to as many. */
void endpoint_arm(struct usb_endpoint *endpoint, uint32_t count);

/* Return the oldest buffer that the controller has completed. */
struct usb_done {
    bool there;
    uint32_t count;
    size_t at;
};

struct usb_done endpoint_done(struct usb_endpoint *endpoint);

#endif
