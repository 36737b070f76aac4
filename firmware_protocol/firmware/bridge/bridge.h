/* The core on a computer whose encoder and amplifier are a drive on a bus: the port of a bridge, without its bus and
 * without waiting. Bytes and times go in, bytes come out; `loop.h` moves them in real time, a test as it likes.
 *
 * Once a period (`bridge_tick`) the set-point goes to the drive, and its sample is awaited. The tick of the core comes with
 * that sample, so that one without a reply does not exist: one lost is a missed tick of the device, and BRIDGE_SILENT in
 * succession end an armed run. A drive that is silent for longer may have lost its power, and with it the turns that it
 * counted. The drive's own watchdog is the core's hardware watchdog: it is fed by set-points, and these stop when the
 * core's tick or main loop does.
 *
 * A drive that is asked (moteus) is asked in that period's frame. One that speaks by itself, every so often by its own
 * clock (ODrive), is followed: the next period begins half a message before the sample of the next one, so that neither
 * clock's drift makes a sample come twice or not at all. The half message is delay, and counts as a round trip. */
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
#define BRIDGE_BINS 512u         /* of the round trips, 10 µs each; the last one has all longer ones */
#define BRIDGE_BIN_US 10u

/* Statistics of the bus: a row of numbers, so that another process can read them. */
struct bridge_facts {
    int64_t replies;
    int64_t lost;     /* periods without a sample, from the first one on */
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

/* `bridge` is memory of zeroes; dictionary and facts must live as long. Ranges rise by parameter. */
void bridge_setup(struct bridge *bridge, const struct bridge_setup *setup, struct bridge_facts *facts);
void bridge_narrow(struct bridge *bridge, uint8_t parameter, uint32_t minimum, uint32_t maximum);
void bridge_start(struct bridge *bridge, uint64_t now);

/* A period is over, at `due`: the set-point to the drive, and the next query. */
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
uint64_t bridge_due(const struct bridge *bridge); /* device time of the next period */
uint8_t bridge_state(const struct bridge *bridge);
uint8_t bridge_fault_now(const struct bridge *bridge);
double bridge_torque(const struct bridge *bridge); /* that the drive is to give, N·m at its output */

#endif
