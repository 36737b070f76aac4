#include "usb.h"

#include "usb_control.h"
#include "usb_endpoint.h"
#include "usb_registers.h"
#include "usb_ring.h"

#define FROM_HOST_WORDS 256u

/* RP2040-E15: the controller may hang when the bus garbles the answer to a packet of ours in the last fifth of a frame,
 * as some hubs do. Nothing is handed to it then; the next frame begins with an interrupt. */
#define FRAME_SAFE_US 800u
#define FRAME_US 998u

/* The serial port becomes the link only after the vendor interface was silent for this time: a program that probes
 * serial ports (ModemManager) must not take the link from a running session. The vendor interface takes the link at
 * once. The link never changes while the device is armed. */
#define SILENCE_US 1000000u

enum pipe { PIPE_RIG, PIPE_SERIAL, PIPES };
enum { NOTES = 2 * PIPES, ENDPOINTS };

static struct {
    struct ring to_host;
    struct ring from_host;
    struct usb_control control;
    struct usb_endpoint endpoints[ENDPOINTS]; /* of each pipe in, out; then notes */
    enum pipe active;                         /* the link */
    uint32_t rig_received_at;                         /* last packet on the vendor interface (µs) */
    bool frame_cut;                           /* the next frame must begin with a delimiter */
    bool ended_full;                          /* the last packet was full: the host expects more, if only an empty one */
    bool frames;                              /* the host has begun one since the last reset */
    uint32_t frame_began;                     /* µs */
    volatile bool held; /* an armed device keeps its link */
    volatile bool configured;
    volatile bool suspended;
    volatile bool starved; /* an out buffer waits until there is room in the ring */
} usb;

static uint32_t from_host_words[FROM_HOST_WORDS];

static struct usb_endpoint *in_of(enum pipe pipe)
{
    return &usb.endpoints[2u * (unsigned)pipe];
}

static struct usb_endpoint *out_of(enum pipe pipe)
{
    return &usb.endpoints[2u * (unsigned)pipe + 1u];
}

/* ------------------------------------------------------------------ to the host */

/* Drop what waits; the next packet begins with a delimiter, which ends a frame that was sent in part. */
static void flush(void)
{
    ring_step(&usb.to_host, ring_count(&usb.to_host));
    usb.frame_cut = true;
    usb.ended_full = false;
}

static bool frame_ends_soon(void)
{
    const uint32_t age = usb_now_us() - usb.frame_began;
    return usb.frames && age >= FRAME_SAFE_US && age < FRAME_US;
}

/* Fill one packet of whole words; returns its bytes. */
static uint32_t fill(size_t at)
{
    uint32_t count = 0;
    if (usb.frame_cut && ring_count(&usb.to_host) > 0) {
        usb.frame_cut = false;
        usb_memory_put(at, 0);
        count = 4;
    }
    for (; count < USB_PACKET && ring_count(&usb.to_host) > 0; count += 4u) {
        usb_memory_put(at + count, ring_take_word(&usb.to_host));
        ring_step(&usb.to_host, 4u);
    }
    return count;
}

static void send_packets(void)
{
    struct usb_endpoint *endpoint = in_of(usb.active);
    while (endpoint_done(endpoint).there)
        ;
    while (endpoint_is_free(endpoint) && (ring_count(&usb.to_host) > 0 || usb.ended_full)) {
        if (frame_ends_soon())
            return;
        const uint32_t count = fill(endpoint_next(endpoint));
        usb.ended_full = count == USB_PACKET;
        endpoint_arm(endpoint, count);
    }
}

/* ------------------------------------------------------------------ from the host */

/* Return true if a packet on this pipe is accepted; the pipe then is the link. */
static bool takes_over(enum pipe pipe)
{
    const uint32_t now = usb_now_us();
    if (pipe == PIPE_RIG)
        usb.rig_received_at = now;
    if (pipe == usb.active)
        return true;
    if (usb.held)
        return false;
    if (pipe == PIPE_SERIAL && now - usb.rig_received_at < SILENCE_US)
        return false;
    flush();
    while (endpoint_done(in_of(usb.active)).there)
        ;
    usb.active = pipe;
    ring_put(&usb.from_host, 0); /* ends a frame that the other pipe left unfinished */
    return true;
}

