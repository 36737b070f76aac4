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

/* Convert the wall of a law at this rate, without a limit. False if no drive can render it: a wall that clamps its pull,
 * damps in one direction or has two rates. */
bool wall_of_law(const struct wall_scales *scales, const law_parameters *law, uint32_t rate, struct drive_wall *wall);

/* Return the active part of the wall in the tick that device_drive has begun, reduced like the current of a law on the
 * device, and limited together with the set-point. False: no wall. `given` is the sum of both at the last sample (quanta). */
bool wall_now(const struct wall_scales *scales, struct device *device, int16_t given, struct drive_wall *wall);

#endif
