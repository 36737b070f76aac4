/* The core as a library of this computer: a simulation sets counts, times and inputs between the calls. Also for
 * tests. */
#ifndef HR_HOST_H
#define HR_HOST_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../core/device.h"
#include "../core/on_a_computer.h"

#define HR_HOST_NARROWER 16u
#define HR_HOST_EXCITATION 65536u /* numbers of a table: what the protocol allows at most */
#define HR_HOST_POLLS 4u          /* of an idle main loop in a tick */
#define HR_HOST_OUTPUT_BYTES 65536u

struct host {
    struct device device;
    struct hal hal;
    struct board board;
    struct narrower narrower[HR_HOST_NARROWER];
    int16_t excitation[HR_HOST_EXCITATION];

    /* Encoder, current sensor and inputs, as the simulation sets them. */
    uint64_t time, edge_time;
    uint64_t time_step; /* by which each look at the clock moves it on: work takes time */
    int32_t count;
    int16_t measured;
    uint8_t inputs;
    bool encoder_failed;
    uint32_t index_edges;
    int32_t index_count;
    uint32_t refused_rate; /* that the timer cannot do */

    /* Effects of the device on the hardware. */
    int16_t current;
    bool enabled, driving, left;
    uint8_t sync; /* bits of enum hr_sync */
    uint64_t sync_time;
    uint32_t cuts; /* times that the current was taken away between two ticks */
    uint32_t rate, feeds, bite_us, syncs;

    /* The link. */
    const uint8_t *input;
    size_t input_count;
    uint8_t output[HR_HOST_OUTPUT_BYTES];
    size_t output_count;
    size_t output_room; /* bytes that the output holds, HR_HOST_OUTPUT_BYTES at most */
    uint32_t dropped;   /* frames that it had no room for */
    uint32_t frames_driven; /* that left while a current was set */
};

struct host_status {
    uint64_t time;
    uint64_t due;
    uint32_t sample_index;
    uint32_t rate;
    uint32_t cuts;
    uint32_t feeds;
    uint32_t bite_us;
    uint32_t dropped;
    uint32_t frames_driven;
    int32_t current;
    uint8_t state;
    uint8_t session;
    uint8_t fault;
    uint8_t enabled;
    struct counters counters;
    uint8_t sync;
    uint8_t left; /* for the boot loader */
};

size_t host_bytes(void);

/* Set up `host`, which must be host_bytes() bytes of zero. The dictionary must exist as long as `host`. host_narrow
 * must be called in ascending order of the parameters. */
void host_setup(struct host *host, const struct board_setup *setup);
void host_narrow(struct host *host, uint8_t parameter, uint32_t minimum, uint32_t maximum);
void host_set_excitation(struct host *host, uint32_t length); /* memory for a table; HR_HOST_EXCITATION at first */
void host_start(struct host *host);
void host_restart(struct host *host);

void host_set_world(struct host *host, uint64_t time, int32_t count, uint64_t edge_time, int16_t measured,
                    uint8_t inputs);
void host_set_clock(struct host *host, uint64_t time, uint64_t step);
void host_set_inputs(struct host *host, uint8_t inputs);
void host_fail_encoder(struct host *host);
void host_set_sync_time(struct host *host, uint64_t time);
void host_set_index(struct host *host, uint32_t edges, int32_t count);
void host_set_room(struct host *host, size_t bytes); /* of the output: what does not fit is dropped */
void host_refuse_rate(struct host *host, uint32_t rate);

/* A tick in parts (the plant moves after host_drive), or as a whole, as on a board. */
int16_t host_drive(struct host *host);
void host_sample(struct host *host);
void host_report(struct host *host);
void host_tick(struct host *host);
void host_tick_alone(struct host *host); /* what is to be sent waits for host_poll, as on a board */
void host_fault(struct host *host, uint8_t fault);
void host_was_reset(struct host *host, uint32_t stopped_at);
void host_let_leave(struct host *host); /* it has a boot loader */

/* Pass in bytes from the host; take out the bytes that the device has sent. */
void host_receive(struct host *host, const uint8_t *bytes, size_t count);
size_t host_poll(struct host *host, const uint8_t *bytes, size_t count); /* one device_poll; returns bytes taken */
size_t host_take(struct host *host, uint8_t *into, size_t capacity);

/* Copy the parameters of the law that the device runs; returns false if it runs no law. */
bool host_law(const struct host *host, law_parameters *into);

void host_status(const struct host *host, struct host_status *status);

#endif
