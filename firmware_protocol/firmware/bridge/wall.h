/* The wall of the running law (law.h) rendered by a drive: its active part, in the units of the drive's output. */
#ifndef HR_BRIDGE_WALL_H
#define HR_BRIDGE_WALL_H

#include <stdbool.h>
#include <stdint.h>

#include "../core/device.h"
#include "drive.h"

struct wall_scales {
    double counts_per_turn;    /* of the output; may be negative */
    double torque_per_quantum; /* N·m at the output; may be negative */
};

/* Convert the wall of a law at this tick rate to the drive's units, without its limit. Returns false if no drive can
 * render it: a wall that only pushes, that damps in one direction only, or that has two rates. */
bool wall_of_law(const struct wall_scales *scales, const law_parameters *law, uint32_t rate, struct drive_wall *wall);

/* Compute the active part of the wall in the tick that device_drive has begun, reduced like the current of a law on the
 * device, and limited together with the set-point. Returns false without a wall. `given` is the sum of wall and
 * set-point at the last sample (quanta). */
bool wall_now(const struct wall_scales *scales, struct device *device, int16_t given, struct drive_wall *wall);

#endif
