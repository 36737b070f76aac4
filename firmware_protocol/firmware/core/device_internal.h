/* What the parts of the device share. */
#ifndef HR_DEVICE_INTERNAL_H
#define HR_DEVICE_INTERNAL_H

#include "device.h"

/* Answer a request, or its refusal. */
void answer(struct device *device, const uint8_t *raw, size_t count, const struct verdict *verdict);

/* Answer a change of an armed device that is done. */
void answer_live_change(struct device *device);

/* Run under other parameters from the next tick on, or return false and go on as before. */
bool device_apply(struct device *device, const struct candidate *candidate);

/* Forget what belongs to the last session: a new one begins. */
void device_begin_session(struct device *device);

/* Zero current now, whatever the slew limit says. */
void device_cut(struct device *device);

/* Cut, and switch the amplifier off. */
void device_switch_off(struct device *device);

/* Take the law that the parameters choose; checks were made. NULL: the host's. */
void device_take_law(struct device *device, const law_parameters *law, const struct candidate *candidate);

/* The law on the device runs no longer: what BATCH has not sent yet leaves. */
void device_end_supervision(struct device *device);

/* Send a frame that connection_begin has begun. */
void device_send(struct device *device, struct packet *packet);

#endif
