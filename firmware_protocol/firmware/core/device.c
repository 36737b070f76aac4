#include "device.h"

#include "bytes.h"

#define UNITS_PER_SECOND (HR_TIME_UNITS_PER_US * 1000000u)
#define UNARMED_STATES_A_SECOND 100u    /* enough to home by hand */
#define SUPERVISED_STATES_A_SECOND 200u /* beside BATCH, which has every tick */
#define IDLE_BITE_US 40000u             /* activating parameters may take some ms */
#define ARMED_BITE_TICKS 5u             /* of the hardware watchdog: 5 ms at 1 kHz */
#define SHORTEST_BITE_US 2000u
#define LONGEST_BITE_US 50000u
#define LIVELY_A_SECOND 50u             /* device_poll must be called within 20 ms, or LIVELY_TICKS if that is longer */
#define LIVELY_TICKS 3u
#define MISSED_A_SECOND 10u             /* more than this sets the flag MISSED_TICKS */
#define FAULT(name) (UINT32_C(1) << HR_FAULT_##name)
#define COMMANDED_PINS (HR_SYNC_TRIAL | HR_SYNC_INSIDE)

bool device_is_armed(const struct device *device)
{
    return device->connection.state == HR_STATE_ARMED || device->connection.state == HR_STATE_RUNNING;
}

bool device_is_preparing(const struct device *device)
{
    return device->renderer.there && !device->renderer.ready;
}

bool device_is_changing(const struct device *device)
{
    return device->live_change.step != LIVE_NOTHING;
}

static void show_sync(struct device *device, unsigned bits)
{
    if (bits != device->sync) {
        device->sync = (uint8_t)bits;
        device->hal->sync(device->hal->context, (uint8_t)bits);
    }
}

/* ------------------------------------------------------------------ start */

void device_start(struct device *device, const struct hal *hal, const struct board *board)
{
    device->hal = hal;
    device->board = board;
    device_restart(device);
}

void device_restart(struct device *device)
{
    struct candidate initial;
    device_switch_off(device);
    connection_reset(&device->connection);
    assembler_reset(&device->assembler);
    faults_reset(&device->faults);
    device->remembered.there = false;
    device->live_change.step = LIVE_NOTHING;
    device->configuration.homed = false;
    device->leaves_at = 0;
    device->sample_index = 0;
    device->time = device->hal->time(device->hal->context);
    device->received_at = device->time;
    device->count = device->hal->encoder_count(device->hal->context);
    configuration_initial(device->board, &initial);
    configuration_activate(&device->configuration, &initial);
    if (!device_apply(device, &initial))
        device_fault(device, HR_FAULT_INTERNAL);
    device_take_law(device, NULL, &initial);
    device_begin_session(device);
}

void device_begin_session(struct device *device)
{
    watchdog_idle(&device->watchdog, device->time);
    limits_cut(&device->limits);
    device->limits.unmoved = 0;
    monitor_forget(&device->monitor);
    current_forget(&device->current);
    device->limits.flags = 0;
    device->monitor.flags = 0;
    device->limits_acted = 0;
    device->reported_fault = HR_FAULT_NONE;
    device->state_due = 1;
    device->command_sequence = 0;
    device->command_sync = 0;
    device->commanded = false;
    device->supervised = false;
    batch_forget(&device->batch);
    device->state_left = 0;
    device->state_wanted = false;
    if (device->renderer.there)
        renderer_reset(&device->renderer);
    device->worst_execution_time = 0;
    device->missed_ticks = 0;
    device->missed_lately = 0;
}

/* ------------------------------------------------------------------ parameters */

static void apply_to_monitor(struct device *device, const uint32_t *values)
{
    const struct monitor_settings settings = {
        .rate = values[HR_PARAMETER_POSITION_RATE],
        .speed_limit = values[HR_PARAMETER_SPEED_LIMIT],
        .window_minimum = signed_32(values[HR_PARAMETER_WINDOW_MINIMUM]),
        .window_maximum = signed_32(values[HR_PARAMETER_WINDOW_MAXIMUM]),
        .current_limit = (uint16_t)values[HR_PARAMETER_CURRENT_LIMIT],
        .hold_to_run = values[HR_PARAMETER_HOLD_TO_RUN] != 0,
    };
    monitor_configure(&device->monitor, device->board, &settings, device->count);
}

