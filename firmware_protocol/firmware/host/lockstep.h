/* A tick in two calls, and bytes of the host in a third. All data that a compiled simulation and the device exchange are
 * in one block of memory. */
#ifndef HR_LOCKSTEP_H
#define HR_LOCKSTEP_H

#include <stdint.h>

#include "host.h"

/* 64-bit words alone: an array of them for the simulation. */
struct lockstep {
    /* The world at the sample. */
    int64_t count, edge_age, measured, inputs;

    /* What the device did in the call, and where it is. */
    int64_t cuts;         /* times that the current was taken away besides the tick's own */
    int64_t due;          /* device time of the next sample */
    int64_t sample_index; /* of the last */
    int64_t session;
    int64_t time; /* device time of the last */

    /* Bytes of the host, by address, when they came (device time), and what they changed. */
    int64_t bytes, byte_count, received_at;
    int64_t rate_changed, switched_on;

    /* The encoder's index, as struct hal has it. */
    int64_t index_edges, index_count;
};

/* First half: the current for the coming tick. */
int lockstep_drive(struct host *host, struct lockstep *lockstep);

/* Second half, when the world has moved: the sample that is due. The bytes that wait for the host. */
int lockstep_sample(struct host *host, struct lockstep *lockstep);

/* Between two ticks: hand all bytes in. The bytes that wait for the host. */
int lockstep_receive(struct host *host, struct lockstep *lockstep);

#endif
