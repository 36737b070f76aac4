#include "limits.h"

#include "protocol.h"

#define FADES_A_SECOND 2u

void limits_configure(struct limits *limits, const struct limits_settings *settings)
{
    limits->largest = settings->largest;
    limits->continuous = settings->continuous;
    limits->slew = settings->slew; /* 65535 means no limit: a 16-bit current cannot change by more */
    limits->confirm = (uint32_t)((uint64_t)settings->confirm_ms * settings->rate / 1000u);
    limits->fade = settings->rate / FADES_A_SECOND;
    limits->unmoved = 0;
}

void limits_pass(struct limits *limits, int32_t count)
{
    const uint32_t away = (uint32_t)count - (uint32_t)limits->low;
    const bool moved = limits->moved = away > 1u;
    if (moved)
        limits->low = (int32_t)away < 0 ? count : (int32_t)((uint32_t)count - 1u);
    if (moved && limits->unmoved <= limits->confirm)
        limits->unmoved = 0;
    else if (limits->unmoved < UINT32_MAX)
        limits->unmoved++;
}

/* With two channels a dead encoder cannot be distinguished from a hand that holds still. If one channel is dead, the other
 * toggles the count between two neighbouring values for any motion. Therefore an effort that lasts longer than any trial,
 * with the count on two neighbouring values, fades out; it returns when the hand has left the wall. */
int16_t limits_fade(struct limits *limits, int16_t wanted)
{
    if ((wanted == 0 && !limits->beside) || limits->confirm == 0)
        limits->unmoved = 0;
    if (limits->unmoved <= limits->confirm)
        return wanted;
    limits->flags |= HR_LIMIT_NOT_CONFIRMED;
    const uint32_t faded = limits->unmoved - limits->confirm;
    if (faded >= limits->fade)
        return 0;
    return (int16_t)(wanted * (int32_t)(limits->fade - faded) / (int32_t)limits->fade);
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
    int32_t current = clip(limits, limits_fade(limits, wanted), limits->largest, HR_LIMIT_CURRENT);
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
