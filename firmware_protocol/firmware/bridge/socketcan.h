/* CAN frames as Linux's raw CAN sockets have them: one struct canfd_frame a read, one a write.
 *
 * Source: Linux, Documentation/networking/can.rst and include/uapi/linux/can.h. */
#ifndef HR_SOCKETCAN_H
#define HR_SOCKETCAN_H

#include <stddef.h>
#include <stdint.h>

#include "can_frame.h"

#define SOCKETCAN_BYTES 72u /* of a CAN FD frame */
#define SOCKETCAN_CLASSIC_BYTES 16u

enum socketcan_kind {
    SOCKETCAN_NONE, /* no frame of this kind */
    SOCKETCAN_FRAME,
    SOCKETCAN_BUS_OFF, /* the controller has left the bus after too many errors */
};

enum socketcan_kind socketcan_take(const uint8_t *bytes, size_t count, struct can_frame_bytes *frame);

/* Write a frame (CAN FD at the higher bit rate unless it is classic); returns its length (bytes), at most
 * SOCKETCAN_BYTES. */
size_t socketcan_make(const struct can_frame_bytes *frame, uint8_t *into);

#endif
