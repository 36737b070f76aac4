/* Interface between the bridge and the kinds of drive (one file for each kind): frames of an order, samples in the
 * replies, meaning of the drive's state. The rules (when a set-point may be sent, what happens after a lost sample) are
 * in the bridge, for all kinds. */
#ifndef HR_DRIVE_H
#define HR_DRIVE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "can_frame.h"

#define DRIVE_FRAMES 4u   /* most frames to a drive in a period */
#define DRIVE_SETTLES 50u /* samples until a drive must have executed a command */
#define DRIVE_IN_FLIGHT 3u     /* set-points that may be on their way there and back */

/* Faults of a drive: codes of the core's faults from 20 on; the dictionary contains their texts. */
enum bridge_fault {
    BRIDGE_DRIVE_SILENT = 20,
    BRIDGE_OTHER_MASTER = 21,
    BRIDGE_DRIVE_LEFT = 22, /* its mode is not the commanded one */
    BRIDGE_OVER_VOLTAGE = 23,
    BRIDGE_UNDER_VOLTAGE = 24,
    BRIDGE_DRIVER = 25,
    BRIDGE_TEMPERATURE = 26,
    BRIDGE_NOT_CALIBRATED = 27,
    BRIDGE_OUTSIDE_LIMIT = 28,
    BRIDGE_CONTROL_ERROR = 29,
    BRIDGE_DRIVE_INTERNAL = 30,
    BRIDGE_BUS_LOST = 31,
};

enum drive_wish { DRIVE_OFF, DRIVE_PREPARE, DRIVE_ON };

/* A wall that a drive renders itself, at its output: a spring to its surface and a damper, on one side. */
struct drive_wall {
    float surface;   /* turns */
    bool above;      /* it fills the turns above its surface, else those below */
    float stiffness; /* N·m/turn */
    float damping;   /* N·m·s/turn */
    float limit;     /* N·m of wall and torque together, at most */
};

struct drive_order {
    enum drive_wish wish;
    bool asks;        /* a period begins and a sample is requested; false: an order between two periods */
    bool fed;         /* the core has fed its watchdog: a set-point may be sent */
    float torque;     /* N·m at the output */
    float watchdog_s; /* after which the drive gives none, unless the command is repeated */
    const struct drive_wall *wall; /* to render beside the torque, or NULL */
};

struct drive_sample {
    uint8_t mode;
    uint32_t code;     /* of its fault */
    float position;    /* turns of the output */
    float torque;      /* N·m at the output, measured */
    float rendered;    /* N·m at the output that its own law gives, torque and wall; NaN: not reported */
    float voltage;     /* V */
    float temperature; /* °C */
    uint8_t switches;  /* pins */
    bool limited;      /* it gives another torque than the commanded one */
};

enum drive_frame {
    DRIVE_OTHERS,  /* not about this drive */
    DRIVE_FOREIGN, /* of another master, or to one */
    DRIVE_LATE,    /* behind its period, or a second one */
    DRIVE_INVALID,
    DRIVE_PART,    /* more is to come */
    DRIVE_SAMPLE,  /* in `sample` */
};

struct drive {
    uint32_t prefix, id; /* of the bus's ids; its own */
    uint8_t switches;    /* register of its pins, 0: none */
    float limit;         /* N·m at the output, that it may give at most */
    float kp, kd;        /* of its own law: N·m/turn, N·m·s/turn at the output; 0: it renders no wall */
    uint64_t beat;       /* device time between two heartbeats of an ODrive */
    bool asked;          /* a sample is awaited */
    bool known;          /* a sample has arrived */
    struct drive_sample sample;

    uint8_t sender; /* of a moteus: of the last query, from 0 */
    uint8_t modes[DRIVE_IN_FLIGHT]; /* of a moteus: commanded last, the newest first; a sample may show any of them */

    struct { /* of an ODrive */
        uint32_t error;
        uint8_t result;
        bool woken;       /* it was commanded into closed loop, and has not settled at rest since */
        enum drive_wish wish; /* that was commanded last */
        uint32_t periods; /* of preparing, since then */
        uint32_t beats;   /* since then */
        uint64_t beat_at; /* device time of the last one; 0 before the first */
        uint64_t received_at;
        unsigned parts;   /* of the awaited sample */
        float torques[DRIVE_IN_FLIGHT];
        unsigned differs; /* samples in succession whose set-point matches none of them */
        bool obeys_another;
    } odrive;
};

struct drive_kind {
    bool classic; /* CAN frames of eight bytes */

    /* Write the frames of an order; returns their number, at most DRIVE_FRAMES. */
    size_t (*write_order)(struct drive *drive, const struct drive_order *order, struct can_frame_bytes *frames);

    /* Process a frame from the bus. */
    enum drive_frame (*read_frame)(struct drive *drive, const struct can_frame_bytes *frame, uint64_t now);

    /* Return true if the drive can render this wall itself; NULL: it can render no wall. */
    bool (*renders)(const struct drive *drive, const struct drive_wall *wall);

    /* Return true if a set-point sent now acts at once, because the drive is in closed loop. */
    bool (*is_on)(const struct drive *drive);

    /* Return the fault that the drive's last sample shows, `since` samples after the last order; 0: no fault. */
    uint8_t (*fault)(const struct drive *drive, enum drive_wish wish, uint32_t since);

    /* Return true if the drive may have lost its power, and with it the number of turns. */
    bool (*may_have_restarted)(const struct drive *drive);
};

#endif
