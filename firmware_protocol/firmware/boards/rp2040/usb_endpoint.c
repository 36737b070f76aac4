#include "usb_endpoint.h"

#include "usb_registers.h"

#define ABORT_TRIES 1000 /* the controller ends what it is at: a packet takes 50 µs */

static size_t control_of(const struct usb_endpoint *endpoint, uint8_t buffer)
{
    return USB_AT_BUFFER_CONTROL(endpoint->number, endpoint->out) + 2u * buffer;
}

static void begin(struct usb_endpoint *endpoint)
{
    endpoint->halted = false;
    endpoint->fresh = true;
    endpoint->toggle = 0;
    endpoint->next = 0;
    endpoint->oldest = 0;
    endpoint->armed = 0;
}

/* Take both buffers back, whatever the controller is doing with them (EP_ABORT; without effect on chips before B2,
 * RP2040-E2, where a packet that is just under way may still go). */
static void take_back(const struct usb_endpoint *endpoint, uint32_t then)
{
    const uint32_t bit = USB_BIT(endpoint->number, endpoint->out);
    usb_put(USB_EP_ABORT, usb_get(USB_EP_ABORT) | bit);
    for (int i = 0; i < ABORT_TRIES && (usb_get(USB_EP_ABORT_DONE) & bit) == 0; i++)
        ;
    usb_memory_put(control_of(endpoint, 0), then);
    usb_put(USB_EP_ABORT_DONE, bit);
    usb_put(USB_EP_ABORT, usb_get(USB_EP_ABORT) & ~bit);
    usb_put(USB_BUFF_STATUS, bit);
}

void endpoint_open(struct usb_endpoint *endpoint, enum usb_type type)
{
    begin(endpoint);
    usb_memory_put(control_of(endpoint, 0), 0);
    usb_memory_put(USB_AT_ENDPOINT_CONTROL(endpoint->number, endpoint->out),
                   USB_ENDPOINT_ENABLE | USB_ENDPOINT_TWO_BUFFERS | USB_ENDPOINT_EACH_BUFFER |
                       USB_ENDPOINT_TYPE(type) | endpoint->buffers);
}

void endpoint_reset(struct usb_endpoint *endpoint)
{
    take_back(endpoint, 0);
    begin(endpoint);
}

void endpoint_halt(struct usb_endpoint *endpoint)
{
    take_back(endpoint, USB_BUFFER_STALL);
    begin(endpoint);
    endpoint->halted = true;
}

void endpoint_forget(struct usb_endpoint *endpoint)
{
    begin(endpoint);
    usb_memory_put(USB_AT_ENDPOINT_CONTROL(endpoint->number, endpoint->out), 0);
    usb_memory_put(control_of(endpoint, 0), 0);
}

size_t endpoint_next(const struct usb_endpoint *endpoint)
{
    return (size_t)endpoint->buffers + (size_t)endpoint->next * USB_PACKET;
}

/* Written as half words: the controller may change the other buffer's half at the same time. */
void endpoint_arm(struct usb_endpoint *endpoint, uint32_t count)
{
    const size_t at = control_of(endpoint, endpoint->next);
    uint32_t value = count;
    if (!endpoint->out)
        value |= USB_BUFFER_FULL;
    if (endpoint->toggle)
        value |= USB_BUFFER_DATA1;
    if (endpoint->fresh)
        value |= USB_BUFFER_SELECT_FIRST;
    usb_memory_put_half(at, (uint16_t)value);
    usb_wait_for_controller();
    usb_memory_put_half(at, (uint16_t)(value | USB_BUFFER_AVAILABLE));
    endpoint->fresh = false;
    endpoint->toggle ^= 1u;
    endpoint->next ^= 1u;
    endpoint->armed++;
}

struct usb_done endpoint_done(struct usb_endpoint *endpoint)
{
    struct usb_done done = {.there = false, .count = 0, .at = 0};
    if (endpoint->armed == 0)
        return done;
    const uint16_t state = usb_memory_get_half(control_of(endpoint, endpoint->oldest));
    if (state & USB_BUFFER_AVAILABLE)
        return done;
    done.there = true;
    done.count = state & USB_BUFFER_LENGTH;
    done.at = (size_t)endpoint->buffers + (size_t)endpoint->oldest * USB_PACKET;
    endpoint->oldest ^= 1u;
    endpoint->armed--;
    return done;
}
