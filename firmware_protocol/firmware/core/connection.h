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
    uint8_t session;      /* 0 without a session */
    uint8_t last_session; /* refused by the next ARM */
    bool has_command;     /* a COMMAND of this session has arrived */
    uint16_t newest;      /* sequence number of the newest COMMAND */
    uint16_t to_send[HR_MESSAGES];
    struct counters counters;
    struct splitter splitter;
};

enum verdict_kind {
    VERDICT_DROP,    /* drop the frame; it was counted */
    VERDICT_COMMAND, /* execute the COMMAND */
    VERDICT_REQUEST, /* execute the request and reply */
    VERDICT_REFUSE,  /* reply with `status` and `detail`, unless the request is a repeat */
};

struct verdict {
    enum verdict_kind kind;
    enum hr_status status;
    uint16_t detail;
};

/* Reset to the state after power-up; only the counters are kept. */
void connection_reset(struct connection *connection);

/* Decide what to do with a raw frame. For VERDICT_COMMAND the state has been changed already. */
struct verdict connection_judge(struct connection *connection, const uint8_t *raw, size_t count);

/* Change the state after an accepted request, by the table of transitions. `session` is the number in its header. */
void connection_advance(struct connection *connection, uint8_t type, uint8_t session);

/* Enter the state FAULT. The session stays open, so that STATE frames still reach its host. */
void connection_fault(struct connection *connection);

/* Write the header of the device's next frame of a type, with its sequence number. */
void connection_header(struct connection *connection, uint8_t *raw, enum hr_index index);

/* Begin a frame of the device with its header; the caller fills in the fields. `bytes` is the length of both. */
uint8_t *connection_begin(struct connection *connection, struct packet *packet, enum hr_index index, size_t bytes);

/* Count a frame of a stream that was not sent, so that the host sees the loss. */
void connection_skip(struct connection *connection, enum hr_index index);

#endif
