#include "usb_control.h"

#include <stddef.h>
#include <string.h>

#include "usb_registers.h"

#define IN 0x80u
enum recipient { TO_DEVICE = 0, TO_INTERFACE = 1, TO_ENDPOINT = 2 };
enum type { STANDARD = 0, CLASS = 1, VENDOR = 2 };
enum request {
    GET_STATUS = 0,
    CLEAR_FEATURE = 1,
    SET_FEATURE = 3,
    SET_ADDRESS = 5,
    GET_DESCRIPTOR = 6,
    GET_CONFIGURATION = 8,
    SET_CONFIGURATION = 9,
    GET_INTERFACE = 10,
    SET_INTERFACE = 11,
    SET_LINE_CODING = 0x20,
    GET_LINE_CODING = 0x21,
    SET_CONTROL_LINE_STATE = 0x22,
};
#define ENDPOINT_HALT 0u
#define ADDRESS_MASK 0x7Fu

/* ------------------------------------------------------------------ stages */

/* Endpoint 0 has one buffer for both directions, of which one at a time is the controller's with bytes in it. */
static void arm(bool out, uint32_t count, uint8_t toggle)
{
    const size_t at = USB_AT_BUFFER_CONTROL(0u, out);
    uint32_t value = count;
    if (!out)
        value |= USB_BUFFER_FULL;
    if (toggle)
        value |= USB_BUFFER_DATA1;
    usb_memory_put_half(at, (uint16_t)value);
    usb_wait_for_controller();
    usb_memory_put_half(at, (uint16_t)(value | USB_BUFFER_AVAILABLE));
}

static void send_packet(struct usb_control *control)
{
    const uint16_t count = control->left < USB_PACKET ? control->left : (uint16_t)USB_PACKET;
    for (uint16_t i = 0; i < count; i = (uint16_t)(i + 4u)) {
        uint32_t word = 0;
        for (uint16_t j = i; j < count && j < i + 4u; j++)
            word |= (uint32_t)control->data[j] << 8u * (j - i);
        usb_memory_put(USB_AT_ENDPOINT_0_BUFFER + i, word);
    }
    control->data += count;
    control->left = (uint16_t)(control->left - count);
    if (count < USB_PACKET)
        control->empty_packet = false;
    arm(false, count, control->toggle);
    control->toggle ^= 1u;
}

static bool acknowledge(struct usb_control *control)
{
    control->acknowledges = true;
    return true;
}

void control_acknowledge(struct usb_control *control)
{
    if (!control->acknowledges)
        return;
    control->acknowledges = false;
    control->stage = STAGE_STATUS_IN;
    arm(false, 0, 1);
}

/* The data stage in, then the host's packet without bytes. The data ends where the host expects it, or with a short
 * packet. */
static bool send(struct usb_control *control, const struct usb_setup *setup, const uint8_t *data, uint16_t count)
{
    control->data = data;
    control->left = count < setup->length ? count : setup->length;
    control->empty_packet = control->left < setup->length;
    if (setup->length == 0) /* nothing is asked for: such a request ends as one without data (8.5.3) */
        return acknowledge(control);
    control->stage = STAGE_SEND;
    send_packet(control);
    return true;
}

static bool receive(struct usb_control *control)
{
    control->stage = STAGE_RECEIVE;
    arm(true, USB_PACKET, 1);
    return true;
}

/* The next SETUP packet clears EP_STALL_ARM, and with it the answer (4.1.2.6.1). */
static void stall(struct usb_control *control)
{
    control->stage = STAGE_IDLE;
    usb_put(USB_EP_STALL_ARM, USB_BIT(0u, false) | USB_BIT(0u, true));
    usb_memory_put(USB_AT_BUFFER_CONTROL(0u, false), USB_BUFFER_STALL);
    usb_memory_put(USB_AT_BUFFER_CONTROL(0u, true), USB_BUFFER_STALL);
}

void control_sent(struct usb_control *control)
{
    if (control->stage == STAGE_SEND) {
        if (control->left > 0 || control->empty_packet) {
            send_packet(control);
        } else {
            control->stage = STAGE_STATUS_OUT;
            arm(true, 0, 1);
        }
    } else if (control->stage == STAGE_STATUS_IN) {
        control->stage = STAGE_IDLE;
        if (control->address != 0)
            usb_put(USB_ADDR_ENDP, control->address);
        control->address = 0;
    }
}

