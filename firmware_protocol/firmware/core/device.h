/* The device: a rig that speaks the protocol of PROTOCOL.md. One struct, no globals, no heap.
 *
 * A port calls device_start once, then device_tick from its timer and device_poll (poll.h) in between; the two must not
 * interrupt each other, and both are bounded in time. */
#ifndef HR_DEVICE_H
#define HR_DEVICE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "assembler.h"
#include "batch.h"
#include "board.h"
#include "configuration.h"
#include "connection.h"
#include "current.h"
#include "faults.h"
#include "hal.h"
#include "limits.h"
#include "live_change.h"
#include "monitor.h"
#include "renderer.h"
#include "thermal.h"
#include "watchdog.h"

struct ack {
    uint16_t nonce;
    uint8_t request;
    uint8_t status;
    uint16_t detail;
    uint32_t sample_index;
    uint32_t crc;
};

/* The last request that changed something, and its reply: at most once. */
struct remembered {
    bool there;
    uint8_t session;
    struct ack ack; /* names request and nonce */
};

/* What device_sample leaves for device_tell. */
struct told_tick {
    struct fault_entry entry;
    bool logged;     /* into the fault ring: no fault was latched before it */
    bool supervised; /* the law on the device was to see it: into BATCH */
    uint8_t sync;    /* what the pins showed up to the sample */
};

/* What a tick works with stands first: a small processor reaches near fields with one instruction. */
struct device {
    const struct hal *hal;
    const struct board *board;

    uint64_t time;         /* of the last sample */
    uint64_t due;          /* when the next is due */
    uint32_t sample_index; /* modulo 2³² */
    uint32_t rate, period, period_rest, due_rest; /* a tick is period + period_rest / rate */
    int32_t count;         /* at the last sample */
    uint32_t state_every;  /* ticks between STATEs of a session */
    uint32_t state_due;    /* ticks until the next one */
    uint32_t worst_execution_time, missed_ticks; /* since arming */
    uint32_t bite_us;      /* of the hardware watchdog */
    uint32_t unpolled, most_unpolled; /* ticks since the main loop came by, and how many it may take */
    struct told_tick tick;
    int16_t driven;        /* active current since the last sample (quanta) */
    uint16_t command_age;  /* ticks; saturates */
    uint16_t limits_acted; /* since the last STATE */
    bool on_grid;          /* a tick has come since the rate was set: the next one's time is known */
    bool supervised;       /* by the active command */
    bool needs_hold;
    uint8_t fault_told;    /* by the last STATE */
    uint8_t sync;          /* what the pins show, bits of enum hr_sync */
    uint8_t command_sync;  /* what the active command wants of them */
    bool commanded;        /* in this session */
    uint16_t command_sequence;
    struct limits limits;
    struct watchdog watchdog;
    struct thermal thermal;
    struct monitor monitor;
    struct renderer renderer;
    struct batch batch;
    struct current_check current;
    struct builder state_builder; /* of a STATE that waits to be sent */
    bool state_wanted;            /* one is due that has not been made */
    size_t state_left;            /* bytes of it that the builder has not seen; 0: none waits */

    struct connection connection;
    struct assembler assembler;
    struct configuration configuration;
    struct live_change live_change;
    struct remembered remembered;
    struct faults faults;
    struct packet state_packet;
    uint64_t received_at; /* when the bytes came that are being taken */
    uint64_t leaves_at;   /* for the boot loader; 0: it stays */
    uint32_t stopped_at;  /* where the processor stopped before its last reset, or 0 */
    uint32_t command_lifetime_us, supervise_lifetime_us, ramp;
    uint32_t missed_lately, lately; /* ticks missed within a second, and the sample with which that began */
};

/* After power-up, with a struct of zeroes: in BOOT, at the board's initial rate. `hal` and `board` must live as
 * long. */
void device_start(struct device *device, const struct hal *hal, const struct board *board);

/* Start again as after a reset that left the memory alone: the motor's heat and the link counters stay. */
void device_restart(struct device *device);

/* One tick of a board: sample, drive, tell; and food for the hardware watchdog, as long as device_poll comes by. What is to
 * be sent waits for device_poll. Ticks that were missed before it are counted by its
 * time; two in succession end an armed run. */
void device_tick(struct device *device);

/* The same for a port whose set-point and sample travel in one message, which leaves when a tick is due: it calls
 * device_drive then, and this when the sample has come. The set-point acts behind the sample: `active` is the current
 * before it. `missed` periods since the last call had no sample: how late this one comes does not tell that. */
void device_tick_driven(struct device *device, int16_t active, uint32_t missed);

/* The parts of a tick, for a caller that lets time pass between them, as a simulation does: it drives, lets the world
 * move, samples and reports. */
void device_sample(struct device *device); /* count, time, measured current; faults; the law that runs here */
void device_drive(struct device *device);  /* the current until the next sample */
void device_tell(struct device *device);   /* BATCH, STATE, the ring of ticks before a fault */

/* Whether something waits to be sent; send all of it, at once. */
bool device_is_sending(const struct device *device);
void device_flush(struct device *device);

/* Whether device_poll has something to do even when no byte comes: an excitation to work out, parameters to change. */
bool device_is_preparing(const struct device *device);
bool device_is_changing(const struct device *device);

/* Whether it drives the motor. A session may last longer: a fault leaves it open until DISARM. */
bool device_is_armed(const struct device *device);

/* The port has found a fault (enum hr_fault): zero effort from here on, FAULT latched. */
void device_fault(struct device *device, uint8_t fault);

/* The hardware watchdog has reset the board; before that the processor had stopped at an address, or 0. */
void device_was_reset(struct device *device, uint32_t stopped_at);

/* ------------------------------------------------------------------ for what takes the host's requests */

/* Whether the law on the device computes the current. */
bool device_runs_law(const struct device *device);

/* Take a COMMAND that connection_judge has let through. */
void device_command(struct device *device, const uint8_t *raw);

/* Run under other parameters from the next tick on, or return false and go on as before. */
bool device_apply(struct device *device, const struct candidate *candidate);

/* Take the law that the parameters choose; checks were made. NULL: the host's. */
void device_take_law(struct device *device, const law_parameters *law, const struct candidate *candidate);

/* Forget what belongs to the last session: a new one begins. */
void device_begin_session(struct device *device);

/* Zero current now, regardless of the slew limit. */
void device_cut(struct device *device);

/* Cut, and switch the amplifier on: from here on the hardware watchdog bites early. Or off. */
void device_switch_on(struct device *device);
void device_switch_off(struct device *device);

/* The law on the device runs no longer: what BATCH has not sent yet leaves. */
void device_end_supervision(struct device *device);

/* Send a frame that connection_begin has begun. */
void device_send(struct device *device, struct packet *packet);

/* Pack at most so many bytes of what waits, or send a piece of it; false when there is nothing worth a look. */
bool device_send_some(struct device *device, size_t most);

#endif
