/* The protocol's state machine: states, sessions, sequences; which frames are accepted, and the state after each. */
#ifndef HR_CONNECTION_H
#define HR_CONNECTION_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "counters.h"
#include "frame.h"
#include "protocol.h"

struct connection {
    uint8_t state;        /* enum hr_state */
    uint8_t session;      /* 0 outside of one */
    uint8_t last_session; /* refused by the next ARM */
    bool has_command;     /* a COMMAND of this session has arrived */
    uint16_t newest;      /* its sequence */
    uint16_t to_send[HR_MESSAGES];
    struct counters counters;
    struct splitter splitter;
};

enum verdict_kind {
    VERDICT_DROP,    /* counted, not answered */
    VERDICT_COMMAND, /* deliver it */
    VERDICT_REQUEST, /* execute it and answer */
    VERDICT_REFUSE,  /* answer with `status` and `detail`, unless it is a repeat */
};

struct verdict {
    enum verdict_kind kind;
    enum hr_status status;
    uint16_t detail;
};

/* Reset to the state after power-up; only the counters are kept. */
void connection_reset(struct connection *connection);

/* Judge a raw frame. A COMMAND that is to be delivered has moved the state. */
struct verdict connection_judge(struct connection *connection, const uint8_t *raw, size_t count);

/* Change the state after a request that was granted, by the table. `session` is that of its header. */
void connection_advance(struct connection *connection, uint8_t type, uint8_t session);

/* Latch FAULT. The session stays, so that STATE frames still reach the host that runs it. */
void connection_fault(struct connection *connection);

/* Write the header of our next frame of a type. */
void connection_header(struct connection *connection, uint8_t *raw, enum hr_index index);

/* Begin a frame of ours: its header, and `bytes` in all with the fields that the caller fills in. */
uint8_t *connection_begin(struct connection *connection, struct packet *packet, enum hr_index index, size_t bytes);

/* Count a frame of a stream that was not sent, so that the host sees the loss. */
void connection_skip(struct connection *connection, enum hr_index index);

#endif
