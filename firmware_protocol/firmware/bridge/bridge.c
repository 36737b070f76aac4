#include "bridge.h"

#include <math.h>

#include "../core/poll.h"
#include "moteus.h"
#include "odrive.h"

#define UNITS_PER_SECOND (HR_TIME_UNITS_PER_US * 1000000u)
#define PREPARES UNITS_PER_SECOND /* how long a drive stays prepared without being armed */
#define FED_TICKS 2u         /* one feeding covers a set-point after a lost reply, too */
#define EXACT_COUNTS 8388608.0 /* 2²³: a float32 resolves such positions to half a count */
#define LONG (UNITS_PER_SECOND / 50u) /* no command lives for longer; a drive that starts again is silent for longer (assumed) */
#define JUMP 0.5             /* turns between two replies that no handle makes: the drive has started again */
#define GAIN 8             /* samples in which a phase is followed */
#define SLEW 128u          /* a share of a period: less than the hundredth that a host allows a device's clock */
#define POLLS 64u            /* of the core in a row */
#define STALE 2u             /* samples after an order: the first may be the reply to the order before it */
#define ENDING_FRAMES 3u

static const struct drive_kind *const KINDS[] = {
    [BRIDGE_MOTEUS] = &moteus_kind,
    [BRIDGE_ODRIVE] = &odrive_kind,
};

/* ------------------------------------------------------------------ frames */

static void send(struct bridge *bridge, const struct can_frame_bytes *frame)
{
    uint8_t *into = bridge->bus + bridge->bus_count;
    if (bridge->bus_count + FDCANUSB_LINE_BYTES > BRIDGE_BUS_BYTES)
        bridge->facts->unsent++;
    else
        bridge->bus_count += bridge->setup.socket ? socketcan_make(frame, into)
                                                  : fdcanusb_make(&bridge->adapter, frame, into);
}

/* Send the order to the drive, at the beginning of a period (`asks`) or at once. */
static void send_order(struct bridge *bridge, bool asks)
{
    const struct drive_order order = {
        .wish = bridge->wish,
        .asks = asks,
        .fed = bridge->fed > 0,
        .torque = (float)bridge_torque(bridge),
        .watchdog_s = (float)bridge->bite_us * 1e-6f,
        .wall = bridge->rendering ? &bridge->wall : NULL,
    };
    struct can_frame_bytes frames[DRIVE_FRAMES] = {0};
    if (bridge->bus_lost)
        return;
    const size_t count = bridge->kind->write_order(&bridge->drive, &order, frames);
    for (size_t i = 0; i < count; i++)
        send(bridge, &frames[i]);
}

static void set_wish(struct bridge *bridge, enum drive_wish wanted)
{
    bridge->wish = wanted;
    bridge->since = 0;
}

/* ------------------------------------------------------------------ the hardware layer */

static uint64_t hal_time(void *context)
{
    const struct bridge *bridge = context;
    return bridge->clock != NULL ? bridge->clock() : bridge->now;
}

static int32_t hal_encoder_count(void *context)
{
    return ((struct bridge *)context)->count;
}

/* A drive reports no times of edges. */
static uint64_t hal_edge_time(void *context)
{
    (void)context;
    return 0;
}

static bool hal_encoder_failed(void *context)
{
    struct bridge *bridge = context;
    const bool failed = bridge->count_failed;
    bridge->count_failed = false;
    return failed;
}

static void hal_set_current(void *context, int16_t quanta)
{
    struct bridge *bridge = context;
    if (!bridge->driving && (bridge->current != 0 || bridge->rendering))
        bridge->at_once = true;
    bridge->current = quanta;
    bridge->rendering = false; /* until the next tick sets it */
}

static int16_t hal_measured_current(void *context)
{
    const struct bridge *bridge = context;
    const double quanta = (double)bridge->drive.sample.torque / bridge->setup.torque_per_quantum;
    if (!(quanta > -32767.0)) /* NaN too: both are an over-current */
        return -32767;
    return (int16_t)(quanta < 32767.0 ? lrint(quanta) : 32767);
}

