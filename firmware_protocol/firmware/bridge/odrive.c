#include "odrive.h"

#include <math.h>
#include <string.h>

#include "../core/device.h"

#define NODE_BITS 5u
#define MESSAGE_BYTES 8u
#define LOST_BEATS 5u /* heartbeats in succession: is it there? */
#define FRESH_BEATS 2u /* the first one may have been on its way before a command was sent */
#define AGAIN 32u      /* periods until it is asked into closed loop again */
#define DIFFERS 3u     /* samples in succession with a set-point that was not commanded */
#define RELATIVE 1e-4f /* by which a set-point may differ: of float32 arithmetic */
#define SMALLEST 1e-6f /* N·m */

enum command {
    HEARTBEAT = 0x01,
    ESTOP = 0x02,
    WRITE_PARAMETER = 0x04,
    SET_STATE = 0x07,
    ESTIMATES = 0x09,
    SET_MODE = 0x0B,
    SET_TORQUE = 0x0E,
    LAST_SETTING = 0x13, /* from SET_MODE on */
    TEMPERATURE = 0x15,
    REBOOT = 0x16,
    VOLTAGE = 0x17,
    CLEAR_ERRORS = 0x18,
    LAST_GAIN = 0x1B, /* from CLEAR_ERRORS on */
    TORQUES = 0x1C,
};

enum state { IDLE = 1, CLOSED_LOOP = 8 };
enum result { NOT_CALIBRATED = 14 };
enum { TORQUE_CONTROL = 1, PASSTHROUGH = 1 };
enum part { HAS_POSITION = 1, HAS_TORQUE = 2, HAS_ALL = 3 };

/* ------------------------------------------------------------------ to the drive */

static void put(const struct drive *drive, struct can_frame_bytes *frame, enum command command, uint32_t first,
                uint32_t second)
{
    frame->id = drive->id << NODE_BITS | (uint32_t)command;
    frame->count = command == CLEAR_ERRORS ? 1u : MESSAGE_BYTES;
    frame->classic = true;
    for (unsigned i = 0; i < 4; i++) {
        frame->bytes[i] = (uint8_t)(first >> 8 * i);
        frame->bytes[4 + i] = (uint8_t)(second >> 8 * i);
    }
}

static void put_torque(struct drive *drive, struct can_frame_bytes *frame, float torque)
{
    uint32_t bits;
    memcpy(&bits, &torque, sizeof bits);
    put(drive, frame, SET_TORQUE, bits, 0);
    memmove(drive->odrive.torques + 1, drive->odrive.torques, sizeof drive->odrive.torques - sizeof torque);
    drive->odrive.torques[0] = torque;
}

static size_t write_idle(struct drive *drive, struct can_frame_bytes *frames)
{
    put_torque(drive, &frames[0], 0.0f); /* the one that it would begin with */
    put(drive, &frames[1], SET_STATE, IDLE, 0);
    return 2;
}

/* Enter closed loop without torque. Errors are cleared once, after they were reported to the host. */
static size_t write_prepare(struct drive *drive, struct can_frame_bytes *frames)
{
    size_t count = 0;
    const uint32_t periods = drive->odrive.periods++;
    const bool asks = periods % AGAIN == 0 && (periods == 0 || drive->sample.mode != CLOSED_LOOP);
    if (periods == 0)
        put(drive, &frames[count++], CLEAR_ERRORS, 0, 0);
    if (asks)
        put(drive, &frames[count++], SET_MODE, TORQUE_CONTROL, PASSTHROUGH);
    put_torque(drive, &frames[count++], 0.0f);
    if (asks)
        put(drive, &frames[count++], SET_STATE, CLOSED_LOOP, 0);
    drive->odrive.woken = true;
    return count;
}

static bool has_settled(const struct drive *drive, enum state state)
{
    return drive->sample.mode == state && drive->odrive.beats >= FRESH_BEATS;
}

static size_t write_order(struct drive *drive, const struct drive_order *order, struct can_frame_bytes *frames)
{
    if (order->asks) {
        drive->odrive.parts = 0;
        if (order->wish != drive->odrive.wish) {
            drive->odrive.wish = order->wish;
            drive->odrive.periods = 0;
            drive->odrive.beats = 0;
        }
        if (!drive->known)
            return 0;
    }
    if (order->wish == DRIVE_OFF) {
        drive->odrive.woken &= !has_settled(drive, IDLE);
        const bool rests = drive->sample.mode == IDLE && !drive->odrive.woken;
        return order->asks && rests ? 0 : write_idle(drive, frames);
    }
    if (order->asks && !order->fed)
        return 0;
    if (order->wish == DRIVE_PREPARE)
        return write_prepare(drive, frames);
    put_torque(drive, frames, order->torque);
    return 1;
}

/* ------------------------------------------------------------------ from the drive */

static uint32_t word(const struct can_frame_bytes *frame, unsigned at)
{
    uint32_t bits = 0;
    for (unsigned i = 0; i < 4; i++)
        bits |= (uint32_t)frame->bytes[at + i] << 8 * i;
    return bits;
}

