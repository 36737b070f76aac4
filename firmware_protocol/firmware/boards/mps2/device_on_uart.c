/* The device on an MPS2 board, with its first UART as the link. There is no encoder, no motor and no watchdog: the count stands
 * still and every effort is lost. It is the smallest whole port: a timer, a clock, a link.
 *
 * Registers: Arm Cortex-M System Design Kit Technical Reference Manual (DDI 0479), 4.3 "APB UART", 4.4 "APB dual-input
 * timers"; SysTick: Armv7-M Architecture Reference Manual, B3.3. Addresses and the clock: Arm AN385, 3.2 and 3.4. */
#include <string.h>

#include "board_config.h"
#include "mps2.h"
#include "poll.h"

#define CLOCK_HZ 25000000u

struct uart {
    volatile uint32_t data, state, control, interrupt, baud_divider;
};
#define UART0 ((struct uart *)0x40004000u)
#define TRANSMIT_FULL 1u
#define RECEIVE_FULL 2u
#define TRANSMIT_AND_RECEIVE 3u
#define BAUD 921600u

struct dual_timer {
    volatile uint32_t load, value, control;
};
#define TIMER ((struct dual_timer *)0x40002000u)
#define RUNS_FREE_32_BITS 0x82u

struct systick {
    volatile uint32_t control, reload, value;
};
#define SYSTICK ((struct systick *)0xE000E010u)
#define ENABLED_WITH_INTERRUPT_FROM_PROCESSOR_CLOCK 7u
#define RELOAD_LIMIT 0x00FFFFFFu

/* Frames that wait for the line: a tenth of a second at its rate. */
#define QUEUE_BYTES 16384u

static struct device device;
static struct {
    uint32_t last;   /* of the timer, which counts down */
    uint64_t cycles; /* since the start */
} clock;
static struct {
    uint8_t bytes[QUEUE_BYTES];
    uint32_t begins, count;
} queue;

static void mask(void)
{
    __asm volatile("cpsid i" ::: "memory");
}

static void unmask(void)
{
    __asm volatile("cpsie i" ::: "memory");
}

/* ------------------------------------------------------------------ the hardware layer */

static uint64_t hal_time(void *context)
{
    (void)context;
    const uint32_t value = TIMER->value;
    clock.cycles += clock.last - value;
    clock.last = value;
    return clock.cycles * 16u / (CLOCK_HZ / 1000000u);
}

static int32_t hal_encoder_count(void *context)
{
    (void)context;
    return 0;
}

static uint64_t hal_edge_time(void *context)
{
    (void)context;
    return 0;
}

static bool hal_encoder_failed(void *context)
{
    (void)context;
    return false;
}

static void hal_set_current(void *context, int16_t quanta)
{
    (void)context;
    (void)quanta;
}

static int16_t hal_measured_current(void *context)
{
    (void)context;
    return 0;
}

static void hal_enable(void *context, bool on)
{
    (void)context;
    (void)on;
}

static uint8_t hal_inputs(void *context)
{
    (void)context;
    return 0;
}

static bool hal_set_rate(void *context, uint32_t rate)
{
    (void)context;
    const uint32_t cycles = (CLOCK_HZ + rate / 2u) / rate;
    if (cycles == 0 || cycles - 1u > RELOAD_LIMIT)
        return false;
    SYSTICK->reload = cycles - 1u;
    return true;
}

static size_t hal_link_read(void *context, uint8_t *into, size_t capacity)
{
    (void)context;
    size_t count = 0;
    while (count < capacity && (UART0->state & RECEIVE_FULL))
        into[count++] = (uint8_t)UART0->data;
    return count;
}

static bool hal_link_write(void *context, const uint8_t *frame, size_t count)
{
    (void)context;
    if (count > QUEUE_BYTES - queue.count)
        return false;
    for (size_t i = 0; i < count; i++)
        queue.bytes[(queue.begins + queue.count + i) % QUEUE_BYTES] = frame[i];
    queue.count += (uint32_t)count;
    return true;
}

static void hal_feed_watchdog(void *context, uint32_t bite_us)
{
    (void)context;
    (void)bite_us;
}

static void hal_sync(void *context, uint8_t bits)
{
    (void)context;
    (void)bits;
}

static uint64_t hal_sync_time(void *context)
{
    (void)context;
    return 0;
}

static const struct hal hal = {
    .time = hal_time,
    .encoder_count = hal_encoder_count,
    .edge_time = hal_edge_time,
    .encoder_failed = hal_encoder_failed,
    .set_current = hal_set_current,
    .measured_current = hal_measured_current,
    .enable = hal_enable,
    .inputs = hal_inputs,
    .set_rate = hal_set_rate,
    .link_read = hal_link_read,
    .link_write = hal_link_write,
    .feed_watchdog = hal_feed_watchdog,
    .sync = hal_sync,
    .sync_time = hal_sync_time,
};

/* ------------------------------------------------------------------ the program */

/* Let the line have a byte, if it takes one. */
static void move_queue(void)
{
    if (queue.count == 0 || (UART0->state & TRANSMIT_FULL))
        return;
    UART0->data = queue.bytes[queue.begins];
    queue.begins = (queue.begins + 1u) % QUEUE_BYTES;
    queue.count--;
}

void tick(void)
{
    device_tick(&device);
}

int main(void)
{
    UART0->baud_divider = CLOCK_HZ / BAUD;
    UART0->control = TRANSMIT_AND_RECEIVE;
    TIMER->load = UINT32_MAX;
    TIMER->control = RUNS_FREE_32_BITS;
    clock.last = TIMER->value;
    mask();
    device_start(&device, &hal, &board_config);
    SYSTICK->value = 0;
    SYSTICK->control = ENABLED_WITH_INTERRUPT_FROM_PROCESSOR_CLOCK;
    unmask();
    for (;;) {
        mask(); /* device_tick and device_poll must not interrupt each other */
        device_poll(&device);
        move_queue();
        unmask();
    }
}
