/* What a port does between two ticks. */
#ifndef HR_POLL_H
#define HR_POLL_H

#include <stddef.h>

#include "device.h"

/* What one device_poll does at most: neither a flood of bytes nor an excitation can starve the tick. */
#define HR_BYTES_A_POLL 16u /* of BATCH, and of STATE beside a law, packed into a frame */
#define HR_POLL_BYTES_RUNNING 8u /* taken in one while the law runs here */
#define HR_POLL_BYTES 64u
#define HR_POLL_COSINES 32u

/* Send a piece of what waits, or do a piece of a change, or take what the host has sent and answer; and work on an
 * excitation that is not ready. Returns the number of bytes taken. */
size_t device_poll(struct device *device);

#endif
