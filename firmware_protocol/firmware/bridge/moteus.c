#include "moteus.h"

#include <string.h>

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

static void write_float(struct can_frame_bytes *frame, enum moteus_register at, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    head(frame, WRITE_FLOAT, 1, at);
    for (unsigned shift = 0; shift < 32; shift += 8)
        put(frame, bits >> shift & 0xFFu);
}

static void write_two(struct can_frame_bytes *frame, enum moteus_register at, unsigned first, unsigned second)
{
    head(frame, WRITE_INT8, 2, at);
    put(frame, first);
    put(frame, second);
}

/* Mode 10 without its position controller: what is left is the feed-forward torque. */
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
        put(frame, command->action == MOTEUS_STOP ? MOTEUS_STOPPED : MOTEUS_POSITION);
    }
    if (command->action == MOTEUS_TORQUE)
        write_torque(frame, command);
    if (reply) {
        head(frame, READ_INT8, 1, MODE);
        head(frame, READ_FLOAT, 3, POSITION); /* the velocity lies between position and torque */
        head(frame, READ_INT8, 3, VOLTAGE);
        if (command->switches != 0)
            head(frame, READ_INT8, 1, command->switches);
    }
    pad(frame);
}

/* ------------------------------------------------------------------ from the drive */

/* The next number of a frame, and behind it. The caller knows that it is there. */
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

/* Take a register; returns 1 for one that is wanted, in the type that was asked for. */
static unsigned take(struct moteus_reply *reply, uint8_t switches, unsigned at, enum number type, float value)
{
    if (type == FLOAT) {
        if (at == POSITION)
            reply->position = value;
        else if (at == TORQUE)
            reply->torque = value;
        else
            return 0;
        return 1;
    }
    if (type != INT8)
        return 0;
    const uint8_t byte = (uint8_t)(int8_t)value; /* whatever came: a negative one is no uint8_t */
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

bool moteus_read(const struct can_frame_bytes *frame, uint8_t switches, struct moteus_reply *reply)
{
    static const uint8_t SIZES[] = {1, 2, 4, 4};
    const uint8_t *at = frame->bytes, *end = frame->bytes + frame->count;
    unsigned found = 0;
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
