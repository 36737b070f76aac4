#include "socketcan.h"

#include <linux/can.h>
#include <linux/can/error.h>
#include <string.h>

typedef char frame_has_its_bytes[CANFD_MTU == SOCKETCAN_BYTES && CAN_MTU == SOCKETCAN_CLASSIC_BYTES ? 1 : -1];

enum socketcan_kind socketcan_take(const uint8_t *bytes, size_t count, struct can_frame_bytes *frame)
{
    struct canfd_frame raw = {0};
    if (count != CAN_MTU && count != CANFD_MTU)
        return SOCKETCAN_NONE;
    memcpy(&raw, bytes, count);
    if (raw.can_id & CAN_ERR_FLAG)
        return raw.can_id & CAN_ERR_BUSOFF ? SOCKETCAN_BUS_OFF : SOCKETCAN_NONE;
    if (raw.can_id & CAN_RTR_FLAG || raw.len > (count == CAN_MTU ? CAN_MAX_DLEN : CANFD_MAX_DLEN))
        return SOCKETCAN_NONE;
    frame->id = raw.can_id & (raw.can_id & CAN_EFF_FLAG ? CAN_EFF_MASK : CAN_SFF_MASK);
    frame->count = raw.len;
    memcpy(frame->bytes, raw.data, raw.len);
    return SOCKETCAN_FRAME;
}

size_t socketcan_make(const struct can_frame_bytes *frame, uint8_t *into)
{
    struct canfd_frame raw = {0};
    const size_t count = frame->classic ? CAN_MTU : CANFD_MTU;
    raw.can_id = frame->id | (frame->id > CAN_SFF_MASK ? CAN_EFF_FLAG : 0u) | (frame->remote ? CAN_RTR_FLAG : 0u);
    raw.len = frame->count;
    if (!frame->classic)
        raw.flags = CANFD_BRS;
    memcpy(raw.data, frame->bytes, frame->count);
    memcpy(into, &raw, count);
    return count;
}
