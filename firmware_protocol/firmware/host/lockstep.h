/* A tick in two calls, and a third call for bytes from the host. All data that a compiled simulation and the device
 * exchange are in one block of memory. */
#ifndef HR_LOCKSTEP_H
#define HR_LOCKSTEP_H

#include <stdint.h>

#include "host.h"

/* Only 64-bit words, so that the simulation can use it as an array. */
struct lockstep {
    /* Encoder, current sensor and inputs at the sample. */
    int64_t count, edge_age, measured, inputs;

    /* Results of the call, and the device's time and state. */
    int64_t cuts;         /* times that the current was taken away besides the tick's own */
    int64_t due;          /* device time of the next sample */
    int64_t sample_index; /* of the last */
    int64_t session;
    int64_t time; /* device time of the last */

    /* Bytes from the host: address, number, device time of arrival, and their effects. */
    int64_t bytes, byte_count, received_at;
    int64_t rate_changed, switched_on;

    /* The encoder's index, as struct hal has it. */
    int64_t index_edges, index_count;
};

/* First half of a tick: return the current for the coming period (quanta). */
int lockstep_drive(struct host *host, struct lockstep *lockstep);

/* Second half of a tick, after the plant has moved: process the sample. Returns the number of bytes that wait for the
 * host. */
int lockstep_sample(struct host *host, struct lockstep *lockstep);

/* Between two ticks: process the bytes from the host. Returns the number of bytes that wait for the host. */
int lockstep_receive(struct host *host, struct lockstep *lockstep);

#endif