static void take_packet(enum pipe pipe, const struct usb_done *done)
{
    if (done->count == 0 || !takes_over(pipe))
        return;
    for (uint32_t i = 0; i < done->count; i++)
        ring_put(&usb.from_host, usb_memory_get_byte(done->at + i));
}

/* Hand a buffer to the controller only if the ring has room for a full packet: an armed buffer cannot be refused. */
static void offer_buffers(enum pipe pipe)
{
    struct usb_endpoint *endpoint = out_of(pipe);
    while (endpoint_is_free(endpoint)) {
        const uint32_t promised = out_of(PIPE_RIG)->armed + out_of(PIPE_SERIAL)->armed + 1u;
        if (ring_room(&usb.from_host) < promised * (USB_PACKET + 1u)) {
            usb.starved = true;
            return;
        }
        endpoint_arm(endpoint, USB_PACKET);
    }
}

static void take_packets(enum pipe pipe)
{
    for (struct usb_done done = endpoint_done(out_of(pipe)); done.there; done = endpoint_done(out_of(pipe)))
        take_packet(pipe, &done);
    offer_buffers(pipe);
}

/* ------------------------------------------------------------------ what happens on the bus */

static void configure(bool on)
{
    for (size_t i = 0; i < ENDPOINTS; i++) {
        if (usb.configured)
            endpoint_reset(&usb.endpoints[i]);
        if (on)
            endpoint_open(&usb.endpoints[i], i == NOTES ? USB_PERIODIC : USB_BULK);
        else
            endpoint_forget(&usb.endpoints[i]);
    }
    usb.configured = on;
    flush();
}

static void bus_reset(void)
{
    usb_put(USB_SIE_STATUS, USB_SIE_STATUS_BUS_RESET);
    usb_put(USB_BUFF_STATUS, UINT32_MAX);
    for (size_t i = 0; i < ENDPOINTS; i++)
        endpoint_forget(&usb.endpoints[i]);
    control_reset(&usb.control);
    usb.configured = false;
    usb.frames = false;
    flush();
}

static void setup(void)
{
    usb_put(USB_SIE_STATUS, USB_SIE_STATUS_SETUP);
    const enum usb_effect effect = control_setup(&usb.control);
    if (effect == USB_CONFIGURED || effect == USB_DECONFIGURED)
        configure(effect == USB_CONFIGURED);
    else if (effect == USB_PIPES_RESET && in_of(usb.active)->fresh)
        flush(); /* clearing an endpoint restarts the stream */
    control_acknowledge(&usb.control);
}

/* No frame for 3 ms: the host sleeps or the cable is out, which look the same from here. The interrupt stays on as long
 * as the bus is quiet: it is masked until something happens there. */
static void set_asleep(bool asleep)
{
    const uint32_t enabled = usb_get(USB_INTE) & ~(uint32_t)USB_INT_SUSPEND;
    usb_put(USB_INTE, asleep ? enabled : enabled | USB_INT_SUSPEND);
    if (asleep && !usb.suspended)
        flush();
    usb.suspended = asleep;
}

static void buffers(void)
{
    const uint32_t done = usb_get(USB_BUFF_STATUS);
    usb_put(USB_BUFF_STATUS, done); /* first: what ends from now on sets its bit again */
    if (done & USB_BIT(0u, false))
        control_sent(&usb.control);
    if (done & USB_BIT(0u, true))
        control_received(&usb.control);
}

static void frame_begins(void)
{
    (void)usb_get(USB_SOF_RD); /* takes the interrupt back */
    usb.frame_began = usb_now_us();
    usb.frames = true;
}

void usb_interrupt(void)
{
    const uint32_t why = usb_get(USB_INTS);
    if (why & USB_INT_BUS_RESET)
        bus_reset();
    if (why & USB_INT_SOF)
        frame_begins();
    if (why & (USB_INT_BUS_RESET | USB_INT_SOF | USB_INT_RESUME) && usb.suspended)
        set_asleep(false);
    if (why & USB_INT_RESUME)
        usb_put(USB_SIE_STATUS, USB_SIE_STATUS_RESUME);
    if (why & USB_INT_SUSPEND) {
        usb_put(USB_SIE_STATUS, USB_SIE_STATUS_SUSPENDED);
        set_asleep(true);
    }
    if (why & USB_INT_BUFFER)
        buffers();
    if (why & USB_INT_SETUP)
        setup();
    if (!usb.configured)
        return;
    usb.starved = false;
    take_packets(PIPE_RIG);
    take_packets(PIPE_SERIAL);
    send_packets();
}

