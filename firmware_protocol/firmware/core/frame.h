/* Frames: COBS, one 0x00 behind each, CRC-32 inside. */
#ifndef HR_FRAME_H
#define HR_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "counters.h"
#include "protocol.h"

/* One frame to send. The raw frame lies behind a byte of room for the first COBS code, so that it is stuffed in
 * place. */
#define HR_RAW_AT 1u

struct packet {
    size_t count; /* bytes of header and payload */
    uint8_t bytes[HR_RAW_AT + HR_SHORT_RAW_LIMIT + 1u];
};

/* Append the CRC, stuff, delimit; returns the bytes that go on the wire, from the beginning of `packet->bytes`. */
size_t frame_finish(struct packet *packet);

/* One unfinished frame of whatever comes. */
struct splitter {
    size_t count;
    bool skipping; /* inside something too long: wait for its end */
    uint8_t bytes[HR_ENCODED_LIMIT];
};

void splitter_reset(struct splitter *splitter);

/* Take a byte. Returns the length of the raw frame (without its CRC) that it completes, or 0; defects are counted. */
size_t splitter_take(struct splitter *splitter, uint8_t byte, struct counters *counters);

/* The raw frame that has just been completed; good until the next byte is taken. */
const uint8_t *splitter_raw(const struct splitter *splitter);

uint32_t crc_of(const uint8_t *bytes, size_t count);

#endif
