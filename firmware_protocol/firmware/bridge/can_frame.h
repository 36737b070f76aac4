/* A frame of a CAN bus, of up to 64 bytes (CAN FD). */
#ifndef HR_CAN_FRAME_H
#define HR_CAN_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define CAN_FRAME_BYTES 64u

struct can_frame_bytes {
    uint32_t id; /* 11 or 29 bits */
    uint8_t count;
    uint8_t bytes[CAN_FRAME_BYTES];
    bool classic; /* of eight bytes at most, for drives without CAN FD */
    bool remote;  /* a remote request: classic, without bytes */
};

#endif