static void apply_rate(struct device *device, uint32_t rate)
{
    device->rate = rate;
    device->period = UNITS_PER_SECOND / rate;
    device->period_rest = UNITS_PER_SECOND % rate;
    device->due = device->time + device->period;
    device->due_rest = device->period_rest;
    device->on_grid = false;
    device->most_unpolled = rate / LIVELY_A_SECOND > LIVELY_TICKS ? rate / LIVELY_A_SECOND : LIVELY_TICKS;
}

bool device_apply(struct device *device, const struct candidate *candidate)
{
    const uint32_t *values = candidate->values;
    const uint32_t rate = values[HR_PARAMETER_POSITION_RATE];
    const uint16_t continuous = (uint16_t)values[HR_PARAMETER_CONTINUOUS_CURRENT];
    if (!device->hal->set_rate(device->hal->context, rate))
        return false;
    apply_rate(device, rate);
    thermal_configure(&device->thermal, continuous, value_as_float(values[HR_PARAMETER_THERMAL_TIME_CONSTANT]), rate);
    const struct limits_settings limits = {
        .rate = rate,
        .largest = (uint16_t)values[HR_PARAMETER_CURRENT_LIMIT],
        .continuous = continuous,
        .slew = (uint16_t)values[HR_PARAMETER_SLEW_LIMIT],
        .confirm_ms = values[HR_PARAMETER_CONFIRM_MS],
    };
    limits_configure(&device->limits, &limits);
    apply_to_monitor(device, values);
    current_configure(&device->current, device->board, rate);
    device->needs_hold = values[HR_PARAMETER_HOLD_TO_RUN] != 0;
    device->command_lifetime_us = values[HR_PARAMETER_COMMAND_LIFETIME_US];
    device->supervise_lifetime_us = values[HR_PARAMETER_SUPERVISE_LIFETIME_US];
    device->ramp = values[HR_PARAMETER_RAMP_US] * HR_TIME_UNITS_PER_US;
    return true;
}

void device_take_law(struct device *device, const law_parameters *law, const struct candidate *candidate)
{
    const uint32_t *values = candidate->values;
    const uint32_t every = device->rate / SUPERVISED_STATES_A_SECOND;
    device->state_every = law != NULL && every > 0 ? every : 1u;
    batch_configure(&device->batch, (uint8_t)values[HR_PARAMETER_BATCH_LAYOUT],
                    (uint8_t)values[HR_PARAMETER_BATCH_SAMPLES]);
    if (law != NULL)
        renderer_configure(&device->renderer, law, device->board->excitation);
    else
        renderer_disable(&device->renderer);
}

/* ------------------------------------------------------------------ cutting */

void device_cut(struct device *device)
{
    limits_cut(&device->limits);
    device->driven = 0;
    device->hal->set_current(device->hal->context, 0);
}

void device_switch_on(struct device *device)
{
    const uint32_t bite_us = ARMED_BITE_TICKS * 1000000u / device->rate;
    device->bite_us = bite_us < SHORTEST_BITE_US ? SHORTEST_BITE_US
                      : bite_us < LONGEST_BITE_US ? bite_us : LONGEST_BITE_US;
    device_cut(device);
    device->hal->enable(device->hal->context, true);
}

void device_switch_off(struct device *device)
{
    device->bite_us = IDLE_BITE_US;
    device_cut(device);
    device->hal->enable(device->hal->context, false);
    show_sync(device, device->sync & HR_SYNC_TICK);
}

static void latch(struct device *device, uint32_t bits)
{
    faults_latch(&device->faults, bits, device->time);
    connection_fault(&device->connection);
    device_switch_off(device);
}

void device_fault(struct device *device, uint8_t fault)
{
    if (fault == HR_FAULT_ENCODER)
        device->configuration.homed = false;
    latch(device, UINT32_C(1) << fault);
}

void device_was_reset(struct device *device, uint32_t stopped_at)
{
    device->stopped_at = stopped_at;
    device_fault(device, stopped_at != 0 ? HR_FAULT_PROCESSOR_STOPPED : HR_FAULT_WATCHDOG_RESET);
}

/* ------------------------------------------------------------------ driving */

bool device_runs_law(const struct device *device)
{
    return device->supervised && device->renderer.there;
}

static int16_t wanted_current(struct device *device)
{
    if (device_runs_law(device))
        return watchdog_fade(&device->watchdog, device->due, device->renderer.current);
    return watchdog_choose(&device->watchdog, device->due, device->limits.current);
}

