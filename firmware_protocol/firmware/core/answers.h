/* Requests of the host: execute each and reply. */
#ifndef HR_ANSWERS_H
#define HR_ANSWERS_H

#include <stddef.h>
#include <stdint.h>

#include "device.h"

/* Execute a request of the host and send the reply, or send the refusal that `verdict` contains. */
void answer(struct device *device, const uint8_t *raw, size_t count, const struct verdict *verdict);

/* Do the next step of a parameter change while the device is armed; send the ACK after the last step. */
void answer_more(struct device *device);

#endif
