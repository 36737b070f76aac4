#include "wall.h"

#include <math.h>

bool wall_of_law(const struct wall_scales *scales, const law_parameters *law, uint32_t rate, struct drive_wall *wall)
{
    const double along = (double)law->wall.surface_whole + (double)law->wall.surface_fraction; /* the position */
    const double per_turn = fabs(scales->torque_per_quantum * scales->counts_per_turn);
    wall->surface = (float)((law->reference + law->sense * along) / scales->counts_per_turn);
    wall->above = law->wall.side * (float)law->sense * scales->counts_per_turn > 0.0;
    wall->stiffness = (float)(law->wall.stiffness * per_turn);
    wall->damping = (float)(law->wall.damping * per_turn / rate);
    wall->limit = INFINITY;
    return law->may_pull && !law->entry_only && !law->bilateral && !law->extrapolate && law->velocity_divider == 1
           && law->slow_multiple == 1 && law->excitation.lines == 0;
}

/* Return the share of the wall's effort that acts: 1 in a trial, falling to 0 in the release. */
static float share_of_phase(const law_state *state, const law_parameters *law)
{
    if (state->phase == LAW_TRIAL)
        return 1.0f;
    return state->phase == LAW_RELEASE ? 1.0f - (float)state->phase_ticks / (float)law->release_ticks : 0.0f;
}

bool wall_now(const struct wall_scales *scales, struct device *device, int16_t given, struct drive_wall *wall)
{
    const law_parameters *law = &device->renderer.parameters;
    struct limits *limits = &device->limits;
    const int32_t less = thermal_is_spent(&device->thermal) ? limits->continuous : limits->largest;
    const int32_t limit = less < limits->largest ? less : limits->largest;
    if (!device_is_armed(device) || !device_runs_law(device) || law->arithmetic != LAW_ELSEWHERE
        || (limits->flags & HR_LIMIT_HOLD_TO_RUN_RELEASED) || !wall_of_law(scales, law, device->rate, wall))
        return false;
    const int16_t left = limits_fade(limits, watchdog_fade(&device->watchdog, device->due, INT16_MAX));
    const float share = share_of_phase(&device->renderer.state, law) * (float)left / (float)INT16_MAX;
    if (given >= limit || given <= -limit)
        limits->flags |= HR_LIMIT_CURRENT;
    wall->stiffness *= share;
    wall->damping *= share;
    wall->limit = (float)(limit * fabs(scales->torque_per_quantum));
    return share > 0.0f;
}
