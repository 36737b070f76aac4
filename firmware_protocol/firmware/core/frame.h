/* Frames: byte stuffing (COBS), a 0x00 after each frame, CRC-32 inside. */
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

/* Append the CRC, apply the byte stuffing, append the delimiter. Returns the number of bytes to send from
 * `packet->bytes`. */
size_t frame_finish(struct packet *packet);

/* A frame that is packed piece by piece: CRC and stuffing of the bytes so far. Its bytes are in the owner's memory, at
 * the same offsets as in a packet, so raw bytes may be appended in place. */
struct builder {
    uint8_t *bytes;
    uint32_t crc;
    size_t end;  /* bytes so far */
    size_t code; /* where the distance to the next zero goes */
};

void builder_begin(struct builder *builder, uint8_t *bytes);
void builder_append(struct builder *builder, const uint8_t *raw, size_t count);

/* Append CRC and delimiter. Returns the number of bytes to send. */
size_t builder_finish(struct builder *builder);

/* The frame that is being received, decoded byte by byte, so that its last byte takes no longer than the others. */
struct splitter {
    size_t count;    /* bytes so far, with the codes */
    size_t zero;     /* where the next code will be */
    uint32_t crc;    /* of the raw bytes so far, the CRC itself among them */
    bool skipping;   /* inside something too long: wait for its end */
    uint8_t bytes[HR_ENCODED_LIMIT];
};

void splitter_reset(struct splitter *splitter);

/* Process a received byte. Returns the length of the raw frame (without CRC) that the byte completes, or 0. Counts
 * defects. */
size_t splitter_take(struct splitter *splitter, uint8_t byte, struct counters *counters);

/* Return the raw frame that was just completed; it is valid until the next call of splitter_take. */
const uint8_t *splitter_raw(const struct splitter *splitter);

uint32_t crc_of(const uint8_t *bytes, size_t count);

/* Continue a CRC with further bytes: begin with UINT32_MAX, and invert the result at the end. */
uint32_t crc_more(uint32_t crc, const uint8_t *bytes, size_t count);

#endif