void control_received(struct usb_control *control)
{
    if (control->stage == STAGE_STATUS_OUT) {
        control->stage = STAGE_IDLE;
    } else if (control->stage == STAGE_RECEIVE) {
        const uint16_t state = usb_memory_get_half(USB_AT_BUFFER_CONTROL(0u, true));
        if ((state & USB_BUFFER_LENGTH) != USB_LINE_CODING_BYTES) {
            stall(control);
            return;
        }
        for (size_t i = 0; i < USB_LINE_CODING_BYTES; i++)
            control->line_coding[i] = usb_memory_get_byte(USB_AT_ENDPOINT_0_BUFFER + i);
        acknowledge(control);
        control_acknowledge(control);
    }
}

/* ------------------------------------------------------------------ requests */

static struct usb_endpoint *endpoint_at(const struct usb_control *control, uint16_t address)
{
    if (control->configuration == 0)
        return NULL;
    for (uint8_t i = 0; i < control->endpoint_count; i++) {
        struct usb_endpoint *endpoint = &control->endpoints[i];
        if (address == (endpoint->number | (endpoint->out ? 0u : IN)))
            return endpoint;
    }
    return NULL;
}

static bool send_bytes(struct usb_control *control, const struct usb_setup *setup, uint8_t first, uint16_t count)
{
    control->room[0] = first;
    control->room[1] = 0;
    return send(control, setup, control->room, count);
}

static bool set_configuration(struct usb_control *control, uint16_t value, enum usb_effect *effect)
{
    if (value > USB_CONFIGURATION)
        return false;
    control->configuration = (uint8_t)value;
    *effect = value != 0 ? USB_CONFIGURED : USB_DECONFIGURED;
    return acknowledge(control);
}

static bool to_device(struct usb_control *control, const struct usb_setup *setup, enum usb_effect *effect)
{
    switch (setup->kind << 8 | setup->request) {
    case IN << 8 | GET_STATUS:
        return setup->value == 0 && setup->index == 0 && send_bytes(control, setup, 0, 2);
    case IN << 8 | GET_DESCRIPTOR: {
        const struct usb_text text = usb_descriptor((uint8_t)(setup->value >> 8), (uint8_t)(setup->value & 0xFFu),
                                                    control->serial, control->room);
        return text.bytes != NULL && send(control, setup, text.bytes, text.count);
    }
    case IN << 8 | GET_CONFIGURATION:
        return send_bytes(control, setup, control->configuration, 1);
    case SET_ADDRESS:
        control->address = (uint8_t)(setup->value & ADDRESS_MASK);
        return setup->length == 0 && setup->value <= ADDRESS_MASK && acknowledge(control);
    case SET_CONFIGURATION:
        return setup->length == 0 && set_configuration(control, setup->value, effect);
    default:
        return false;
    }
}

/* There are no alternate settings; choosing the only one restarts its endpoints. */
static bool to_interface(struct usb_control *control, const struct usb_setup *setup, enum usb_effect *effect)
{
    if (control->configuration == 0 || setup->index >= USB_INTERFACES)
        return false;
    switch (setup->kind << 8 | setup->request) {
    case (IN | TO_INTERFACE) << 8 | GET_STATUS:
        return send_bytes(control, setup, 0, 2);
    case (IN | TO_INTERFACE) << 8 | GET_INTERFACE:
        return send_bytes(control, setup, 0, 1);
    case TO_INTERFACE << 8 | SET_INTERFACE:
        if (setup->value != 0 || setup->length != 0)
            return false;
        for (uint8_t i = 0; i < control->endpoint_count; i++) {
            const bool of_rig = control->endpoints[i].number == USB_PIPE_RIG;
            const bool of_data = control->endpoints[i].number == USB_PIPE_SERIAL;
            if ((setup->index == USB_INTERFACE_RIG && of_rig) || (setup->index == USB_INTERFACE_SERIAL_DATA && of_data))
                endpoint_reset(&control->endpoints[i]);
        }
        *effect = USB_PIPES_RESET;
        return acknowledge(control);
    default:
        return false;
    }
}