/* Current for the coming tick of an armed device. */
static int16_t next_current(struct device *device)
{
    const uint8_t inputs = device->hal->inputs(device->hal->context);
    if (inputs & HR_INPUT_EMERGENCY_STOP) {
        latch(device, FAULT(EMERGENCY_STOP));
        return 0;
    }
    const int16_t wanted = wanted_current(device);
    device->limits.beside = device_runs_law(device) && device->renderer.parameters.arithmetic == LAW_ELSEWHERE
                            && (device->renderer.flags & LAW_INSIDE) != 0;
    if (device->watchdog.ramping)
        device->limits.flags |= HR_LIMIT_RAMPING;
    if (device->watchdog.lost) {
        latch(device, FAULT(LINK_LOST));
        return 0;
    }
    if (device->needs_hold && !(inputs & HR_INPUT_HOLD_TO_RUN)) {
        device->limits.flags |= HR_LIMIT_HOLD_TO_RUN_RELEASED;
        device_cut(device);
        return 0;
    }
    return limits_apply(&device->limits, &device->thermal, wanted);
}

/* Return the sync bits of the trial, which change together with the active current. */
static unsigned sync_of(const struct device *device)
{
    const struct renderer *renderer = &device->renderer;
    unsigned bits = 0;
    if (!device_is_armed(device) || device->watchdog.ramping)
        return bits;
    if (!device_runs_law(device))
        return device->command_sync;
    if (renderer->phase == LAW_TRIAL)
        bits |= HR_SYNC_TRIAL;
    if (renderer->flags & LAW_INSIDE)
        bits |= HR_SYNC_INSIDE;
    return bits;
}

void device_drive(struct device *device)
{
    device->driven = device_is_armed(device) ? next_current(device) : 0;
    device->hal->set_current(device->hal->context, device->driven);
    show_sync(device, (device->sync & HR_SYNC_TICK) | sync_of(device));
}

/* ------------------------------------------------------------------ sampling */

/* The grid of the samples: a period that is no whole number of units does not drift. A timer that cannot keep
 * the exact rate leaves the grid slowly; half a period away from it, the grid follows. */
static void step_grid(struct device *device)
{
    const uint32_t half = device->period / 2u;
    if (device->time - device->due + half > 2u * (uint64_t)half) { /* modulo 2⁶⁴: further away, on either side */
        device->due = device->time;
        device->due_rest = 0;
    }
    device->due += device->period;
    device->due_rest += device->period_rest;
    if (device->due_rest >= device->rate) {
        device->due_rest -= device->rate;
        device->due++;
    }
}

static void step_index(struct device *device)
{
    device->sample_index++;
    if (device->command_age < HR_NO_COMMAND_YET)
        device->command_age++;
    step_grid(device);
}

/* Return the faults of a tick as bits 1 << code. Faults of the motion count in a session only; encoder faults always. */
static uint32_t faults_of(struct device *device, const struct fault_entry *tick)
{
    uint32_t bits = monitor_check(&device->monitor, tick->count, !device->limits.moved, tick->current_commanded,
                                  tick->current_measured);
    const bool disagrees =
        current_disagrees(&device->current, tick->count, tick->current_commanded, tick->current_measured);
    if (device->limits.beside) /* the driven current changes within a tick, of which one value is reported */
        current_forget(&device->current);
    else if (disagrees)
        bits |= FAULT(CURRENT_MISMATCH);
    if (thermal_is_overheated(&device->thermal))
        bits |= FAULT(THERMAL);
    if (device->connection.session == 0)
        bits = 0;
    if (device->hal->encoder_failed(device->hal->context)) {
        device->configuration.homed = false;
        bits |= FAULT(ENCODER);
    }
    return bits;
}

void device_sample(struct device *device)
{
    const struct hal *hal = device->hal;
    struct tick_report *tick = &device->tick;
    device->time = hal->time(hal->context);
    device->count = hal->encoder_count(hal->context);
    limits_pass(&device->limits, device->count);
    step_index(device);
    tick->logged = device->faults.latched == HR_FAULT_NONE;
    tick->supervised = device_is_armed(device) && device_runs_law(device);
    tick->sync = device->sync;
    tick->entry.sample_index = device->sample_index;
    tick->entry.count = device->count;
    tick->entry.current_commanded = device->driven;
    tick->entry.current_measured =
        current_subtract_zero(&device->current, hal->measured_current(hal->context), !device_is_armed(device));
    thermal_update(&device->thermal, tick->entry.current_measured);
    uint32_t bits = faults_of(device, &tick->entry);
    tick->entry.limits = device->limits.flags | device->monitor.flags;
    device->limits.flags = 0;
    device->monitor.flags = 0;
    if (bits == 0 && tick->supervised)
        bits = renderer_run(&device->renderer, device->count, device->driven, device->sample_index);
    if (bits != 0)
        latch(device, bits);
}