/* ------------------------------------------------------------------ from outside */

static void shape(uint8_t *count, uint16_t *buffers_at, uint8_t number, bool out)
{
    usb.endpoints[*count] = (struct usb_endpoint){.number = number, .out = out, .buffers = *buffers_at};
    *count = (uint8_t)(*count + 1u);
    *buffers_at = (uint16_t)(*buffers_at + 2u * USB_PACKET);
}

static void begin(uint64_t serial, const struct ring *to_host)
{
    uint16_t at = USB_AT_BUFFERS;
    uint8_t count = 0;
    shape(&count, &at, USB_PIPE_RIG, false);
    shape(&count, &at, USB_PIPE_RIG, true);
    shape(&count, &at, USB_PIPE_SERIAL, false);
    shape(&count, &at, USB_PIPE_SERIAL, true);
    shape(&count, &at, USB_PIPE_SERIAL_NOTES, false);
    usb.control = (struct usb_control){
        .serial = serial,
        .endpoints = usb.endpoints,
        .endpoint_count = ENDPOINTS,
        .line_coding = {0x00, 0xC2, 0x01, 0x00, 0, 0, 8}, /* 115200 8N1 */
    };
    usb.to_host = *to_host;
    usb.from_host = (struct ring){.words = from_host_words, .size = sizeof from_host_words};
    usb.active = PIPE_RIG;
    usb.rig_received_at = usb_now_us() - SILENCE_US;
    usb.frame_cut = false;
    usb.ended_full = false;
    usb.frames = false;
    usb.held = false;
    usb.configured = false;
    usb.suspended = false;
    usb.starved = false;
}

/* 4.1.2.4 and 4.1.3: the controller to the PHY, a bus that always looks powered (its pin is not connected), device
 * mode, and at the end the pull-up by which the host sees us. */
void usb_start(uint64_t serial, uint32_t *words, uint32_t count)
{
    const struct ring to_host = {.words = words, .size = count * 4u};
    usb_hardware_start();
    for (size_t at = 0; at < USB_MEMORY_BYTES; at += 4u)
        usb_memory_put(at, 0);
    begin(serial, &to_host);
    usb_put(USB_MUXING, USB_MUXING_TO_PHY | USB_MUXING_SOFTCON);
    usb_put(USB_PWR, USB_PWR_VBUS_DETECT | USB_PWR_VBUS_OVERRIDE);
    usb_put(USB_MAIN_CTRL, USB_MAIN_CTRL_ENABLE);
    usb_put(USB_SIE_CTRL, USB_SIE_CTRL_EACH_BUFFER_OF_0);
    usb_put(USB_INTE, USB_INT_BUFFER | USB_INT_SETUP | USB_INT_BUS_RESET | USB_INT_SUSPEND | USB_INT_RESUME |
                          USB_INT_SOF);
    usb_put(USB_SIE_CTRL, USB_SIE_CTRL_EACH_BUFFER_OF_0 | USB_SIE_CTRL_PULL_UP);
}

void usb_drop(void)
{
    flush();
}

bool usb_is_up(void)
{
    return usb.configured && !usb.suspended;
}

size_t usb_read(uint8_t *into, size_t capacity)
{
    const uint32_t most = capacity < sizeof from_host_words ? (uint32_t)capacity : (uint32_t)sizeof from_host_words;
    const uint32_t count = ring_take(&usb.from_host, into, most);
    if (count > 0 && usb.starved)
        usb_pend();
    return count;
}

void usb_hold(bool held)
{
    usb.held = held;
}

bool usb_write(const uint8_t *frame_bytes, size_t count)
{
    if (!usb_is_up() || count > ring_room(&usb.to_host) - 3u || ring_room(&usb.to_host) < 4u)
        return false;
    ring_put_words(&usb.to_host, frame_bytes, (uint32_t)count);
    usb_pend();
    return true;
}
