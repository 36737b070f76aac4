#include "uart.h"

#include "clocks.h"
#include "pins.h"
#include "board_config.h"
#include "registers.h"

#define TRANSMIT_PIN 0u
#define RECEIVE_PIN 1u

enum { DMA_RECEIVE = 6, DMA_TRANSMIT = 7, DMA_COPY = 8 };

/* Room for 13 ms of the host. */
#define RECEIVE_BITS 12u
#define RECEIVE_BYTES (1u << RECEIVE_BITS)
#define RECEIVE_ROUNDS 0xFFFFF000u /* bytes until the channel must be restarted; whole rings */

static uint8_t receive_ring[RECEIVE_BYTES] __attribute__((section(".rings.4096"), aligned(RECEIVE_BYTES)));

/* Bytes since the start, modulo 2³². */
static struct {
    uint32_t begun;   /* written or being copied */
    uint32_t written; /* there */
    uint32_t given;   /* to the line's channel */
    uint32_t taken;   /* of those received, since the channel was started */
} link;

static bool busy(uint32_t channel)
{
    return (DMA_CONTROL(channel) & DMA_BUSY) != 0;
}

static void start_receiving(void)
{
    DMA_TO(DMA_RECEIVE) = (uint32_t)receive_ring;
    DMA_COUNT(DMA_RECEIVE) = RECEIVE_ROUNDS;
    DMA_CONTROL_START(DMA_RECEIVE) = DMA_ENABLE | DMA_BYTES | DMA_STEP_TO | DMA_RING_TO(RECEIVE_BITS) | DMA_QUIET
                                     | DMA_WHEN(REQUEST_UART0_RECEIVE) | DMA_THEN((uint32_t)DMA_RECEIVE);
    link.taken = 0;
}

void uart_start(uint8_t *send_ring)
{
    /* 4.2.3.2.1: the divider in sixty-fourths, rounded. */
    const uint32_t divider = (CLOCK_HZ * 4u + BOARD_UART_BAUD / 2u) / BOARD_UART_BAUD;
    UART_DIVIDER = divider >> 6;
    UART_DIVIDER_64THS = divider & 63u;
    UART_LINE = UART_8_BITS_WITH_FIFOS; /* its write takes the divider over */
    UART_DMA = UART_DMA_BOTH_WAYS;
    DMA_FROM(DMA_TRANSMIT) = (uint32_t)send_ring;
    DMA_TO(DMA_TRANSMIT) = UART_DATA;
    DMA_CONTROL(DMA_TRANSMIT) = DMA_ENABLE | DMA_BYTES | DMA_STEP_FROM | DMA_RING_FROM(SEND_BITS) | DMA_QUIET
                                | DMA_WHEN(REQUEST_UART0_TRANSMIT) | DMA_THEN((uint32_t)DMA_TRANSMIT);
    DMA_TO(DMA_COPY) = (uint32_t)send_ring;
    DMA_CONTROL(DMA_COPY) = DMA_ENABLE | DMA_BYTES | DMA_STEP_FROM | DMA_STEP_TO | DMA_RING_TO(SEND_BITS) | DMA_QUIET
                            | DMA_WHEN(REQUEST_ALWAYS) | DMA_THEN((uint32_t)DMA_COPY);
    DMA_FROM(DMA_RECEIVE) = UART_DATA;
    PAD(RECEIVE_PIN) = PAD_INPUT | PAD_SCHMITT | PAD_PULL_UP; /* an unconnected line reads as idle, not as noise */
    pin_function(RECEIVE_PIN, GPIO_UART);
    pin_function(TRANSMIT_PIN, GPIO_UART);
    UART_CONTROL = UART_ON_BOTH_WAYS;
    start_receiving();
}

size_t uart_read(uint8_t *into, size_t capacity)
{
    const uint32_t received = RECEIVE_ROUNDS - DMA_COUNT(DMA_RECEIVE);
    if (received - link.taken > RECEIVE_BYTES)
        link.taken = received; /* all of it was overwritten; the CRC of the frame will not fit */
    size_t count = 0;
    while (count < capacity && link.taken != received)
        into[count++] = receive_ring[link.taken++ % RECEIVE_BYTES];
    if (count == 0 && !busy(DMA_RECEIVE))
        start_receiving();
    return count;
}

bool uart_is_idle(void)
{
    return link.given == link.begun && !busy(DMA_TRANSMIT);
}

void uart_pump(void)
{
    if (link.given == link.begun)
        return;
    if (!busy(DMA_COPY))
        link.written = link.begun;
    if (link.given == link.written || busy(DMA_TRANSMIT))
        return;
    DMA_COUNT_START(DMA_TRANSMIT) = link.written - link.given;
    link.given = link.written;
}

bool uart_write(const uint8_t *frame, size_t count, bool lasts)
{
    while (busy(DMA_COPY))
        continue; /* of the frame before: a cycle or two a byte */
    const uint32_t waiting = link.begun - link.given + (busy(DMA_TRANSMIT) ? DMA_COUNT(DMA_TRANSMIT) : 0u);
    if (count > SEND_BYTES - waiting)
        return false;
    DMA_COUNT(DMA_COPY) = count;
    DMA_FROM_START(DMA_COPY) = (uint32_t)frame;
    link.begun += count;
    if (!lasts) {
        while (busy(DMA_COPY))
            continue;
        uart_pump();
    }
    return true;
}
