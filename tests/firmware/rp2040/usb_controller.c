/* A model of the RP2040's USB controller behind the accesses of usb_registers.h, and a program that plays the host's
 * packets on it, one command at a time on standard input.
 *
 * It mirrors what sections 4.1.2 and 4.1.4 of the data sheet say: who owns a buffer, which buffer is next, when a packet
 * is answered NAK or STALL, data toggles, the two bits that arm a STALL on endpoint 0, which writes clear what. It ends
 * the program when the firmware breaks a rule of the data sheet that a chip would punish now and then. */
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "usb.h"
#include "usb_registers.h"

#define ENDPOINTS 16u
#define CHECK(condition)                                                                                    \
    do {                                                                                                    \
        if (!(condition)) {                                                                                 \
            fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition);                                 \
            exit(1);                                                                                        \
        }                                                                                                   \
    } while (0)

enum answer { DONE = 'D', NAK = 'N', STALLED = 'S', NOBODY = '-', OUT_OF_SEQUENCE = 'Q', TOO_LONG = 'L' };

static struct {
    uint8_t memory[USB_MEMORY_BYTES];
    uint32_t address, sie_status, buff_status, abort, stall_arm, enabled, muxing, power, main_ctrl, sie_ctrl;
    bool sof;
    bool select[ENDPOINTS][2]; /* which buffer is next */
    bool waited;               /* since a buffer control was last written */
    bool pended;
    bool inside; /* the interrupt runs */
    uint32_t now;
    uint64_t preempt_in; /* accesses until a tick comes in between; 0 never */
    uint8_t preempt_frame[512];
    size_t preempt_count;
    int preempt_answer;
} model;

/* ------------------------------------------------------------------ what the firmware sees */

static void be_preempted(void)
{
    if (model.preempt_in == 0 || !model.inside)
        return;
    if (--model.preempt_in == 0)
        model.preempt_answer = usb_write(model.preempt_frame, model.preempt_count) ? DONE : NAK;
}

static uint32_t word_at(size_t at)
{
    uint32_t value;
    memcpy(&value, model.memory + at, sizeof value);
    return value;
}

static uint16_t half_at(size_t at)
{
    uint16_t value;
    memcpy(&value, model.memory + at, sizeof value);
    return value;
}

static uint32_t pending(void)
{
    uint32_t bits = 0;
    if (model.sie_status & USB_SIE_STATUS_BUS_RESET)
        bits |= USB_INT_BUS_RESET;
    if (model.sie_status & USB_SIE_STATUS_SETUP)
        bits |= USB_INT_SETUP;
    if (model.sie_status & USB_SIE_STATUS_SUSPENDED)
        bits |= USB_INT_SUSPEND;
    if (model.sie_status & USB_SIE_STATUS_RESUME)
        bits |= USB_INT_RESUME;
    if (model.buff_status)
        bits |= USB_INT_BUFFER;
    if (model.sof)
        bits |= USB_INT_SOF;
    return bits & model.enabled;
}

uint32_t usb_get(enum usb_register at)
{
    be_preempted();
    switch (at) {
    case USB_ADDR_ENDP:
        return model.address;
    case USB_SOF_RD:
        model.sof = false;
        return 0;
    case USB_SIE_STATUS:
        return model.sie_status;
    case USB_BUFF_STATUS:
        return model.buff_status;
    case USB_EP_ABORT:
    case USB_EP_ABORT_DONE: /* at once */
        return model.abort;
    case USB_INTE:
        return model.enabled;
    case USB_INTS:
        return pending();
    default:
        CHECK(!"a register that is not read");
        return 0;
    }
}

void usb_put(enum usb_register at, uint32_t value)
{
    be_preempted();
    switch (at) {
    case USB_ADDR_ENDP:
        model.address = value;
        break;
    case USB_MAIN_CTRL:
        model.main_ctrl = value;
        break;
    case USB_SIE_CTRL:
        model.sie_ctrl = value;
        break;
    case USB_SIE_STATUS:
        model.sie_status &= ~(value & ~(uint32_t)USB_SIE_STATUS_SUSPENDED); /* that bit shows the bus */
        break;
    case USB_BUFF_STATUS:
        model.buff_status &= ~value;
        break;
    case USB_EP_ABORT:
        model.abort = value;
        break;
    case USB_EP_ABORT_DONE:
        break;
    case USB_EP_STALL_ARM:
        model.stall_arm = value;
        break;
    case USB_MUXING:
        model.muxing = value;
        break;
    case USB_PWR:
        model.power = value;
        break;
    case USB_INTE:
        model.enabled = value;
        break;
    default:
        CHECK(!"a register that is not written");
    }
}

uint32_t usb_memory_get(size_t at)
{
    be_preempted();
    CHECK(at % 4u == 0 && at < USB_MEMORY_BYTES);
    return word_at(at);
}

