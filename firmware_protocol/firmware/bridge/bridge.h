/* The core on a computer whose encoder and amplifier are a drive on a bus: the port of a bridge, without its bus and
 * without waiting. Bytes and times go in, bytes come out; `loop.h` moves them in real time, a test as it likes.
 *
 * Once a period (`bridge_tick`) one frame takes the set-point to the drive and asks for its position. The tick of the
 * core comes with the reply, so that a sample without a reply does not exist: one lost is a missed tick of the device,
 * and BRIDGE_SILENT in succession end an armed run. A drive that is silent for longer may have lost its power, and with it
 * the turns that it counted. The drive's own watchdog is the core's hardware watchdog: it is fed by
 * set-points, and these stop when the core's tick or main loop does. */
#ifndef HR_BRIDGE_H
#define HR_BRIDGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../core/device.h"
#include "fdcanusb.h"
#include "moteus.h"
#include "socketcan.h"

#define BRIDGE_SILENT 2u         /* replies missed in succession: as many ticks as the core lets an armed device miss */
#define BRIDGE_NARROWER 16u
#define BRIDGE_OUTPUT_BYTES 65536u /* to the host, which may be slow */
#define BRIDGE_BUS_BYTES 4096u   /* to the adapter */
#define BRIDGE_BINS 512u         /* of the round trips, 10 µs each; the last one has all longer ones */
#define BRIDGE_BIN_US 10u

/* What may be wrong with a drive: faults of the core from here on, which the dictionary explains. */
enum bridge_fault {
    BRIDGE_DRIVE_SILENT = 20,
    BRIDGE_OTHER_MASTER = 21,
    BRIDGE_DRIVE_LEFT = 22, /* its mode is not the one it was told */
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

/* What happened on the bus, for whoever watches: a row of numbers, so that another process can read them. */
struct bridge_facts {
    int64_t replies;
    int64_t lost;     /* queries without a reply in their period */
    int64_t late;     /* replies behind their period, and second ones */
    int64_t foreign;  /* frames of another master, or to one */
    int64_t invalid;  /* replies that lack a register, lines that are none */
    int64_t refused;  /* frames that the adapter refused */
    int64_t unsent;   /* frames for which there was no room */
    int64_t skipped;  /* periods that this computer slept through */
    int64_t limited;  /* replies that said that the drive limits its torque */
    int64_t longest_us; /* round trip */
    int64_t temperature; /* °C */
    int64_t hottest;     /* °C */
    int64_t millivolts;
    int64_t mode, code; /* of the last reply */
    int64_t round_trips[BRIDGE_BINS];
};

struct bridge_setup {
    const uint8_t *dictionary;
    uint64_t dictionary_hash;
    uint32_t dictionary_bytes;
    uint32_t rate_initial;
    uint32_t rate_maximum;
    int32_t encoder_sign;
    uint32_t over_current;
    struct mechanics mechanics;
    struct current_sensor current_sensor;
    uint32_t prefix; /* of the bus's ids */
    uint32_t drive;  /* its id */
    double counts_per_turn; /* of the output, as the drive tells it; may be negative */
    double torque_per_quantum; /* N·m at the output; may be negative */
    double torque_limit; /* N·m at the output */
    uint32_t switches; /* register of the drive that has them, 0: none */
    uint32_t hold;     /* bits of it that are 1 while the hold-to-run switch is held */
    uint32_t stop;     /* bits of it that are 0 when the emergency stop is pressed, or its wire is broken */
    uint32_t checksum; /* on the adapter's lines */
    uint32_t socket;   /* the bus is a raw CAN socket: frames, no lines */
};

enum bridge_wish { BRIDGE_OFF, BRIDGE_PREPARE, BRIDGE_ON };

struct bridge {
    struct device device;
    struct hal hal;
    struct board board;
    struct narrower narrower[BRIDGE_NARROWER];
    struct bridge_setup setup;
    struct bridge_facts *facts;
    struct fdcanusb adapter;

    uint64_t now;       /* device time, set by whoever runs it, unless `clock` tells it */
    uint64_t (*clock)(void);
    uint64_t period;    /* device time */
    uint32_t rate;
    uint64_t asked_at;  /* the query that is under way */
    bool asked;
    uint8_t sender;     /* of the last query, from 0 */
    uint32_t missed;    /* replies in succession */

    enum bridge_wish wish;
    uint64_t wished_until; /* while it prepares */
    bool bus_lost;
    bool at_once;       /* the current was taken away between two ticks: do not wait for the next one */
    bool driving;       /* inside device_drive */
    int16_t current;    /* quanta */
    int16_t active;     /* the one before it, with which the drive takes its sample */
    uint32_t fed;       /* set-points that the core's last feeding is good for */
    uint32_t bite_us;
    uint32_t since_off; /* replies since the drive was to be off */

    bool known;         /* there was a reply */
    struct moteus_reply reply;
    int32_t count;
    bool count_failed;

    const uint8_t *input; /* of the host */
    size_t input_count;
    size_t output_count, bus_count;
    uint8_t output[BRIDGE_OUTPUT_BYTES]; /* to the host */
    uint8_t bus[BRIDGE_BUS_BYTES];       /* to the adapter */
};

size_t bridge_bytes(void);
size_t bridge_facts_bytes(void);

/* `bridge` is memory of zeroes; dictionary and facts must live as long. Ranges rise by parameter. */
void bridge_setup(struct bridge *bridge, const struct bridge_setup *setup, struct bridge_facts *facts);
void bridge_narrow(struct bridge *bridge, uint8_t parameter, uint32_t minimum, uint32_t maximum);
void bridge_start(struct bridge *bridge, uint64_t now);

/* A period is over: the set-point to the drive, and the next query. */
void bridge_tick(struct bridge *bridge, uint64_t now);

/* Bytes of the adapter, or a frame of the socket; of the host; what waits for them is in `bus` and `output`. */
void bridge_hear_bus(struct bridge *bridge, const uint8_t *bytes, size_t count, uint64_t now);
void bridge_hear_host(struct bridge *bridge, const uint8_t *bytes, size_t count, uint64_t now);

/* The main loop of the core: until it has nothing more to do. */
void bridge_poll(struct bridge *bridge, uint64_t now);

/* The adapter is gone, or its bus. */
void bridge_lose_bus(struct bridge *bridge, uint64_t now);

/* The drive off, whatever the core wants: the end. */
void bridge_stop(struct bridge *bridge);

size_t bridge_take(struct bridge *bridge, uint8_t *into, size_t capacity);     /* for the host */
size_t bridge_take_bus(struct bridge *bridge, uint8_t *into, size_t capacity); /* for the adapter */
uint8_t bridge_state(const struct bridge *bridge);
uint8_t bridge_fault_now(const struct bridge *bridge);
double bridge_torque(const struct bridge *bridge); /* that the drive is to give, N·m at its output */

#endif
