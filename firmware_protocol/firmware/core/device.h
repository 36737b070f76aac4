/* The device: the controller of a rig, with the protocol of PROTOCOL.md. One struct, no globals, no heap.
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

/* The last request that changed something, and its reply: a repeat is not executed again. */
struct remembered {
    bool there;
    uint8_t session;
    struct ack ack; /* names request and nonce */
};

/* Data of a tick from device_sample to device_report. */
struct tick_report {
    struct fault_entry entry;
    bool logged;     /* into the fault ring: no fault was latched before it */
    bool supervised; /* a sample of the law on the device: into BATCH */
    uint8_t sync;    /* what the pins showed up to the sample */
};

/* What a tick works with stands first: a small processor reaches near fields with one instruction. What grows with the
 * list of parameters stands last. */
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
    uint32_t bite_us;      /* timeout of the hardware watchdog */
    uint32_t unpolled, most_unpolled; /* ticks since the last device_poll, and the maximum */
    struct tick_report tick;
    int16_t driven;        /* active current since the last sample (quanta) */
    uint16_t command_age;  /* ticks; saturates */
    uint16_t limits_acted; /* since the last STATE */
    bool on_grid;          /* a tick has come since the rate was set: the next one's time is known */
    bool supervised;       /* by the active command */
    bool needs_hold;
    uint8_t reported_fault; /* in the last STATE */
    uint8_t sync;          /* bits of enum hr_sync on the pins */
    uint8_t command_sync;  /* their values in the active command */
    bool commanded;        /* in this session */
    uint16_t command_sequence;
    struct limits limits;
    struct watchdog watchdog;
    struct thermal thermal;
    struct renderer renderer;
    struct monitor monitor;
    struct batch batch;
    struct current_check current;
    struct builder state_builder; /* of a STATE that waits to be sent */
    bool state_wanted;            /* one is due that has not been made */
    size_t state_left;            /* bytes of it that the builder has not seen; 0: none waits */

    struct connection connection;
    struct remembered remembered;
    struct packet state_packet;
    uint64_t received_at; /* when the bytes came that are being taken */
    uint64_t leaves_at;   /* for the boot loader; 0: it stays */
    uint32_t stopped_at;  /* where the processor stopped before its last reset, or 0 */
    uint32_t command_lifetime_us, supervise_lifetime_us, ramp;
    uint32_t missed_lately, lately; /* ticks missed within a second, and the sample with which that began */
    struct faults faults;
    struct assembler assembler;
    struct configuration configuration;
    struct live_change live_change;
};

/* Start the device after power-up, in the state BOOT, at the board's initial rate. `device` must be zero before; `hal`
 * and `board` must exist as long as it. */
void device_start(struct device *device, const struct hal *hal, const struct board *board);

/* Start again as after a reset, but keep the motor's heat and the link counters. */
void device_restart(struct device *device);

/* Run one tick of a board: sample, drive, report; feed the hardware watchdog while device_poll is called. Frames are
 * sent by device_poll. Missed ticks are counted from the device time; two in succession end an armed run. */
void device_tick(struct device *device);

/* Run one tick like device_tick, for a port that sends its set-point and receives its sample in one exchange. The port
 * calls device_drive when a tick is due, and this function when the sample has arrived. The set-point acts after the
 * sample: `active` is the current before it. `missed` is the number of periods without a sample since the last call,
 * because the time of the call does not show it. */
void device_tick_driven(struct device *device, int16_t active, uint32_t missed);

/* The parts of a tick, for a simulation, in which the plant moves in between: drive, move the plant, sample, report. */
void device_sample(struct device *device); /* count, time, measured current; faults; the law that runs here */
void device_drive(struct device *device);  /* the current until the next sample */
void device_report(struct device *device);   /* BATCH, STATE, the ring of ticks before a fault */

/* Return true if a frame waits to be sent; send all waiting frames at once. */
bool device_is_sending(const struct device *device);
void device_flush(struct device *device);

/* Return true if device_poll has work without new bytes: an excitation to compute, parameters to change. */
bool device_is_preparing(const struct device *device);
bool device_is_changing(const struct device *device);

/* Return true if the device may drive the motor. A session may last longer: after a fault it is open until DISARM. */
bool device_is_armed(const struct device *device);

/* Latch a fault that the port has found (enum hr_fault): zero effort at once. */
void device_fault(struct device *device, uint8_t fault);

/* Latch the fault of a reset by the hardware watchdog. `stopped_at`: address at which the processor had stopped, or 0. */
void device_was_reset(struct device *device, uint32_t stopped_at);

/* ------------------------------------------------------------------ for answers.c, poll.c and live_change.c */

/* Return true if the law on the device computes the current. */
bool device_runs_law(const struct device *device);

/* Execute a COMMAND that connection_judge has accepted. */
void device_command(struct device *device, const uint8_t *raw);

/* Use new parameters from the next tick on. Returns false, and changes nothing, if the timer cannot have the tick
 * rate. */
bool device_apply(struct device *device, const struct candidate *candidate);

/* Use the law that the parameters choose and that was checked; NULL: the law runs on the host. */
void device_take_law(struct device *device, const law_parameters *law, const struct candidate *candidate);

/* Clear all data of the last session. */
void device_begin_session(struct device *device);

/* Set the current to zero now, regardless of the slew limit. */
void device_cut(struct device *device);

/* Set the current to zero and switch the amplifier on (with the short timeout of the hardware watchdog), or off. */
void device_switch_on(struct device *device);
void device_switch_off(struct device *device);

/* Stop the law on the device and queue the samples that were not sent yet. */
void device_end_supervision(struct device *device);

/* Send a frame that was begun by connection_begin. */
void device_send(struct device *device, struct packet *packet);

/* Pack at most `most` bytes of waiting frames, or send one frame; returns false if no frame waits. */
bool device_send_some(struct device *device, size_t most);

#endif
