#include "limits.h"

#include "protocol.h"

void limits_configure(struct limits *limits, uint16_t largest, uint16_t continuous, uint16_t slew)
{
    limits->largest = largest;
    limits->continuous = continuous;
    limits->slew = slew; /* 65535, which means none, is further than a current of 16 bits can change */
}

/* Clip to ± limit, and set a flag if that changed something. */
static int32_t clip(struct limits *limits, int32_t value, int32_t limit, uint16_t flag)
{
    if (value >= -limit && value <= limit)
        return value;
    limits->flags |= flag;
    return value > 0 ? limit : -limit;
}

int16_t limits_apply(struct limits *limits, const struct thermal *thermal, int16_t wanted)
{
    int32_t current = clip(limits, wanted, limits->largest, HR_LIMIT_CURRENT);
    if (thermal_is_spent(thermal))
        current = clip(limits, current, limits->continuous, HR_LIMIT_THERMAL);
    current = limits->current + clip(limits, current - limits->current, limits->slew, HR_LIMIT_SLEW);
    limits->current = (int16_t)current;
    return limits->current;
}

void limits_cut(struct limits *limits)
{
    limits->current = 0;
}
