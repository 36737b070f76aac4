/* Requests of the host: execute each and reply. */
#ifndef HR_ANSWERS_H
#define HR_ANSWERS_H

#include <stddef.h>
#include <stdint.h>

#include "device.h"

/* Execute a request and send the reply, or send the refusal. */
void answer(struct device *device, const uint8_t *raw, size_t count, const struct verdict *verdict);

/* Do the next step of a parameter change of an armed device, and acknowledge it after the last. */
void answer_more(struct device *device);

#endif