void usb_memory_put(size_t at, uint32_t value)
{
    be_preempted();
    CHECK(at % 4u == 0 && at < USB_MEMORY_BYTES);
    if (at >= 0x80u && at < 0x100u) {
        const unsigned number = (unsigned)(at - 0x80u) / 8u;
        const bool out = at & 4u;
        const uint32_t bits = word_at(at);
        const bool owned = (bits & USB_BUFFER_AVAILABLE) != 0 || (bits >> 16 & USB_BUFFER_AVAILABLE) != 0;
        /* A whole word over a buffer that is the controller's: it may be in use. Endpoint 0 is between two requests,
         * and after a reset of the bus nobody speaks. */
        const bool unserved = number > 0 && word_at(USB_AT_ENDPOINT_CONTROL(number, out)) == 0;
        CHECK(!owned || number == 0 || unserved || model.abort & USB_BIT(number, out));
        CHECK(((value | value >> 16) & USB_BUFFER_AVAILABLE) == 0);
    }
    memcpy(model.memory + at, &value, sizeof value);
}

uint16_t usb_memory_get_half(size_t at)
{
    be_preempted();
    CHECK(at % 2u == 0 && at < USB_MEMORY_BYTES);
    return half_at(at);
}

void usb_memory_put_half(size_t at, uint16_t value)
{
    be_preempted();
    CHECK(at % 2u == 0 && at >= 0x80u && at < 0x100u);
    const uint16_t before = half_at(at);
    CHECK((before & USB_BUFFER_AVAILABLE) == 0 || at < 0x88u); /* what is the controller's is not touched */
    if (value & USB_BUFFER_AVAILABLE) {
        CHECK(value == (before | USB_BUFFER_AVAILABLE)); /* length and PID are there before, */
        CHECK(model.waited);                             /* and the controller has seen them */
    }
    model.waited = false;
    memcpy(model.memory + at, &value, sizeof value);
}

uint8_t usb_memory_get_byte(size_t at)
{
    be_preempted();
    CHECK(at < USB_MEMORY_BYTES);
    return model.memory[at];
}

void usb_wait_for_controller(void)
{
    model.waited = true;
}

uint32_t usb_now_us(void)
{
    return model.now;
}

void usb_hardware_start(void)
{
    const uint32_t now = model.now;
    memset(&model, 0, sizeof model);
    memset(model.memory, 0xA5, sizeof model.memory); /* a reset leaves the memory as it is */
    model.now = now;
}

void usb_pend(void)
{
    model.pended = true;
}

/* ------------------------------------------------------------------ what the host sees */

static bool is_there(uint32_t address)
{
    return model.main_ctrl & USB_MAIN_CTRL_ENABLE && model.sie_ctrl & USB_SIE_CTRL_PULL_UP && model.address == address;
}

static enum answer token(unsigned number, bool out, size_t *control, size_t *buffer)
{
    uint32_t settings = USB_AT_ENDPOINT_0_BUFFER;
    bool two = false;
    if (number > 0) {
        settings = word_at(USB_AT_ENDPOINT_CONTROL(number, out));
        if (!(settings & USB_ENDPOINT_ENABLE))
            return NOBODY;
        two = settings & USB_ENDPOINT_TWO_BUFFERS;
    }
    const size_t at = USB_AT_BUFFER_CONTROL(number, out);
    const bool armed = number > 0 || model.stall_arm & USB_BIT(0u, out);
    if (half_at(at) & USB_BUFFER_STALL && armed)
        return STALLED;
    if (half_at(at) & USB_BUFFER_SELECT_FIRST && half_at(at) & USB_BUFFER_AVAILABLE)
        model.select[number][out] = false;
    const bool second = two && model.select[number][out];
    *control = at + (second ? 2u : 0u);
    *buffer = (settings & 0xFFC0u) + (second ? 64u : 0u);
    const uint16_t state = half_at(*control);
    if (!(state & USB_BUFFER_AVAILABLE) || !(state & USB_BUFFER_FULL) != out)
        return NAK;
    return DONE;
}

static void finish(unsigned number, bool out, size_t control, uint16_t count)
{
    uint16_t state = (uint16_t)(half_at(control) & (USB_BUFFER_DATA1 | USB_BUFFER_FULL));
    state = (uint16_t)((out ? state | USB_BUFFER_FULL : state & ~USB_BUFFER_FULL) | count);
    memcpy(model.memory + control, &state, sizeof state);
    model.select[number][out] = !model.select[number][out];
    model.buff_status |= USB_BIT(number, out);
}

