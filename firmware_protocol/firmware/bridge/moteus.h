/* Commands to a moteus and its replies, in frames of its register protocol.
 *
 * Source: mjbots/moteus, docs/protocol/can.md and docs/protocol/registers.md (register map 5), opened. */
#ifndef HR_MOTEUS_H
#define HR_MOTEUS_H

#include <stdbool.h>
#include <stdint.h>

#include "can_frame.h"
#include "drive.h"

/* A query names its sender, and the reply repeats it: sixteen senders number the queries, so that a late reply is not
 * mistaken for the awaited one. Other programs are sender 0 by default. */
#define MOTEUS_FIRST_SENDER 0x10u
#define MOTEUS_SENDERS 16u

enum moteus_mode {
    MOTEUS_STOPPED = 0,
    MOTEUS_FAULT = 1,
    MOTEUS_LAST_PREPARING = 4, /* from 2 on */
    MOTEUS_POSITION = 10,
    MOTEUS_TIMEOUT = 11,
    MOTEUS_STAY_WITHIN = 13,
};

/* Codes of register 0x00f: faults below, limits of the torque from here on; the mode continues with a limit. */
#define MOTEUS_FIRST_LIMIT 96u

enum moteus_action {
    MOTEUS_ASK,   /* changes nothing, and does not feed the drive's watchdog */
    MOTEUS_STOP,  /* the driver off; clears a fault and a time-out of its watchdog */
    MOTEUS_TORQUE,
    MOTEUS_WALL, /* and the drive's own spring and damper beyond a bound: mode 13 */
};

/* Mode 13, docs/protocol/registers.md 0x040 ... 0x047: beyond a bound the drive's position controller holds that, with
 * these shares of its gains. Nothing clamps it: it pulls, too. */
struct moteus_wall {
    float lower, upper; /* turns of the output; NaN: no bound */
    float kp_scale, kd_scale;
};

struct moteus_command {
    enum moteus_action action;
    float torque;     /* N·m at the output */
    float limit;      /* N·m that it may give at most, whatever is commanded */
    float watchdog_s; /* after which it gives none, unless the command is repeated */
    uint8_t switches; /* register that a reply is to have too, 0: none (0x05e and 0x05f are the pins of aux1 and aux2) */
    struct moteus_wall wall; /* of MOTEUS_WALL */
};

/* Write a frame for the drive `id`, on a bus whose ids have a prefix of 13 bits (0: none). `reply`: request a reply. */
void moteus_make(struct can_frame_bytes *frame, uint32_t prefix, uint8_t id, uint8_t sender, bool reply,
                 const struct moteus_command *command);

/* Read the registers that a query requests; returns false if one is missing, or the frame is not a reply. */
bool moteus_read(const struct can_frame_bytes *frame, uint8_t switches, struct drive_sample *reply);

extern const struct drive_kind moteus_kind;

#endif