/* ------------------------------------------------------------------ reporting */

static uint32_t edge_time(const struct device *device)
{
    const uint64_t edge = device->hal->edge_time(device->hal->context);
    const uint64_t age = edge < device->time ? device->time - edge : 0;
    return (uint32_t)(device->time - (age < HR_OLDEST_EDGE ? age : HR_OLDEST_EDGE));
}

static uint16_t saturate(uint32_t number)
{
    return (uint16_t)(number < UINT16_MAX ? number : UINT16_MAX);
}

static uint8_t pins(const struct device *device)
{
    unsigned bits = device->hal->inputs(device->hal->context);
    if (device->tick.sync & HR_SYNC_TRIAL)
        bits |= HR_INPUT_SYNC_TRIAL;
    if (device->tick.sync & HR_SYNC_INSIDE)
        bits |= HR_INPUT_SYNC_INSIDE;
    return (uint8_t)bits;
}

/* Build the STATE of the newest tick; it is sent in pieces. */
static void make_state(struct device *device)
{
    const struct fault_entry *tick = &device->tick.entry;
    struct packet *packet = &device->state_packet;
    uint8_t *raw = connection_begin(&device->connection, packet, HR_INDEX_STATE, HR_BYTES_STATE);
    put_u16(raw + HR_AT_STATE_COMMAND_SEQUENCE, device->command_sequence);
    put_u16(raw + HR_AT_STATE_COMMAND_AGE, device->commanded ? device->command_age : HR_NO_COMMAND_YET);
    put_u32(raw + HR_AT_STATE_SAMPLE_INDEX, tick->sample_index);
    put_u32(raw + HR_AT_STATE_DEVICE_TIME, (uint32_t)device->time);
    put_u32(raw + HR_AT_STATE_COUNT, (uint32_t)tick->count);
    put_u32(raw + HR_AT_STATE_EDGE_TIME, edge_time(device));
    put_u16(raw + HR_AT_STATE_CURRENT_MEASURED, (uint16_t)tick->current_measured);
    put_u16(raw + HR_AT_STATE_CURRENT_COMMANDED, (uint16_t)tick->current_commanded);
    put_u16(raw + HR_AT_STATE_LIMITS, device->limits_acted);
    put_u16(raw + HR_AT_STATE_FAULT, device->faults.latched);
    put_u16(raw + HR_AT_STATE_EXECUTION_TIME, saturate(device->worst_execution_time));
    put_u16(raw + HR_AT_STATE_MISSED_TICKS, saturate(device->missed_ticks));
    raw[HR_AT_STATE_STATE] = device->connection.state;
    raw[HR_AT_STATE_INPUTS] = pins(device);
    raw[HR_AT_STATE_PHASE] = device->renderer.phase;
    put_u32(raw + HR_AT_STATE_SYNC_TIME, (uint32_t)device->hal->sync_time(device->hal->context));
    builder_begin(&device->state_builder, packet->bytes);
    device->state_left = packet->count;
    device->state_wanted = false;
    device->limits_acted = 0;
    device->reported_fault = device->faults.latched;
}

/* Return true if a STATE is due in a device that is not armed. */
static bool shows_itself(const struct device *device)
{
    const uint32_t every = device->rate / UNARMED_STATES_A_SECOND;
    return device->connection.state != HR_STATE_BOOT && device->sample_index % (every > 0 ? every : 1u) == 0;
}

/* In a session: every so many ticks, and at once when a fault is latched. */
static bool state_is_due(struct device *device)
{
    if (device->connection.session == 0)
        return shows_itself(device);
    if (--device->state_due > 0 && device->faults.latched == device->reported_fault)
        return false;
    device->state_due = device->state_every;
    return true;
}

static void send_batch(struct device *device)
{
    size_t count;
    const uint8_t *frame = batch_take(&device->batch, &count);
    if (frame != NULL)
        device->hal->link_write(device->hal->context, frame, count);
}

