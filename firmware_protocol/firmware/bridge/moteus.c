#include "moteus.h"

#include <math.h>
#include <string.h>

#include "../core/device.h"

enum subframe {
    WRITE_INT8 = 0x00,
    WRITE_FLOAT = 0x0c,
    READ_INT8 = 0x10,
    READ_FLOAT = 0x1c,
    REPLY = 0x20,
    REPLY_END = 0x30,
    NOTHING = 0x50,
};

enum number { INT8, INT16, INT32, FLOAT };

enum moteus_register {
    MODE = 0x000,
    POSITION = 0x001,
    TORQUE = 0x003,
    VOLTAGE = 0x00d,
    TEMPERATURE = 0x00e,
    CODE = 0x00f,
    COMMAND_POSITION = 0x020, /* then the velocity */
    COMMAND_TORQUE = 0x022,
    COMMAND_GAINS = 0x023, /* kp, kd */
    COMMAND_LIMIT = 0x025,
    COMMAND_WATCHDOG = 0x027,
    COMMAND_INTEGRAL = 0x02b,
    CONTROL_TORQUE = 0x03a,
    COMMAND_WITHIN = 0x040, /* lower and upper bound, torque, kp, kd, limit, watchdog, integral */
};

#define NO_POSITION 0x80u /* of an int8: where it is */
#define WANTED 6u         /* registers that a reply must have, the switches apart */

/* ------------------------------------------------------------------ to the drive */

static void put(struct can_frame_bytes *frame, unsigned byte)
{
    frame->bytes[frame->count++] = (uint8_t)byte;
}

/* The head of a subframe; up to three registers are counted in its type. */
static void head(struct can_frame_bytes *frame, enum subframe type, unsigned registers, unsigned first)
{
    put(frame, (unsigned)type | registers);
    put(frame, first);
}

static void put_float(struct can_frame_bytes *frame, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    for (unsigned shift = 0; shift < 32; shift += 8)
        put(frame, bits >> shift & 0xFFu);
}

static void write_float(struct can_frame_bytes *frame, enum moteus_register at, float value)
{
    head(frame, WRITE_FLOAT, 1, at);
    put_float(frame, value);
}

static void write_two(struct can_frame_bytes *frame, enum moteus_register at, unsigned first, unsigned second)
{
    head(frame, WRITE_INT8, 2, at);
    put(frame, first);
    put(frame, second);
}

/* Mode 10 without its position controller: only the feed-forward torque remains. */
static void write_torque(struct can_frame_bytes *frame, const struct moteus_command *command)
{
    write_two(frame, COMMAND_POSITION, NO_POSITION, 0);
    write_float(frame, COMMAND_TORQUE, command->torque);
    write_two(frame, COMMAND_GAINS, 0, 0);
    write_float(frame, COMMAND_LIMIT, command->limit);
    write_float(frame, COMMAND_WATCHDOG, command->watchdog_s);
    head(frame, WRITE_INT8, 1, COMMAND_INTEGRAL);
    put(frame, 0);
}

/* Mode 13: eight registers in a row. */
static void write_wall(struct can_frame_bytes *frame, const struct moteus_command *command)
{
    const struct moteus_wall *wall = &command->wall;
    const float values[] = {wall->lower,    wall->upper,    command->torque,     wall->kp_scale,
                            wall->kd_scale, command->limit, command->watchdog_s, 0.0f};
    const unsigned count = sizeof values / sizeof values[0];
    put(frame, WRITE_FLOAT);
    put(frame, count);
    put(frame, COMMAND_WITHIN);
    for (unsigned i = 0; i < count; i++)
        put_float(frame, values[i]);
}

static enum moteus_mode mode_of(enum moteus_action action)
{
    return action == MOTEUS_STOP ? MOTEUS_STOPPED : action == MOTEUS_WALL ? MOTEUS_STAY_WITHIN : MOTEUS_POSITION;
}

static void pad(struct can_frame_bytes *frame)
{
    static const uint8_t LENGTHS[] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};
    size_t i = 0;
    while (LENGTHS[i] < frame->count)
        i++;
    while (frame->count < LENGTHS[i])
        put(frame, NOTHING);
}

