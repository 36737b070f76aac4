/* Requests of the host: what executes each, and its answer. */
#ifndef HR_ANSWERS_H
#define HR_ANSWERS_H

#include <stddef.h>
#include <stdint.h>

#include "device.h"

/* Answer a request, or its refusal. */
void answer(struct device *device, const uint8_t *raw, size_t count, const struct verdict *verdict);

/* Do a piece of a change of an armed device, and answer it with the last. */
void answer_more(struct device *device);

#endif
