#include "host.h"

#include "../core/poll.h"

static struct host *host_of(void *context)
{
    return context;
}

/* ------------------------------------------------------------------ the hardware layer */

static uint64_t hal_time(void *context)
{
    struct host *host = host_of(context);
    host->time += host->time_step;
    return host->time;
}

static int32_t hal_encoder_count(void *context)
{
    return host_of(context)->count;
}

static uint64_t hal_edge_time(void *context)
{
    return host_of(context)->edge_time;
}

static bool hal_encoder_failed(void *context)
{
    struct host *host = host_of(context);
    const bool failed = host->encoder_failed;
    host->encoder_failed = false;
    return failed;
}

static uint32_t hal_index_edges(void *context, int32_t *count)
{
    *count = host_of(context)->index_count;
    return host_of(context)->index_edges;
}

static void hal_set_current(void *context, int16_t quanta)
{
    struct host *host = host_of(context);
    if (!host->driving)
        host->cuts++;
    host->current = quanta;
}

static int16_t hal_measured_current(void *context)
{
    return host_of(context)->measured;
}

static void hal_enable(void *context, bool on)
{
    struct host *host = host_of(context);
    if (on)
        host->current = 0;
    else
        host->cuts++;
    host->enabled = on;
}

static uint8_t hal_inputs(void *context)
{
    return host_of(context)->inputs;
}

static bool hal_set_rate(void *context, uint32_t rate)
{
    struct host *host = host_of(context);
    if (rate == host->refused_rate || rate > HR_TIME_UNITS_PER_US * 1000000u)
        return false;
    host->rate = rate;
    return true;
}

static size_t hal_link_read(void *context, uint8_t *into, size_t capacity)
{
    struct host *host = host_of(context);
    return memory_read(&host->input, &host->input_count, into, capacity);
}

static bool hal_link_write(void *context, const uint8_t *frame, size_t count)
{
    struct host *host = host_of(context);
    if (!memory_write(host->output, &host->output_count, host->output_room, frame, count)) {
        host->dropped++;
        return false;
    }
    host->frames_driven += host->current != 0 ? 1u : 0u;
    return true;
}

static void hal_feed_watchdog(void *context, uint32_t bite_us)
{
    struct host *host = host_of(context);
    host->feeds++;
    host->bite_us = bite_us;
}

static void hal_sync(void *context, uint8_t bits)
{
    struct host *host = host_of(context);
    host->syncs += bits & ~host->sync & HR_SYNC_TICK ? 1u : 0u;
    host->sync = bits;
}

static void hal_enter_bootloader(void *context)
{
    host_of(context)->left = true;
}

static uint64_t hal_sync_time(void *context)
{
    return host_of(context)->sync_time;
}

/* ------------------------------------------------------------------ start */

size_t host_bytes(void)
{
    return sizeof(struct host);
}

