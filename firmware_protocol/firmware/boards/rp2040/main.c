/* The device on a Raspberry Pi Pico: the core's hardware layer, the interrupt of the tick, and the link between ticks. */
#include "board_config.h"
#include "amplifier.h"
#include "clocks.h"
#include "encoder.h"
#include "flash.h"
#include "link.h"
#include "output.h"
#include "pins.h"
#include "poll.h"
#include "registers.h"
#include "reset.h"
#include "timekeeping.h"

/* Longest time of one poll of the link. Nearer to the next tick no poll begins, except for the first since the last
 * tick. */
#define POLL_CYCLES (CLOCK_HZ / 100000u)

static struct device device;

/* ------------------------------------------------------------------ the hardware layer */

static uint64_t hal_time(void *context)
{
    (void)context;
    return time_now();
}

static int32_t hal_encoder_count(void *context)
{
    (void)context;
    return encoder_count();
}

static uint64_t hal_edge_time(void *context)
{
    (void)context;
    return encoder_edge_time();
}

static bool hal_encoder_failed(void *context)
{
    (void)context;
    return encoder_failed();
}

#if defined(BOARD_ENCODER_INDEX_WIRED)
static uint32_t hal_index_edges(void *context, int32_t *count)
{
    (void)context;
    return encoder_index_edges(count);
}
#endif

static void hal_set_current(void *context, int16_t quanta)
{
    (void)context;
    amplifier_set_current(quanta);
}

static int16_t hal_measured_current(void *context)
{
    (void)context;
    return amplifier_measured_current();
}

static void hal_enable(void *context, bool on)
{
    (void)context;
    amplifier_enable(on);
}

static uint8_t hal_inputs(void *context)
{
    (void)context;
    return pins_inputs();
}

static bool hal_set_rate(void *context, uint32_t rate)
{
    (void)context;
    return tick_set_rate(rate);
}

static size_t hal_link_read(void *context, uint8_t *into, size_t capacity)
{
    (void)context;
    return link_read(into, capacity, device_is_armed(&device));
}

/* A BATCH frame is in struct device and stays there for a tick at least; other frames are on the stack. */
static bool hal_link_write(void *context, const uint8_t *frame, size_t count)
{
    (void)context;
    const uint8_t *begins = (const uint8_t *)&device;
    return link_write(frame, count, frame >= begins && frame < begins + sizeof device);
}

static void hal_feed_watchdog(void *context, uint32_t bite_us)
{
    (void)context;
    watchdog_feed_hardware(bite_us);
}

static void hal_enter_bootloader(void *context)
{
    (void)context;
    reset_to_bootloader();
}

static void hal_sync(void *context, uint8_t bits)
{
    (void)context;
    pins_sync(bits);
}

static uint64_t hal_sync_time(void *context)
{
    (void)context;
    return encoder_sync_time();
}

static const struct hal hal = {
    .time = hal_time,
    .encoder_count = hal_encoder_count,
    .edge_time = hal_edge_time,
    .encoder_failed = hal_encoder_failed,
#if defined(BOARD_ENCODER_INDEX_WIRED)
    .index_edges = hal_index_edges,
#endif
    .set_current = hal_set_current,
    .measured_current = hal_measured_current,
    .enable = hal_enable,
    .inputs = hal_inputs,
    .set_rate = hal_set_rate,
    .link_read = hal_link_read,
    .link_write = hal_link_write,
    .feed_watchdog = hal_feed_watchdog,
    .enter_bootloader = hal_enter_bootloader,
    .sync = hal_sync,
    .sync_time = hal_sync_time,
};

/* ------------------------------------------------------------------ the tick */

void tick_interrupt(void)
{
    tick_taken();
    if (output_stalled())
        device_fault(&device, HR_FAULT_OUTPUT_STALLED);
    device_tick(&device);
    link_pump();
}

/* ------------------------------------------------------------------ the link, between ticks */

static void mask(void)
{
    __asm volatile("cpsid i" ::: "memory");
}

static void unmask(void)
{
    __asm volatile("cpsie i" ::: "memory");
}

/* The tick waits while the core takes bytes; so that happens behind a tick, where there is time. */
static void converse(void)
{
    const volatile uint32_t *unpolled = &device.unpolled; /* the tick counts it */
    if (*unpolled == 0 && tick_cycles_left() < POLL_CYCLES)
        return;
    mask();
#if defined(BOARD_ENCODER_INDEX_WIRED)
    encoder_look_for_index();
#endif
    time_look();
    device_poll(&device);
    link_pump();
    unmask();
}

int main(void)
{
    clocks_release(RESET_IO_BANK0 | RESET_PADS_BANK0 | RESET_DMA | RESET_PIO0 | RESET_PWM | RESET_ADC | RESET_TIMER
                   | RESET_UART0);
    uint32_t stopped_at;
    const bool bitten = reset_by_watchdog(&stopped_at);
    amplifier_start();
    pins_start();
    time_start();
    encoder_start();
    const uint64_t id = flash_unique_id();
    link_start(id != 0 && id != UINT64_MAX ? id : board_config.dictionary_hash);
    device_start(&device, &hal, &board_config);
    if (bitten)
        device_was_reset(&device, stopped_at);
    watchdog_start(device.bite_us);
    tick_start();
    unmask();
    for (;;)
        converse();
}
