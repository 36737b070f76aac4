/* The wall of the law that runs (law.h), left to a drive: what of it is to act, in the terms of the drive's output. */
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

/* The whole wall of a law that runs so many times a second, without a limit; false for one that no drive has: what clamps
 * its pull, damps one way or has two rates. */
bool wall_of_law(const struct wall_scales *scales, const law_parameters *law, uint32_t rate, struct drive_wall *wall);

/* What is to act of it in the tick that device_drive has begun: as much as of a current that a law here would want, and
 * with the set-point within the same limit. False: nothing. `given` is what both gave at the last sample (quanta). */
bool wall_now(const struct wall_scales *scales, struct device *device, int16_t given, struct drive_wall *wall);

#endif