void host_setup(struct host *host, const struct board_setup *setup)
{
    const struct hal hal = {
        .context = host,
        .time = hal_time,
        .encoder_count = hal_encoder_count,
        .edge_time = hal_edge_time,
        .encoder_failed = hal_encoder_failed,
        .index_edges = hal_index_edges,
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
    host->hal = hal;
    host->output_room = sizeof host->output;
    board_set_up(&host->board, setup);
    host->board.narrower = host->narrower;
    host->board.excitation = host->excitation;
    host->board.excitation_length = HR_HOST_EXCITATION;
}

void host_narrow(struct host *host, uint8_t parameter, uint32_t minimum, uint32_t maximum)
{
    const struct narrower narrower = {parameter, minimum, maximum};
    if (host->board.narrower_count < HR_HOST_NARROWER)
        host->narrower[host->board.narrower_count++] = narrower;
}

void host_set_excitation(struct host *host, uint32_t length)
{
    host->board.excitation_length = length < HR_HOST_EXCITATION ? length : HR_HOST_EXCITATION;
}

void host_start(struct host *host)
{
    device_start(&host->device, &host->hal, &host->board);
}

void host_restart(struct host *host)
{
    device_restart(&host->device);
}

/* ------------------------------------------------------------------ the world */

void host_set_world(struct host *host, uint64_t time, int32_t count, uint64_t edge_time, int16_t measured,
                    uint8_t inputs)
{
    host->time = time;
    host->count = count;
    host->edge_time = edge_time;
    host->measured = measured;
    host->inputs = inputs;
}

void host_set_clock(struct host *host, uint64_t time, uint64_t step)
{
    host->time = time;
    host->time_step = step;
}

void host_set_inputs(struct host *host, uint8_t inputs)
{
    host->inputs = inputs;
}

void host_fail_encoder(struct host *host)
{
    host->encoder_failed = true;
}

void host_set_sync_time(struct host *host, uint64_t time)
{
    host->sync_time = time;
}

void host_set_index(struct host *host, uint32_t edges, int32_t count)
{
    host->index_edges = edges;
    host->index_count = count;
}

void host_set_room(struct host *host, size_t bytes)
{
    host->output_room = bytes < sizeof host->output ? bytes : sizeof host->output;
}

void host_refuse_rate(struct host *host, uint32_t rate)
{
    host->refused_rate = rate;
}

/* ------------------------------------------------------------------ the device */

int16_t host_drive(struct host *host)
{
    host->driving = true;
    device_drive(&host->device);
    host->driving = false;
    return host->current;
}

void host_sample(struct host *host)
{
    device_sample(&host->device);
}

/* Do what a board's main loop does between two ticks while no bytes arrive. */
static void be_idle(struct host *host)
{
    for (unsigned i = 0; i < HR_HOST_POLLS && device_is_preparing(&host->device); i++)
        device_poll(&host->device);
}

void host_report(struct host *host)
{
    device_report(&host->device);
    be_idle(host);
}

void host_tick_alone(struct host *host)
{
    host->driving = true;
    device_tick(&host->device);
    host->driving = false;
}

void host_tick(struct host *host)
{
    host_tick_alone(host);
    device_flush(&host->device);
    host->device.unpolled = 0; /* the main loop runs and has nothing to do */
    be_idle(host);
}

void host_let_leave(struct host *host)
{
    host->hal.enter_bootloader = hal_enter_bootloader;
}

void host_was_reset(struct host *host, uint32_t stopped_at)
{
    device_was_reset(&host->device, stopped_at);
}

void host_fault(struct host *host, uint8_t fault)
{
    device_fault(&host->device, fault);
}

size_t host_poll(struct host *host, const uint8_t *bytes, size_t count)
{
    host->input = bytes;
    host->input_count = count;
    return device_poll(&host->device);
}

void host_receive(struct host *host, const uint8_t *bytes, size_t count)
{
    size_t taken = 0;
    while (taken < count)
        taken += host_poll(host, bytes + taken, count - taken);
    while (device_is_changing(&host->device))
        device_poll(&host->device);
}

size_t host_take(struct host *host, uint8_t *into, size_t capacity)
{
    return memory_take(host->output, &host->output_count, into, capacity);
}

bool host_law(const struct host *host, law_parameters *into)
{
    *into = host->device.renderer.parameters;
    return host->device.renderer.there;
}

void host_status(const struct host *host, struct host_status *status)
{
    const struct device *device = &host->device;
    status->time = device->time;
    status->due = device->due;
    status->sample_index = device->sample_index;
    status->rate = host->rate;
    status->cuts = host->cuts;
    status->feeds = host->feeds;
    status->bite_us = host->bite_us;
    status->dropped = host->dropped;
    status->frames_driven = host->frames_driven;
    status->current = host->current;
    status->state = device->connection.state;
    status->session = device->connection.session;
    status->fault = device->faults.latched;
    status->enabled = host->enabled;
    status->counters = device->connection.counters;
    status->sync = host->sync;
    status->left = host->left;
}