static enum answer in(unsigned number, bool lost, uint8_t *data, size_t *count, unsigned *pid)
{
    size_t control, buffer;
    const enum answer answer = token(number, false, &control, &buffer);
    if (answer != DONE)
        return answer;
    const uint16_t state = half_at(control);
    *count = state & USB_BUFFER_LENGTH;
    *pid = state & USB_BUFFER_DATA1 ? 1 : 0;
    CHECK(*count <= 64u);
    memcpy(data, model.memory + buffer, *count);
    if (!lost) /* the host's ACK reaches us */
        finish(number, false, control, (uint16_t)*count);
    return DONE;
}

static enum answer out(unsigned number, unsigned pid, const uint8_t *data, size_t count)
{
    size_t control, buffer;
    const enum answer answer = token(number, true, &control, &buffer);
    if (answer != DONE)
        return answer;
    const uint16_t state = half_at(control);
    if (pid != (state & USB_BUFFER_DATA1 ? 1u : 0u))
        return OUT_OF_SEQUENCE;
    if (count > (state & USB_BUFFER_LENGTH))
        return TOO_LONG;
    memcpy(model.memory + buffer, data, count);
    finish(number, true, control, (uint16_t)count);
    return DONE;
}

static void setup(const uint8_t *data)
{
    memcpy(model.memory + USB_AT_SETUP, data, 8);
    model.stall_arm = 0;
    model.sie_status |= USB_SIE_STATUS_SETUP;
}

static void interrupt(void)
{
    model.inside = true;
    for (int i = 0; model.pended || pending() != 0; i++) {
        CHECK(i < 100); /* whatever raises the interrupt is taken back */
        model.pended = false;
        usb_interrupt();
    }
    model.inside = false;
}

/* ------------------------------------------------------------------ commands */

static void read_all(uint8_t *into, size_t count)
{
    if (fread(into, 1, count, stdin) != count)
        exit(0);
}

static void reply(enum answer answer, unsigned pid, const uint8_t *data, size_t count)
{
    const uint8_t head[] = {(uint8_t)answer, (uint8_t)pid, (uint8_t)(count & 0xFFu), (uint8_t)(count >> 8)};
    fwrite(head, 1, sizeof head, stdout);
    fwrite(data, 1, count, stdout);
    fflush(stdout);
}

/* Head of a command: letter, three numbers, count of the bytes behind it. */
int main(void)
{
    static uint8_t data[65536];
    static uint32_t frame[16385], to_host_words[8192];
    for (;;) {
        uint8_t head[8];
        read_all(head, sizeof head);
        const size_t count = (size_t)(head[6] | head[7] << 8);
        const uint32_t number = (uint32_t)(head[2] | head[3] << 8 | head[4] << 16);
        read_all(data, count);
        enum answer answer = DONE;
        unsigned pid = 0;
        size_t length = 0;
        switch (head[0]) {
        case 'x': /* start: the serial number */
            usb_start(UINT64_C(0x0123456789ABCDEF), to_host_words, sizeof to_host_words / sizeof *to_host_words);
            break;
        case 'r': /* reset of the bus */
            model.sie_status = (model.sie_status & ~(uint32_t)USB_SIE_STATUS_SUSPENDED) | USB_SIE_STATUS_BUS_RESET;
            break;
        case 'a': /* is a device at this address */
            answer = is_there(number) ? DONE : NOBODY;
            break;
        case 's':
            setup(data);
            break;
        case 'i':
            answer = in(head[1], number != 0, data, &length, &pid);
            break;
        case 'o':
            answer = out(head[1], number, data, count);
            break;
        case 'f': /* a frame begins, now or later by so many µs */
            model.now += number;
            model.sof = head[1];
            break;
        case 'z': /* the bus falls silent, or wakes */
            model.sie_status = number ? model.sie_status | USB_SIE_STATUS_SUSPENDED
                                      : (model.sie_status & ~(uint32_t)USB_SIE_STATUS_SUSPENDED) | USB_SIE_STATUS_RESUME;
            break;
        case '!': /* let the interrupt run */
            interrupt();
            break;
        case 'w': /* a frame of the firmware, from an address that is a word's or not */
            memcpy((uint8_t *)frame + head[1], data, count);
            answer = usb_write((uint8_t *)frame + head[1], count) ? DONE : NAK;
            break;
        case 'p': /* the same in the middle of the next interrupt */
            model.preempt_in = number;
            model.preempt_count = count;
            model.preempt_answer = NOBODY;
            memcpy(model.preempt_frame, data, count);
            break;
        case 'q': /* how that went */
            answer = model.preempt_answer;
            model.preempt_in = 0;
            break;
        case 'g': /* what the firmware reads */
            length = usb_read(data, number);
            break;
        case 'h': /* an armed device keeps its link, or does no longer */
            usb_hold(number != 0);
            break;
        case 'u':
            answer = usb_is_up() ? DONE : NOBODY;
            break;
        default:
            CHECK(!"a command");
        }
        reply(answer, pid, data, length);
    }
}