static bool hal_renders(void *context, const law_parameters *law, uint32_t rate)
{
    const struct bridge *bridge = context;
    struct drive_wall wall;
    return bridge->kind->renders != NULL && wall_of_law(&bridge->scales, law, rate, &wall)
           && bridge->kind->renders(&bridge->drive, &wall);
}

static void hal_enable(void *context, bool on)
{
    struct bridge *bridge = context;
    if (!on && bridge->wish == DRIVE_ON)
        bridge->at_once = true;
    set_wish(bridge, on ? DRIVE_ON : DRIVE_OFF);
    bridge->current = 0;
    bridge->rendering = false;
}

/* A drive that is switched on measures its current sensors first, for some hundredths of a second. */
static bool hal_amplifier_ready(void *context)
{
    struct bridge *bridge = context;
    if (bridge->bus_lost) {
        device_fault(&bridge->device, BRIDGE_BUS_LOST);
        return false;
    }
    if (bridge->wish == DRIVE_OFF)
        set_wish(bridge, DRIVE_PREPARE);
    bridge->wished_until = hal_time(bridge) + PREPARES;
    return bridge->drive.known && bridge->missed == 0 && bridge->since >= STALE && bridge->kind->is_on(&bridge->drive);
}

/* Pins of the drive, from its last reply. */
static uint8_t hal_inputs(void *context)
{
    const struct bridge *bridge = context;
    const uint32_t switches = bridge->drive.known ? bridge->drive.sample.switches : 0, hold = bridge->setup.hold;
    const bool stopped = (switches & bridge->setup.stop) != bridge->setup.stop;
    const bool held = hold != 0 && (switches & hold) == hold;
    return (uint8_t)((stopped ? HR_INPUT_EMERGENCY_STOP : 0) | (held ? HR_INPUT_HOLD_TO_RUN : 0));
}

static bool hal_set_rate(void *context, uint32_t rate)
{
    struct bridge *bridge = context;
    if (rate == 0 || rate > bridge->setup.rate_maximum)
        return false;
    const uint64_t period = UNITS_PER_SECOND / rate;
    if (bridge->cycle != 0 && (UNITS_PER_SECOND % rate != 0 || period % bridge->cycle != 0))
        return false; /* a drive that sends by itself is sampled every n-th message */
    bridge->period = period;
    return true;
}

static size_t hal_link_read(void *context, uint8_t *into, size_t capacity)
{
    struct bridge *bridge = context;
    return memory_read(&bridge->input, &bridge->input_count, into, capacity);
}

static bool hal_link_write(void *context, const uint8_t *frame, size_t count)
{
    struct bridge *bridge = context;
    return memory_write(bridge->output, &bridge->output_count, BRIDGE_OUTPUT_BYTES, frame, count);
}