static bool to_endpoint(struct usb_control *control, const struct usb_setup *setup, enum usb_effect *effect)
{
    struct usb_endpoint *endpoint = endpoint_at(control, setup->index);
    const bool is_0 = (setup->index & ~IN) == 0;
    if (endpoint == NULL && !is_0)
        return false;
    switch (setup->kind << 8 | setup->request) {
    case (IN | TO_ENDPOINT) << 8 | GET_STATUS:
        return send_bytes(control, setup, endpoint != NULL && endpoint->halted, 2);
    case TO_ENDPOINT << 8 | CLEAR_FEATURE:
    case TO_ENDPOINT << 8 | SET_FEATURE:
        if (setup->value != ENDPOINT_HALT || setup->length != 0)
            return false;
        if (endpoint != NULL && setup->request == SET_FEATURE)
            endpoint_halt(endpoint);
        else if (endpoint != NULL)
            endpoint_reset(endpoint);
        *effect = endpoint != NULL ? USB_PIPES_RESET : USB_NOTHING;
        return acknowledge(control);
    default:
        return false;
    }
}

static bool to_serial_port(struct usb_control *control, const struct usb_setup *setup)
{
    if (control->configuration == 0 || setup->index != USB_INTERFACE_SERIAL)
        return false;
    switch (setup->kind << 8 | setup->request) {
    case (IN | CLASS << 5 | TO_INTERFACE) << 8 | GET_LINE_CODING:
        return send(control, setup, control->line_coding, USB_LINE_CODING_BYTES);
    case (CLASS << 5 | TO_INTERFACE) << 8 | SET_LINE_CODING:
        return setup->length == USB_LINE_CODING_BYTES && receive(control);
    case (CLASS << 5 | TO_INTERFACE) << 8 | SET_CONTROL_LINE_STATE:
        return setup->length == 0 && acknowledge(control);
    default:
        return false;
    }
}

static bool to_us(struct usb_control *control, const struct usb_setup *setup)
{
    const struct usb_text text = usb_microsoft_descriptor();
    return setup->kind == (IN | VENDOR << 5 | TO_DEVICE) && setup->request == USB_MICROSOFT_REQUEST &&
           setup->index == USB_MICROSOFT_INDEX && send(control, setup, text.bytes, text.count);
}

static bool answer_request(struct usb_control *control, const struct usb_setup *setup, enum usb_effect *effect)
{
    switch (setup->kind & ~IN) {
    case TO_DEVICE:
        return to_device(control, setup, effect);
    case TO_INTERFACE:
        return to_interface(control, setup, effect);
    case TO_ENDPOINT:
        return to_endpoint(control, setup, effect);
    case CLASS << 5 | TO_INTERFACE:
        return to_serial_port(control, setup);
    case VENDOR << 5 | TO_DEVICE:
        return to_us(control, setup);
    default:
        return false;
    }
}

static uint16_t u16_at(size_t at)
{
    return (uint16_t)(usb_memory_get_byte(at) | usb_memory_get_byte(at + 1u) << 8);
}

void control_reset(struct usb_control *control)
{
    control->stage = STAGE_IDLE;
    control->acknowledges = false;
    control->address = 0;
    control->configuration = 0;
    usb_put(USB_ADDR_ENDP, 0);
    usb_memory_put(USB_AT_BUFFER_CONTROL(0u, false), 0);
    usb_memory_put(USB_AT_BUFFER_CONTROL(0u, true), 0);
}

enum usb_effect control_setup(struct usb_control *control)
{
    enum usb_effect effect = USB_NOTHING;
    const struct usb_setup setup = {
        .kind = usb_memory_get_byte(USB_AT_SETUP),
        .request = usb_memory_get_byte(USB_AT_SETUP + 1u),
        .value = u16_at(USB_AT_SETUP + 2u),
        .index = u16_at(USB_AT_SETUP + 4u),
        .length = u16_at(USB_AT_SETUP + 6u),
    };
    /* A request that the host gave up leaves its buffers with the controller: they are not of this one. */
    usb_memory_put(USB_AT_BUFFER_CONTROL(0u, false), 0);
    usb_memory_put(USB_AT_BUFFER_CONTROL(0u, true), 0);
    usb_put(USB_BUFF_STATUS, USB_BIT(0u, false) | USB_BIT(0u, true));
    control->stage = STAGE_IDLE;
    control->acknowledges = false;
    control->address = 0;
    control->toggle = 1;
    if (!answer_request(control, &setup, &effect)) {
        control->address = 0;
        stall(control);
    }
    return effect;
}