/* Queue the frame that is being made; the queue holds one. */
static void finish_batch(struct device *device)
{
    if (device->batch.samples == 0)
        return;
    send_batch(device);
    batch_finish(&device->batch);
}

/* Pack at most `most` bytes of STATE, and send the frame when it is complete. */
static void send_state(struct device *device, size_t most)
{
    struct builder *builder = &device->state_builder;
    const size_t bytes = device->state_left < most ? device->state_left : most;
    builder_append(builder, builder->bytes + builder->end, bytes);
    device->state_left -= bytes;
    if (device->state_left == 0) {
        const size_t count = builder_finish(builder);
        device->hal->link_write(device->hal->context, builder->bytes, count);
    }
}

bool device_is_sending(const struct device *device)
{
    return device->batch.waiting || device->state_left > 0 || device->state_wanted;
}

void device_flush(struct device *device)
{
    send_batch(device);
    if (device->state_left > 0)
        send_state(device, device->state_left);
    if (device->state_wanted) {
        make_state(device);
        send_state(device, device->state_left);
    }
}

bool device_send_some(struct device *device, size_t most)
{
    if (batch_pack(&device->batch, most))
        return true;
    if (device->state_every == 1u && device_is_sending(device))
        device_flush(device); /* no law runs here, and the host's loop waits for this STATE */
    else if (device->batch.waiting)
        send_batch(device);
    else if (device->state_left > 0)
        send_state(device, most);
    else if (device->state_wanted)
        make_state(device);
    else
        return false;
    return true;
}

void device_end_supervision(struct device *device)
{
    finish_batch(device);
    send_batch(device);
    device->supervised = false;
}

/* Append the tick to BATCH. A frame is finished when it is full, before a gap, and when supervision has ended. */
static void report_in_batch(struct device *device)
{
    struct batch *batch = &device->batch;
    const struct tick_report *tick = &device->tick;
    if (tick->supervised) {
        if (!batch_fits(batch, tick->entry.sample_index))
            finish_batch(device);
        if (!batch_push(batch, &device->connection, &tick->entry, (uint32_t)device->time))
            latch(device, FAULT(BATCH_OVERFLOW));
    }
    if (!tick->supervised || batch_is_full(batch) || device->faults.latched != HR_FAULT_NONE)
        finish_batch(device);
}

/* Store the tick in the fault ring and in BATCH, and mark a STATE that is due. Nothing is sent here. */
static void report_tick(struct device *device)
{
    const struct fault_entry *entry = &device->tick.entry;
    if (device->tick.logged)
        faults_remember(&device->faults, entry);
    device->limits_acted |= entry->limits;
    if (device->renderer.there)
        report_in_batch(device);
    if (state_is_due(device))
        device->state_wanted = true;
}

void device_report(struct device *device)
{
    report_tick(device);
    device_flush(device);
}

/* ------------------------------------------------------------------ the tick of a board */

/* Count ticks of the timer that were missed before a late one. */
static void miss(struct device *device, uint32_t ticks)
{
    if (device->missed_lately == 0 || device->sample_index - device->lately >= device->rate) {
        device->lately = device->sample_index;
        device->missed_lately = 0;
    }
    device->missed_ticks += ticks;
    device->missed_lately += ticks;
    if (device->missed_lately > MISSED_A_SECOND)
        device->limits.flags |= HR_LIMIT_MISSED_TICKS;
    for (uint32_t i = 0; i < ticks; i++) { /* 2000 at most: 40 ms at 50 kHz, then the hardware watchdog resets the board */
        device->time = device->due;
        step_index(device);
        if (device->connection.session != 0 && device->state_every == 1)
            connection_skip(&device->connection, HR_INDEX_STATE);
    }
}

/* Return the number of whole periods by which a tick is late. */
static uint32_t missed_by(const struct device *device, uint64_t begun)
{
    return begun > device->due ? (uint32_t)((begun - device->due) / device->period) : 0;
}

static void begin_tick(struct device *device, uint32_t missed)
{
    const struct hal *hal = device->hal;
    show_sync(device, device->sync | HR_SYNC_TICK);
    if (device->on_grid && missed > 0)
        miss(device, missed);
    device->on_grid = true;
    if (++device->unpolled <= device->most_unpolled)
        hal->feed_watchdog(hal->context, device->bite_us);
    else if (device_is_armed(device))
        latch(device, FAULT(INTERNAL));
}