static void hal_feed_watchdog(void *context, uint32_t bite_us)
{
    struct bridge *bridge = context;
    bridge->bite_us = bite_us;
    bridge->fed = FED_TICKS;
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

/* ------------------------------------------------------------------ start */

size_t bridge_bytes(void)
{
    return sizeof(struct bridge);
}

size_t bridge_facts_bytes(void)
{
    return sizeof(struct bridge_facts);
}

void bridge_setup(struct bridge *bridge, const struct bridge_setup *setup, struct bridge_facts *facts)
{
    const struct hal hal = {
        .context = bridge,
        .time = hal_time,
        .encoder_count = hal_encoder_count,
        .edge_time = hal_edge_time,
        .encoder_failed = hal_encoder_failed,
        .set_current = hal_set_current,
        .measured_current = hal_measured_current,
        .enable = hal_enable,
        .renders = hal_renders,
        .amplifier_ready = hal_amplifier_ready,
        .inputs = hal_inputs,
        .set_rate = hal_set_rate,
        .link_read = hal_link_read,
        .link_write = hal_link_write,
        .feed_watchdog = hal_feed_watchdog,
        .sync = hal_sync,
        .sync_time = hal_sync_time,
    };
    bridge->hal = hal;
    bridge->setup = *setup;
    bridge->facts = facts;
    bridge->kind = KINDS[setup->kind];
    bridge->cycle = (uint64_t)setup->cycle_us * HR_TIME_UNITS_PER_US;
    bridge->drive.prefix = setup->prefix;
    bridge->drive.id = setup->drive;
    bridge->drive.switches = (uint8_t)setup->switches;
    bridge->drive.limit = (float)setup->torque_limit;
    bridge->drive.kp = (float)setup->kp;
    bridge->drive.kd = (float)setup->kd;
    bridge->drive.beat = (uint64_t)setup->beat_us * HR_TIME_UNITS_PER_US;
    bridge->scales.counts_per_turn = setup->counts_per_turn;
    bridge->scales.torque_per_quantum = setup->torque_per_quantum;
    bridge->adapter.checksum = setup->checksum != 0;
    board_set_up(&bridge->board, &setup->board);
    bridge->board.narrower = bridge->narrower;
}

void bridge_narrow(struct bridge *bridge, uint8_t parameter, uint32_t minimum, uint32_t maximum)
{
    const struct narrower narrower = {parameter, minimum, maximum};
    if (bridge->board.narrower_count < BRIDGE_NARROWER)
        bridge->narrower[bridge->board.narrower_count++] = narrower;
}

void bridge_start(struct bridge *bridge, uint64_t now)
{
    bridge->now = bridge->due = now;
    device_start(&bridge->device, &bridge->hal, &bridge->board);
}

/* ------------------------------------------------------------------ replies of the drive */

static void take_count(struct bridge *bridge)
{
    const double counts = (double)bridge->drive.sample.position * bridge->setup.counts_per_turn;
    const double moved = counts - bridge->count;
    if (bridge->drive.known && fabs(moved) > JUMP * fabs(bridge->setup.counts_per_turn))
        bridge->count_failed = true;
    if (fabs(counts) < EXACT_COUNTS)
        bridge->count = (int32_t)lrint(counts);
    else /* nor is it a number */
        bridge->count_failed = true;
}

/* With a wall the effort is the drive's own: its reported torque, in quanta. */
static void take_effort(struct bridge *bridge)
{
    const double quanta = (double)bridge->drive.sample.rendered / bridge->setup.torque_per_quantum;
    if (bridge->rendering && fabs(quanta) < 32767.0)
        bridge->active = (int16_t)lrint(quanta);
}

static void note(struct bridge *bridge)
{
    struct bridge_facts *facts = bridge->facts;
    const struct drive_sample *sample = &bridge->drive.sample;
    const uint64_t us = (bridge->now - bridge->asked_at) / HR_TIME_UNITS_PER_US;
    facts->round_trips[us < BRIDGE_BINS ? us : BRIDGE_BINS - 1u]++;
    if ((int64_t)us > facts->longest_us)
        facts->longest_us = (int64_t)us;
    if (facts->replies++ == 0 || (int64_t)sample->temperature > facts->hottest)
        facts->hottest = (int64_t)sample->temperature;
    facts->temperature = (int64_t)sample->temperature;
    facts->millivolts = (int64_t)(1000.0f * sample->voltage);
    facts->mode = sample->mode;
    facts->code = sample->code;
    facts->limited += sample->limited ? 1 : 0;
}

/* Return true if this many periods without a sample end an armed run: a command has expired by then. */
static bool is_silent(const struct bridge *bridge, uint32_t periods)
{
    return periods >= BRIDGE_SILENT || (periods > 1u && periods * bridge->period >= LONG);
}

static void tick(struct bridge *bridge)
{
    if (is_silent(bridge, bridge->sampleless) && device_is_armed(&bridge->device))
        device_fault(&bridge->device, HR_FAULT_TICK_OVERRUN); /* this computer was late */
    device_tick_driven(&bridge->device, bridge->active, bridge->sampleless);
    bridge->sampleless = 0;
}

/* Move the next period to half a message ahead of its sample: at once for the first one, then by so little a tick that the
 * device's time and its count of samples stay together. The clocks differ by parts in ten thousand, a message's way by more. */
static void follow(struct bridge *bridge)
{
    const int64_t most = (int64_t)(bridge->period / SLEW);
    const int64_t error = (int64_t)(bridge->now + bridge->period - bridge->cycle / 2u - bridge->due);
    const int64_t step = error / GAIN;
    if (!bridge->drive.known)
        bridge->due += (uint64_t)error;
    else
        bridge->due += (uint64_t)(step > most ? most : step < -most ? -most : step);
}

/* The awaited sample: the tick. */
static void take_sample(struct bridge *bridge)
{
    bridge->drive.asked = false;
    bridge->missed = 0;
    bridge->since++;
    if (bridge->cycle != 0)
        follow(bridge);
    note(bridge);
    take_count(bridge);
    take_effort(bridge);
    bridge->drive.known = true;
    const uint8_t fault = bridge->kind->fault(&bridge->drive, bridge->wish, bridge->since);
    if (fault != HR_FAULT_NONE)
        device_fault(&bridge->device, fault);
    if (fault == BRIDGE_DRIVE_LEFT && bridge->kind->may_have_restarted(&bridge->drive))
        device_fault(&bridge->device, HR_FAULT_ENCODER);
    tick(bridge);
}

static void take_frame(struct bridge *bridge, const struct can_frame_bytes *frame)
{
    switch (bridge->kind->read_frame(&bridge->drive, frame, bridge->now)) {
    case DRIVE_FOREIGN:
        bridge->facts->foreign++;
        device_fault(&bridge->device, BRIDGE_OTHER_MASTER);
        break;
    case DRIVE_LATE:
        bridge->facts->late++;
        break;
    case DRIVE_INVALID:
        bridge->facts->invalid++;
        break;
    case DRIVE_SAMPLE:
        if (bridge->drive.known && bridge->now >= bridge->due)
            bridge->facts->late++; /* this computer was late: the reply is too old to be this period's sample */
        else
            take_sample(bridge);
        break;
    case DRIVE_OTHERS:
    case DRIVE_PART:
        break;
    }
}

static void receive_socket(struct bridge *bridge, const uint8_t *bytes, size_t count)
{
    struct can_frame_bytes frame;
    const enum socketcan_kind kind = socketcan_take(bytes, count, &frame);
    if (kind == SOCKETCAN_FRAME)
        take_frame(bridge, &frame);
    else if (kind == SOCKETCAN_BUS_OFF)
        device_fault(&bridge->device, BRIDGE_BUS_LOST);
}

static void receive_adapter(struct bridge *bridge, const uint8_t *bytes, size_t count)
{
    struct can_frame_bytes frame;
    const uint32_t garbled = bridge->adapter.garbled;
    for (size_t i = 0; i < count; i++)
        if (fdcanusb_take(&bridge->adapter, bytes[i], &frame))
            take_frame(bridge, &frame);
    bridge->facts->invalid += bridge->adapter.garbled - garbled;
    bridge->facts->refused = bridge->adapter.refused;
}

void bridge_receive_bus(struct bridge *bridge, const uint8_t *bytes, size_t count, uint64_t now)
{
    bridge->now = now;
    (bridge->setup.socket ? receive_socket : receive_adapter)(bridge, bytes, count);
}

/* ------------------------------------------------------------------ time passes */

/* Return true if a drive that missed so many in succession may have started again. */
static bool may_have_lost_turns(const struct bridge *bridge, uint32_t missed)
{
    return is_silent(bridge, missed) && missed * bridge->period >= LONG;
}

/* Count a missing reply. The core gets no sample; after several its session ends with a fault, which the host receives. */
static void miss_reply(struct bridge *bridge)
{
    const bool known = bridge->drive.known, lost_before = may_have_lost_turns(bridge, bridge->missed++);
    const bool forgets = !lost_before && may_have_lost_turns(bridge, bridge->missed);
    bridge->drive.asked = false;
    bridge->facts->lost += known ? 1 : 0;
    if (forgets || (is_silent(bridge, bridge->missed) && device_is_armed(&bridge->device)))
        device_fault(&bridge->device, bridge->bus_lost ? BRIDGE_BUS_LOST : BRIDGE_DRIVE_SILENT);
    if (forgets)
        device_fault(&bridge->device, HR_FAULT_ENCODER);
    if (is_silent(bridge, bridge->missed))
        tick(bridge);
    else
        bridge->sampleless++;
}

/* Return the next period; periods that this computer missed are skipped. */
static uint64_t next_period(struct bridge *bridge)
{
    const uint64_t behind = bridge->now > bridge->due ? bridge->now - bridge->due : 0, skipped = behind / bridge->period;
    bridge->facts->skipped += (int64_t)skipped;
    bridge->sampleless += (uint32_t)skipped;
    return bridge->due + (skipped + 1u) * bridge->period;
}

void bridge_tick(struct bridge *bridge, uint64_t now)
{
    bridge->now = now;
    if (bridge->drive.asked)
        miss_reply(bridge);
    if (bridge->wish == DRIVE_PREPARE && now > bridge->wished_until)
        hal_enable(bridge, false);
    const int16_t given = bridge->active;
    bridge->active = bridge->current;
    bridge->driving = true;
    device_drive(&bridge->device);
    bridge->driving = false;
    if (bridge->cycle != 0)
        bridge->active = bridge->current; /* which is half a message older than its sample */
    bridge->rendering = wall_now(&bridge->scales, &bridge->device, given, &bridge->wall);
    bridge->at_once = false;
    send_order(bridge, true);
    bridge->fed -= bridge->fed > 0 ? 1u : 0u;
    bridge->drive.asked = true;
    bridge->asked_at = now;
    bridge->due = next_period(bridge);
}

void bridge_receive_host(struct bridge *bridge, const uint8_t *bytes, size_t count, uint64_t now)
{
    bridge->now = now;
    bridge->input = bytes;
    bridge->input_count = count;
    while (bridge->input_count > 0)
        device_poll(&bridge->device);
}

void bridge_poll(struct bridge *bridge, uint64_t now)
{
    bridge->now = now;
    device_poll(&bridge->device);
    for (unsigned i = 0; i < POLLS && (device_is_sending(&bridge->device) || device_is_changing(&bridge->device)); i++)
        device_poll(&bridge->device);
    if (bridge->at_once)
        send_order(bridge, false);
    bridge->at_once = false;
}

void bridge_lose_bus(struct bridge *bridge, uint64_t now)
{
    bridge->now = now;
    bridge->bus_lost = true;
    bridge->bus_count = 0;
    device_fault(&bridge->device, BRIDGE_BUS_LOST);
}

void bridge_stop(struct bridge *bridge)
{
    set_wish(bridge, DRIVE_OFF);
    for (unsigned i = 0; i < ENDING_FRAMES; i++)
        send_order(bridge, false);
}

/* ------------------------------------------------------------------ outside */

size_t bridge_take(struct bridge *bridge, uint8_t *into, size_t capacity)
{
    return memory_take(bridge->output, &bridge->output_count, into, capacity);
}

size_t bridge_take_bus(struct bridge *bridge, uint8_t *into, size_t capacity)
{
    return memory_take(bridge->bus, &bridge->bus_count, into, capacity);
}

uint64_t bridge_due(const struct bridge *bridge)
{
    return bridge->due;
}

uint8_t bridge_state(const struct bridge *bridge)
{
    return bridge->device.connection.state;
}

uint8_t bridge_fault_now(const struct bridge *bridge)
{
    return bridge->device.faults.latched;
}

double bridge_torque(const struct bridge *bridge)
{
    return bridge->wish == DRIVE_ON ? bridge->current * bridge->setup.torque_per_quantum : 0.0;
}
