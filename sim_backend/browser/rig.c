/* A simulated rig in a browser: the firmware as a board runs it, and the plant behind it. The page fills `rig_setup` and
 * `rig_block`, calls `rig_begin`, and reads the rows that `rig_run` has written. The order of a tick is that of
 * sim_backend.board.lockstep. */
#include <math.h>
#include <string.h>

#include "../../firmware_protocol/firmware/core/bytes.h"
#include "../../firmware_protocol/firmware/core/law_settings.h"
#include "../../firmware_protocol/firmware/host/host.h"
#include "../mechanics/plant.h"
#include "rig.h"

#define COMMANDS_A_SECOND 200u /* of a host that supervises */
#define PEAK 32767.0

enum { /* of rig_setup; then the plant's parameters, phi and gamma */
    AT_ORDER, AT_MASSES, AT_DELAY, AT_HANDLE, AT_EFFORT, AT_POSITION, AT_EFFORT_QUANTUM, AT_AMPERE_PER_EFFORT, AT_QUANTUM_A,
    AT_ENCODER_SIGN, AT_OVER_CURRENT, AT_MECHANICS, AT_SENSOR = AT_MECHANICS + 7, AT_RATE = AT_SENSOR + 4, AT_LIFETIME_US,
    AT_INPUTS, AT_PLANT
};

double rig_setup[512], rig_script[RIG_SCRIPT_ROWS * INTENTIONS], rig_rows[RIG_ROWS * RIG_COLUMNS];
uint8_t rig_block[HR_FULL_BLOCK_BYTES];

static struct host host;
static struct plant plant;
static double state[64];
static law_parameters waiting; /* another wall, until the handle is outside of both */
static bool waits;
static uint32_t quiet_ticks; /* since the last command */

static void set_up_board(void)
{
    const double *s = rig_setup, *m = s + AT_MECHANICS, *c = s + AT_SENSOR;
    const struct board_setup setup = {
        .rate_initial = (uint32_t)s[AT_RATE],
        .encoder_sign = (int32_t)s[AT_ENCODER_SIGN],
        .over_current = (uint32_t)s[AT_OVER_CURRENT],
        .mechanics = {m[0], m[1], m[2], m[3], m[4], m[5], m[6]},
        .current_sensor = {c[0], c[1], c[2], c[3]},
    };
    memset(&host, 0, sizeof host);
    host_setup(&host, &setup);
}

static void set_up_plant(void)
{
    const double *s = rig_setup;
    plant.order = (int)s[AT_ORDER];
    plant.delay_ticks = (int)s[AT_DELAY];
    plant.parameters = s + AT_PLANT;
    plant.phi = plant.parameters + PLANT_PARAMETERS;
    plant.gamma = plant.phi + plant.order * plant.order;
    plant.state = state;
    memset(state, 0, sizeof state);
    const int rig_order = s[AT_MASSES] > 1.0 ? TWO_MASS_ORDER : RIGID_ORDER;
    state[0] = state[(int)s[AT_HANDLE]] = s[AT_POSITION];
    if (plant.order > rig_order) /* in a hand, which wants to stay there */
        state[rig_order] = state[rig_order + 2] = s[AT_POSITION];
    state[plant.order] = INFINITY;
}

static void cut_after(uint32_t cuts)
{
    if (host.cuts != cuts)
        memset(state + plant.order + 1, 0, (size_t)plant.delay_ticks * sizeof *state);
}

/* The keep-alive of a host that supervises. */
static void command(void)
{
    uint8_t raw[HR_BYTES_COMMAND] = {0};
    put_u16(raw + HR_AT_COMMAND_STATE_SEQUENCE, (uint16_t)(host.device.connection.to_send[HR_INDEX_STATE] - 1u));
    put_u32(raw + HR_AT_COMMAND_LIFETIME_US, (uint32_t)rig_setup[AT_LIFETIME_US]);
    raw[HR_AT_COMMAND_MODE] = HR_MODE_SUPERVISE;
    device_command(&host.device, raw);
    quiet_ticks = 0;
}

static int refused(struct refusal refusal)
{
    return (int)refusal.status << 16 | refusal.detail;
}