static void end_tick(struct device *device, uint64_t begun)
{
    show_sync(device, device->sync & ~(unsigned)HR_SYNC_TICK);
    const uint64_t execution = device->hal->time(device->hal->context) - begun;
    if (execution > device->worst_execution_time)
        device->worst_execution_time = (uint32_t)execution;
    if (device_is_armed(device) && execution > device->period)
        latch(device, FAULT(TICK_OVERRUN));
}

void device_tick(struct device *device)
{
    const uint64_t begun = device->hal->time(device->hal->context);
    const uint32_t missed = missed_by(device, begun);
    const bool overran = device->on_grid && missed > 1u;
    begin_tick(device, missed);
    if (overran && device_is_armed(device))
        latch(device, FAULT(TICK_OVERRUN));
    device_sample(device);
    device_drive(device);
    report_tick(device);
    end_tick(device, begun);
}

void device_tick_driven(struct device *device, int16_t active, uint32_t missed)
{
    const uint64_t begun = device->hal->time(device->hal->context);
    begin_tick(device, missed);
    if (device_is_armed(device)) /* otherwise the current was set to zero */
        device->driven = active;
    device_sample(device);
    report_tick(device);
    end_tick(device, begun);
}

/* ------------------------------------------------------------------ commands */

void device_send(struct device *device, struct packet *packet)
{
    const size_t count = frame_finish(packet);
    device->hal->link_write(device->hal->context, packet->bytes, count);
}

static void begin_supervision(struct device *device)
{
    device->supervised = true;
    if (device->renderer.there)
        renderer_reset(&device->renderer);
}

/* The current first: packing and sending take time. */
static void stop(struct device *device)
{
    device_cut(device);
    device->command_sync = 0;
    show_sync(device, device->sync & HR_SYNC_TICK);
    watchdog_idle(&device->watchdog, device->time);
    device_end_supervision(device);
}

/* Return the lifetime of a command in device time, within the cap of the parameters. */
static uint32_t lifetime_of(const struct device *device, const uint8_t *raw)
{
    const uint32_t wanted_us = get_u32(raw + HR_AT_COMMAND_LIFETIME_US);
    const bool supervises = raw[HR_AT_COMMAND_MODE] == HR_MODE_SUPERVISE;
    const uint32_t cap_us = supervises ? device->supervise_lifetime_us : device->command_lifetime_us;
    return (wanted_us < cap_us ? wanted_us : cap_us) * HR_TIME_UNITS_PER_US;
}

/* Return true if the STATE that a command answers was sent more than a lifetime ago, counted in STATEs sent since: its
 * transport took too long. A command before the first STATE names the first one. */
static bool is_too_old(const struct device *device, const uint8_t *raw, uint32_t lifetime)
{
    const uint16_t to_come = device->connection.to_send[HR_INDEX_STATE];
    const uint16_t behind = (uint16_t)(to_come - get_u16(raw + HR_AT_COMMAND_STATE_SEQUENCE));
    return behind > 1u && (uint64_t)((behind - 1u) * device->state_every) * device->period > lifetime;
}

void device_command(struct device *device, const uint8_t *raw)
{
    const uint8_t mode = raw[HR_AT_COMMAND_MODE];
    const uint32_t lifetime = lifetime_of(device, raw);
    if (mode != HR_MODE_CURRENT && mode != HR_MODE_SUPERVISE && mode != HR_MODE_STOP) {
        device->connection.counters.malformed++;
        return;
    }
    if (mode != HR_MODE_STOP && is_too_old(device, raw, lifetime)) {
        device->connection.counters.reordered++;
        device->limits.flags |= HR_LIMIT_COMMAND_TOO_OLD;
        return;
    }
    device->command_sequence = get_u16(raw + HR_AT_HEADER_SEQUENCE);
    device->command_age = 0;
    device->commanded = true;
    if (mode == HR_MODE_STOP) {
        stop(device);
        return;
    }
    if (mode != HR_MODE_SUPERVISE)
        device_end_supervision(device);
    else if (!device->supervised)
        begin_supervision(device);
    const int16_t current = device->supervised ? 0 : signed_16(get_u16(raw + HR_AT_COMMAND_CURRENT));
    device->command_sync = device->supervised ? 0 : raw[HR_AT_COMMAND_FLAGS] & COMMANDED_PINS;
    watchdog_feed(&device->watchdog, device->time, current, lifetime, device->ramp);
}