static float number(const struct can_frame_bytes *frame, unsigned at)
{
    const uint32_t bits = word(frame, at);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* True if the drive's set-point differs from all that were commanded recently. */
static bool differs(const struct drive *drive, float target)
{
    for (unsigned i = 0; i < DRIVE_IN_FLIGHT; i++)
        if (fabsf(target - drive->odrive.torques[i]) <= SMALLEST + RELATIVE * fabsf(target))
            return false;
    return true;
}

static void take_beat(struct drive *drive, const struct can_frame_bytes *frame, uint64_t now)
{
    drive->odrive.error = drive->sample.code = word(frame, 0);
    drive->sample.mode = frame->bytes[4];
    drive->odrive.result = frame->bytes[5];
    drive->odrive.beats++;
    drive->odrive.beat_at = now;
    drive->odrive.obeys_another = drive->odrive.differs >= DIFFERS; /* else it has stopped, which a heartbeat shows */
}

static void take_torques(struct drive *drive, const struct can_frame_bytes *frame)
{
    drive->sample.limited = drive->sample.mode == CLOSED_LOOP && differs(drive, number(frame, 0));
    drive->sample.torque = number(frame, 4);
    drive->odrive.parts |= HAS_TORQUE;
}

static bool is_command(unsigned command)
{
    return command == ESTOP || command == WRITE_PARAMETER || command == SET_STATE || command == REBOOT
           || (command >= SET_MODE && command <= LAST_SETTING) || (command >= CLEAR_ERRORS && command <= LAST_GAIN);
}

/* A sample is complete when both parts have arrived, in any order. Messages before the request are ignored. */
static enum drive_frame read_frame(struct drive *drive, const struct can_frame_bytes *frame, uint64_t now)
{
    const unsigned command = frame->id & ((1u << NODE_BITS) - 1u);
    if (frame->id >> NODE_BITS != drive->id)
        return DRIVE_OTHERS;
    if (is_command(command))
        return DRIVE_FOREIGN;
    if (command != HEARTBEAT && command != ESTIMATES && command != TORQUES && command != TEMPERATURE && command != VOLTAGE)
        return DRIVE_PART;
    if (frame->count != MESSAGE_BYTES)
        return DRIVE_INVALID;
    drive->odrive.received_at = now;
    if (command == HEARTBEAT)
        take_beat(drive, frame, now);
    if (command == TEMPERATURE && isfinite(number(frame, 0)))
        drive->sample.temperature = number(frame, 0);
    if (command == VOLTAGE && isfinite(number(frame, 0)))
        drive->sample.voltage = number(frame, 0);
    if (command == TORQUES)
        take_torques(drive, frame);
    if (command == ESTIMATES) {
        drive->sample.position = number(frame, 0);
        drive->odrive.parts |= HAS_POSITION;
    }
    if (!drive->asked || drive->odrive.parts != HAS_ALL || drive->odrive.beat_at == 0)
        return DRIVE_PART;
    drive->odrive.differs = drive->sample.limited ? drive->odrive.differs + 1u : 0u;
    return DRIVE_SAMPLE;
}

/* ------------------------------------------------------------------ what it means */

static bool is_on(const struct drive *drive)
{
    return has_settled(drive, CLOSED_LOOP) && drive->odrive.error == 0;
}

/* Return the fault of an error's bits. The watchdog's bit comes last: it occurs together with more specific ones. */
static uint8_t fault_of(uint32_t error)
{
    static const struct {
        uint32_t bits;
        uint8_t fault;
    } FAULTS[] = {
        {0x00000100u | 0x08000000u, BRIDGE_OVER_VOLTAGE},
        {0x00000200u, BRIDGE_UNDER_VOLTAGE},
        {0x00000020u | 0x00000400u | 0x00000800u | 0x00001000u, BRIDGE_DRIVER},
        {0x00002000u | 0x00004000u | 0x10000000u, BRIDGE_TEMPERATURE},
        {0x00000008u | 0x04000000u, HR_FAULT_ENCODER},
        {0x00000010u | 0x40000000u, BRIDGE_NOT_CALIBRATED},
        {0x00008000u | 0x00010000u, BRIDGE_OUTSIDE_LIMIT},
        {0x00000004u | 0x00000040u, BRIDGE_CONTROL_ERROR},
        {0x01000000u | 0x02000000u, BRIDGE_DRIVE_LEFT},
    };
    for (size_t i = 0; i < sizeof FAULTS / sizeof *FAULTS; i++)
        if (error & FAULTS[i].bits)
            return FAULTS[i].fault;
    return BRIDGE_DRIVE_INTERNAL;
}

static uint8_t fault(const struct drive *drive, enum drive_wish wish, uint32_t since)
{
    const uint8_t state = drive->sample.mode;
    const bool settled = since >= DRIVE_SETTLES;
    if (wish == DRIVE_OFF)
        return state == IDLE || !settled ? HR_FAULT_NONE : BRIDGE_DRIVE_LEFT;
    if (drive->odrive.received_at - drive->odrive.beat_at > LOST_BEATS * drive->beat)
        return BRIDGE_DRIVE_SILENT;
    if (wish == DRIVE_PREPARE && !settled) /* the command is on its way */
        return HR_FAULT_NONE;
    if (drive->odrive.error != 0)
        return fault_of(drive->odrive.error);
    if (wish == DRIVE_PREPARE && drive->odrive.result == NOT_CALIBRATED)
        return BRIDGE_NOT_CALIBRATED;
    if (state != CLOSED_LOOP || drive->odrive.obeys_another)
        return BRIDGE_DRIVE_LEFT;
    return HR_FAULT_NONE;
}

static bool may_have_restarted(const struct drive *drive)
{
    return drive->sample.mode == IDLE && drive->odrive.error == 0;
}

const struct drive_kind odrive_kind = {
    .classic = true,
    .write_order = write_order,
    .read_frame = read_frame,
    .is_on = is_on,
    .fault = fault,
    .may_have_restarted = may_have_restarted,
};