int rig_begin(int bytes)
{
    struct device *device = &host.device;
    struct candidate candidate;
    law_parameters law;
    set_up_board();
    set_up_plant();
    host.inputs = (uint8_t)rig_setup[AT_INPUTS];
    host.count = (int32_t)plant_count(&plant);
    host_start(&host);
    waits = false;
    struct refusal refusal =
        configuration_read(&device->configuration, &host.board, rig_block, (size_t)bytes, &candidate);
    if (refusal.status == HR_STATUS_OK)
        refusal = law_settings_read(candidate.values, &host.board, &host.hal, &law);
    if (refusal.status != HR_STATUS_OK)
        return refused(refusal);
    if (!device_apply(device, &candidate))
        return HR_STATUS_INCONSISTENT << 16;
    device_take_law(device, &law, &candidate);
    configuration_activate(&device->configuration, &candidate);
    device_begin_session(device);
    device_switch_on(device);
    device->connection.state = HR_STATE_RUNNING;
    device->connection.session = 1;
    command();
    return 0;
}

int rig_change(int bytes)
{
    struct candidate candidate;
    const struct configuration *active = &host.device.configuration;
    struct refusal refusal = configuration_read(active, &host.board, rig_block, (size_t)bytes, &candidate);
    law_parameters wall = host.device.renderer.parameters;
    if (refusal.status == HR_STATUS_OK)
        refusal = law_settings_read_wall(candidate.values, &host.hal, &wall);
    if (refusal.status == HR_STATUS_OK) { /* else the wall that waits already still becomes active */
        waiting = wall;
        waits = true;
    }
    return refused(refusal);
}

int rig_most_rows(void)
{
    return RIG_ROWS;
}

int rig_waits(void)
{
    return waits;
}

int rig_fault(void)
{
    return host.device.faults.latched;
}

static void change_outside(void)
{
    struct renderer *renderer = &host.device.renderer;
    const int32_t count = host.device.count;
    if (waits && law_is_free(&renderer->parameters, count) && law_is_free(&waiting, count)) {
        renderer_change(renderer, &waiting);
        waits = false;
    }
}

static int16_t quanta(double current_a)
{
    const double whole = current_a / rig_setup[AT_QUANTUM_A];
    return (int16_t)floor((whole < -PEAK ? -PEAK : whole > PEAK ? PEAK : whole) + 0.5);
}

static void want(int row, int script_rows)
{
    if (script_rows == 0)
        return;
    const double *wanted = rig_script + (row < script_rows ? row : script_rows - 1) * INTENTIONS;
    memcpy(state + plant.order - INTENTIONS, wanted, INTENTIONS * sizeof *wanted);
}

static void tick(int row, int script_rows)
{
    uint32_t cuts = host.cuts;
    const int16_t driven = host_drive(&host);
    cut_after(cuts);
    want(row, script_rows);
    const int64_t count = plant_advance(&plant, driven * rig_setup[AT_EFFORT_QUANTUM], 0.0);
    const double effort = state[(int)rig_setup[AT_EFFORT]];
    cuts = host.cuts;
    host_set_world(&host, host.device.due, (int32_t)count, 0, quanta(effort * rig_setup[AT_AMPERE_PER_EFFORT]), host.inputs);
    host_sample(&host);
    cut_after(cuts);
}

static void write_row(double *row)
{
    const struct device *device = &host.device;
    const struct fault_entry *entry = &device->tick.entry;
    const double *handle = state + (int)rig_setup[AT_HANDLE];
    row[RIG_COUNT] = entry->count;
    row[RIG_ACTIVE] = entry->current_commanded;
    row[RIG_CURRENT] = device->renderer.current;
    row[RIG_MEASURED] = entry->current_measured;
    row[RIG_PHASE] = device->renderer.phase;
    row[RIG_FLAGS] = device->renderer.flags;
    row[RIG_LIMITS] = entry->limits;
    row[RIG_VELOCITY] = device->renderer.state.velocity;
    row[RIG_POSITION_TRUE] = state[0];
    row[RIG_VELOCITY_TRUE] = state[1];
    row[RIG_EFFORT_TRUE] = state[(int)rig_setup[AT_EFFORT]];
    row[RIG_HANDLE] = handle[0];
    row[RIG_HANDLE_VELOCITY] = handle[1];
    row[RIG_HAND] = state[rig_setup[AT_MASSES] > 1.0 ? TWO_MASS_ORDER : RIGID_ORDER];
}

int rig_run(int ticks, int script_rows)
{
    int row = 0;
    while (row < ticks && row < RIG_ROWS) {
        if (++quiet_ticks >= host.device.rate / COMMANDS_A_SECOND)
            command();
        change_outside();
        tick(row, script_rows);
        write_row(rig_rows + row * RIG_COLUMNS);
        row++;
        if (host.device.renderer.phase == LAW_DONE || host.device.faults.latched != HR_FAULT_NONE)
            break;
    }
    return row;
}