void moteus_make(struct can_frame_bytes *frame, uint32_t prefix, uint8_t id, uint8_t sender, bool reply,
                 const struct moteus_command *command)
{
    frame->id = prefix << 16 | (reply ? 0x8000u : 0u) | (uint32_t)sender << 8 | id;
    frame->count = 0;
    if (command->action != MOTEUS_ASK) {
        head(frame, WRITE_INT8, 1, MODE);
        put(frame, mode_of(command->action));
    }
    if (command->action == MOTEUS_TORQUE)
        write_torque(frame, command);
    if (command->action == MOTEUS_WALL)
        write_wall(frame, command);
    if (reply) {
        head(frame, READ_INT8, 1, MODE);
        head(frame, READ_FLOAT, 3, POSITION); /* the velocity lies between position and torque */
        head(frame, READ_INT8, 3, VOLTAGE);
        if (command->action == MOTEUS_WALL)
            head(frame, READ_FLOAT, 1, CONTROL_TORQUE);
        if (command->switches != 0)
            head(frame, READ_INT8, 1, command->switches);
    }
    pad(frame);
}

/* ------------------------------------------------------------------ from the drive */

/* Read the next number of a frame and advance. The caller must have checked that it is there. */
static float number(const uint8_t **at, enum number type)
{
    static const uint8_t SIZES[] = {1, 2, 4, 4};
    uint32_t bits = 0;
    for (unsigned i = 0; i < SIZES[type]; i++)
        bits |= (uint32_t)(*at)[i] << 8 * i;
    *at += SIZES[type];
    float value;
    if (type == INT8)
        return (int8_t)bits;
    if (type == INT16)
        return (int16_t)bits;
    if (type == INT32)
        return (float)(int32_t)bits;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Store the value of a register; returns 1 if the register was requested, and with this type. */
static unsigned take(struct drive_sample *reply, uint8_t switches, unsigned at, enum number type, float value)
{
    if (type == FLOAT) {
        if (at == POSITION)
            reply->position = value;
        else if (at == TORQUE)
            reply->torque = value;
        else if (at == CONTROL_TORQUE)
            reply->rendered = value;
        return at == POSITION || at == TORQUE;
    }
    if (type != INT8)
        return 0;
    const uint8_t byte = (uint8_t)(int8_t)value; /* any received value: a negative one is not a uint8_t */
    if (at == MODE)
        reply->mode = byte;
    else if (at == CODE)
        reply->code = byte;
    else if (at == VOLTAGE)
        reply->voltage = 0.5f * value;
    else if (at == TEMPERATURE)
        reply->temperature = value;
    else if (at == switches)
        reply->switches = byte;
    else
        return 0;
    return 1;
}

bool moteus_read(const struct can_frame_bytes *frame, uint8_t switches, struct drive_sample *reply)
{
    static const uint8_t SIZES[] = {1, 2, 4, 4};
    const uint8_t *at = frame->bytes, *end = frame->bytes + frame->count;
    unsigned found = 0;
    reply->rendered = NAN;
    while (at < end) {
        const unsigned type = *at++;
        if (type == NOTHING)
            continue;
        if (type < REPLY || type >= REPLY_END)
            return false;
        unsigned registers = type & 3u;
        const enum number kind = (enum number)(type >> 2 & 3u);
        if (registers == 0 && at < end)
            registers = *at++;
        if (registers > CAN_FRAME_BYTES || at == end)
            return false;
        const unsigned first = *at++;
        if (first > 0x7Fu || (size_t)(end - at) < (size_t)registers * SIZES[kind])
            return false;
        for (unsigned i = 0; i < registers; i++)
            found += take(reply, switches, first + i, kind, number(&at, kind));
    }
    return found == WANTED + (switches != 0 ? 1u : 0u);
}

/* ------------------------------------------------------------------ a drive of a bridge */

/* The command to the drive. A set-point feeds its watchdog; an idle drive needs nothing. */
static enum moteus_action action_of(const struct drive *drive, const struct drive_order *order)
{
    const uint8_t mode = drive->sample.mode;
    const enum moteus_action moves = order->wall != NULL ? MOTEUS_WALL : MOTEUS_TORQUE;
    if (!order->asks)
        return order->wish == DRIVE_OFF ? MOTEUS_STOP : moves;
    if (!drive->known)
        return MOTEUS_ASK;
    if (order->wish == DRIVE_OFF)
        return mode == MOTEUS_STOPPED ? MOTEUS_ASK : MOTEUS_STOP;
    if (order->wish == DRIVE_PREPARE && mode == MOTEUS_TIMEOUT)
        return MOTEUS_STOP;
    return order->fed ? moves : MOTEUS_ASK;
}

/* Shares beyond 1 are not documented, and 0x024 limits kd's share to kp's. */
static bool renders(const struct drive *drive, const struct drive_wall *wall)
{
    if (!(drive->kp > 0.0f && drive->kd > 0.0f))
        return false;
    const float kp = wall->stiffness / drive->kp, kd = wall->damping / drive->kd;
    return kd >= 0.0f && kd <= kp && kp <= 1.0f;
}

static struct moteus_wall wall_of(const struct drive *drive, const struct drive_wall *wall)
{
    const struct moteus_wall within = {
        .lower = wall->above ? NAN : wall->surface,
        .upper = wall->above ? wall->surface : NAN,
        .kp_scale = wall->stiffness / drive->kp,
        .kd_scale = wall->damping / drive->kd,
    };
    return within;
}

static size_t write_order(struct drive *drive, const struct drive_order *order, struct can_frame_bytes *frames)
{
    struct moteus_command command = {
        .action = action_of(drive, order),
        .torque = order->torque,
        .limit = drive->limit,
        .watchdog_s = order->watchdog_s,
        .switches = drive->switches,
    };
    if (command.action == MOTEUS_WALL) {
        command.wall = wall_of(drive, order->wall);
        command.limit = order->wall->limit;
    }
    if (command.action == MOTEUS_TORQUE || command.action == MOTEUS_WALL) {
        memmove(drive->modes + 1, drive->modes, DRIVE_IN_FLIGHT - 1u);
        drive->modes[0] = (uint8_t)mode_of(command.action);
    }
    if (order->asks) /* the reply repeats the sender, so that a late reply is not mistaken for this query's */
        drive->sender = (uint8_t)((drive->sender + 1u) % MOTEUS_SENDERS);
    moteus_make(frames, drive->prefix, (uint8_t)drive->id, (uint8_t)(MOTEUS_FIRST_SENDER + drive->sender), order->asks,
                &command);
    return 1;
}

static enum drive_frame read_frame(struct drive *drive, const struct can_frame_bytes *frame, uint64_t now)
{
    struct drive_sample sample = {0};
    const uint32_t from = frame->id >> 8 & 0x7Fu, to = frame->id & 0x7Fu;
    (void)now;
    if (frame->id >> 16 != drive->prefix || (from != drive->id && to != drive->id))
        return DRIVE_OTHERS;
    if (from != drive->id || to < MOTEUS_FIRST_SENDER || to >= MOTEUS_FIRST_SENDER + MOTEUS_SENDERS)
        return DRIVE_FOREIGN;
    if (!drive->asked || to != MOTEUS_FIRST_SENDER + drive->sender)
        return DRIVE_LATE;
    if (!moteus_read(frame, drive->switches, &sample))
        return DRIVE_INVALID;
    sample.limited = sample.mode != MOTEUS_FAULT && sample.code >= MOTEUS_FIRST_LIMIT;
    drive->sample = sample;
    return DRIVE_SAMPLE;
}

static bool is_on(const struct drive *drive)
{
    return drive->sample.mode == MOTEUS_POSITION;
}

static uint8_t fault_of(uint32_t code)
{
    switch (code) {
    case 33: case 44:
        return BRIDGE_DRIVER;
    case 34:
        return BRIDGE_OVER_VOLTAGE;
    case 35: case 42: case 43:
        return HR_FAULT_ENCODER;
    case 38:
        return BRIDGE_TEMPERATURE;
    case 32: case 36:
        return BRIDGE_NOT_CALIBRATED;
    case 39: case 48:
        return BRIDGE_OUTSIDE_LIMIT;
    case 40:
        return BRIDGE_UNDER_VOLTAGE;
    case 49: case 50:
        return BRIDGE_CONTROL_ERROR;
    default:
        return BRIDGE_DRIVE_INTERNAL;
    }
}

static uint8_t fault(const struct drive *drive, enum drive_wish wish, uint32_t since)
{
    const uint8_t mode = drive->sample.mode;
    if (wish == DRIVE_OFF)
        return mode == MOTEUS_STOPPED || mode == MOTEUS_FAULT || since < DRIVE_SETTLES ? HR_FAULT_NONE : BRIDGE_DRIVE_LEFT;
    if (mode == MOTEUS_FAULT)
        return fault_of(drive->sample.code);
    if (wish == DRIVE_PREPARE && (mode <= MOTEUS_LAST_PREPARING || mode == MOTEUS_TIMEOUT))
        return HR_FAULT_NONE;
    if (wish == DRIVE_PREPARE && is_on(drive))
        return HR_FAULT_NONE;
    return memchr(drive->modes, mode, DRIVE_IN_FLIGHT) != NULL ? HR_FAULT_NONE : BRIDGE_DRIVE_LEFT;
}

static bool may_have_restarted(const struct drive *drive)
{
    return drive->sample.mode == MOTEUS_STOPPED;
}

const struct drive_kind moteus_kind = {
    .write_order = write_order,
    .read_frame = read_frame,
    .renders = renders,
    .is_on = is_on,
    .fault = fault,
    .may_have_restarted = may_have_restarted,
};
