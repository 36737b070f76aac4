/* Endpoint 0: requests of the host, one at a time, in two or three stages (USB 2.0, 8.5.3 and chapter 9). */
#ifndef HR_RP2040_USB_CONTROL_H
#define HR_RP2040_USB_CONTROL_H

#include <stdbool.h>
#include <stdint.h>

#include "usb_descriptors.h"
#include "usb_endpoint.h"

#define USB_LINE_CODING_BYTES 7u

struct usb_setup {
    uint8_t kind; /* bmRequestType: direction, type, recipient */
    uint8_t request;
    uint16_t value;
    uint16_t index;
    uint16_t length;
};

enum usb_stage { STAGE_IDLE, STAGE_SEND, STAGE_STATUS_OUT, STAGE_RECEIVE, STAGE_STATUS_IN };

struct usb_control {
    uint64_t serial;
    enum usb_stage stage;
    const uint8_t *data; /* what is still to be sent */
    uint16_t left;
    bool empty_packet;  /* one without bytes ends the data */
    bool acknowledges;  /* the status stage is still to be sent */
    uint8_t toggle;    /* of the next data packet */
    uint8_t address;   /* active when the status stage is over; 0 none */
    uint8_t configuration;
    struct usb_endpoint *endpoints; /* those besides endpoint 0 */
    uint8_t endpoint_count;
    uint8_t line_coding[USB_LINE_CODING_BYTES]; /* kept and ignored: the line has no rate */
    uint8_t room[USB_STRING_ROOM];
};

/* Effect of a request on the pipes. */
enum usb_effect { USB_NOTHING, USB_CONFIGURED, USB_DECONFIGURED, USB_PIPES_RESET };

/* Reset endpoint 0 after a reset of the bus. */
void control_reset(struct usb_control *control);

/* Handle a SETUP packet. Its effect on the pipes must be applied before control_acknowledge, after which the host uses
 * them. */
enum usb_effect control_setup(struct usb_control *control);
void control_acknowledge(struct usb_control *control);

/* Continue after the controller has completed a buffer of endpoint 0. */
void control_sent(struct usb_control *control);
void control_received(struct usb_control *control);

#endif
