/* device_poll: the work between two ticks. */
#ifndef HR_POLL_H
#define HR_POLL_H

#include <stddef.h>

#include "device.h"

/* Limits of one device_poll, so that neither a flood of bytes nor an excitation delays the tick. */
#define HR_BYTES_A_POLL 16u /* of BATCH, and of STATE beside a law, packed into a frame */
#define HR_POLL_BYTES_RUNNING 8u /* taken in one while the law runs here */
#define HR_POLL_BYTES 64u
#define HR_POLL_COSINES 32u

/* Send part of the waiting frames, or do a step of a parameter change, or read bytes from the host and reply; then
 * compute part of an excitation that is not ready. Returns the number of bytes read. */
size_t device_poll(struct device *device);

#endif
