/* The core on a computer whose encoder and amplifier are a drive on a bus: the port of a bridge, without I/O and without
 * waiting. Callers pass bytes and times in and take bytes out: `loop.h` in real time, a test at any pace.
 *
 * Once a period (`bridge_tick`) the set-point goes to the drive, and its sample is awaited. The tick of the core comes with
 * that sample: a lost sample is a missed tick of the device, and BRIDGE_SILENT in succession end an armed run. A drive
 * that is silent for longer may have lost its power, and with it the turns that it counted. The drive's own watchdog
 * serves as the core's hardware watchdog: set-points feed it, and they stop when the core's tick or main loop stops.
 *
 * A polled drive (moteus) is queried in that period's frame. The bridge synchronises to a drive that sends by itself on its
 * own clock (ODrive): a period begins half a message interval before its sample is due, so that the drift of the clocks
 * neither duplicates nor loses a sample. The half interval is delay, and counts as part of the round trip. */
#ifndef HR_BRIDGE_H
#define HR_BRIDGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../core/device.h"
#include "../core/on_a_computer.h"
#include "drive.h"
#include "fdcanusb.h"
#include "socketcan.h"
#include "wall.h"

#define BRIDGE_SILENT 4u         /* samples missed in succession: a command lives for five periods, and one is its way */
#define BRIDGE_NARROWER 16u
#define BRIDGE_OUTPUT_BYTES 65536u /* to the host, which may be slow */
#define BRIDGE_BUS_BYTES 4096u   /* to the adapter */
#define BRIDGE_BINS 5120u        /* of the round trips, 1 µs each; the last one has all longer ones */

/* Statistics of the bus, all int64: another process reads them as an array. */
struct bridge_facts {
    int64_t replies;
    int64_t lost;     /* periods without a sample, from the first one on */
    int64_t late;     /* replies behind their period, and second ones */
    int64_t foreign;  /* frames of another master, or to one */
    int64_t invalid;  /* replies that lack a register, lines that are no frames */
    int64_t refused;  /* frames that the adapter refused */
    int64_t unsent;   /* frames for which there was no room */
    int64_t skipped;  /* periods in which this computer did not run the loop */
    int64_t limited;  /* replies that report a limited torque */
    int64_t longest_us; /* round trip */
    int64_t temperature; /* °C */
    int64_t hottest;     /* °C */
    int64_t millivolts;
    int64_t mode, code; /* of the last reply */
    int64_t round_trips[BRIDGE_BINS];
};

struct bridge_setup {
    struct board_setup board;
    uint32_t rate_maximum;
    uint32_t prefix; /* of the bus's ids */
    uint32_t drive;  /* its id */
    double counts_per_turn; /* of the output, as the drive reports it; may be negative */
    double torque_per_quantum; /* N·m at the output; may be negative */
    double torque_limit; /* N·m at the output */
    double kp; /* gains of the drive's own law at the output, N·m/turn; 0: it renders no wall */
    double kd; /* N·m·s/turn */
    uint32_t switches; /* register of the drive that has them, 0: none */
    uint32_t hold;     /* bits of it that are 1 while the hold-to-run switch is held */
    uint32_t stop;     /* bits of it that are 0 when the emergency stop is pressed, or its wire is broken */
    uint32_t checksum; /* on the adapter's lines */
    uint32_t socket;   /* the bus is a raw CAN socket: frames, no lines */
    uint32_t kind;     /* enum bridge_drive */
    uint32_t cycle_us; /* between two samples that the drive sends by itself, 0: it is polled */
    uint32_t beat_us;  /* between two heartbeats of it */
};

enum bridge_drive { BRIDGE_MOTEUS, BRIDGE_ODRIVE };

struct bridge {
    struct device device;
    struct hal hal;
    struct board board;
    struct narrower narrower[BRIDGE_NARROWER];
    struct bridge_setup setup;
    struct bridge_facts *facts;
    const struct drive_kind *kind;
    struct drive drive;
    struct fdcanusb adapter;

    uint64_t now;       /* device time, set by the caller, unless `clock` is given */
    uint64_t (*clock)(void);
    uint64_t period;    /* device time */
    uint64_t cycle;     /* of the drive's samples, 0: it is asked */
    uint64_t due;       /* device time of the next period */
    uint64_t asked_at;  /* the sample that is awaited */
    uint32_t missed;    /* samples in succession */
    uint32_t sampleless; /* periods without a sample since the core's last tick */

    enum drive_wish wish;
    uint32_t since;        /* samples since then */
    uint64_t wished_until; /* while it prepares */
    bool bus_lost;
    bool at_once;       /* the current was taken away between two ticks: do not wait for the next one */
    bool driving;       /* inside device_drive */
    int16_t current;    /* quanta */
    int16_t active;     /* with which the drive takes its sample: the one before it where the drive is asked beside the
                         * set-point, this one where it speaks half a message later; with a wall, what its law gave there */
    bool rendering;     /* `wall` is the drive's to render */
    struct drive_wall wall;
    struct wall_scales scales;
    uint32_t fed;       /* set-points that the core's last feeding is good for */
    uint32_t bite_us;

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

/* Set up `bridge`, which must be zero. Dictionary and facts must exist as long as `bridge`; ranges are in ascending
 * order of the parameters. */
void bridge_setup(struct bridge *bridge, const struct bridge_setup *setup, struct bridge_facts *facts);
void bridge_narrow(struct bridge *bridge, uint8_t parameter, uint32_t minimum, uint32_t maximum);
void bridge_start(struct bridge *bridge, uint64_t now);

/* Begin a period (call it at the device time bridge_due): send the set-point and the next query to the drive. */
void bridge_tick(struct bridge *bridge, uint64_t now);

/* Pass in bytes of the adapter (or a frame of the socket), or bytes of the host. Bytes to send are then in `bus` and
 * `output`. */
void bridge_receive_bus(struct bridge *bridge, const uint8_t *bytes, size_t count, uint64_t now);
void bridge_receive_host(struct bridge *bridge, const uint8_t *bytes, size_t count, uint64_t now);

/* Run the main loop of the core until it has nothing to do. */
void bridge_poll(struct bridge *bridge, uint64_t now);

/* Report that the adapter or its bus was lost. */
void bridge_lose_bus(struct bridge *bridge, uint64_t now);

/* Switch the drive off, whatever the core's set-point. Call at the end. */
void bridge_stop(struct bridge *bridge);

size_t bridge_take(struct bridge *bridge, uint8_t *into, size_t capacity);     /* for the host */
size_t bridge_take_bus(struct bridge *bridge, uint8_t *into, size_t capacity); /* for the adapter */
uint64_t bridge_due(const struct bridge *bridge); /* device time of the next period */
uint8_t bridge_state(const struct bridge *bridge);
uint8_t bridge_fault_now(const struct bridge *bridge);
double bridge_torque(const struct bridge *bridge); /* that the drive is to give, N·m at its output */

#endif
