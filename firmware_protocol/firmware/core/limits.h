/* Limits of the set-point, in this order: fade of a position that is not confirmed, current, thermal model, slew. */
#ifndef HR_LIMITS_H
#define HR_LIMITS_H

#include <stdbool.h>
#include <stdint.h>

#include "thermal.h"

struct limits {
    int16_t current; /* active (quanta) */
    uint16_t flags;  /* enum hr_limit bits that acted since they were last cleared */
    int32_t largest;
    int32_t continuous;
    int32_t slew; /* quanta a tick */
    uint32_t confirm; /* ticks under effort with the count on two neighbouring values, before the effort fades; 0: never */
    uint32_t fade;    /* ticks that this takes */
    uint32_t unmoved; /* such ticks so far; beyond `confirm` since the effort began to fade, too */
    int32_t low;      /* the lower of those two counts */
    bool moved;       /* whether the last tick left them */
    bool beside;      /* the drive renders a wall in addition to this current */
};

struct limits_settings {
    uint32_t rate; /* Hz */
    uint16_t largest, continuous, slew;
    uint32_t confirm_ms;
};

void limits_configure(struct limits *limits, const struct limits_settings *settings);

/* Count a tick that ended with this encoder count. */
void limits_pass(struct limits *limits, int32_t count);

/* Limit the wanted current, store the result as the active current, and return it (quanta). */
int16_t limits_apply(struct limits *limits, const struct thermal *thermal, int16_t wanted);

/* Return the wanted current (quanta), faded if the encoder has shown no motion for longer than `confirm`. */
int16_t limits_fade(struct limits *limits, int16_t wanted);

/* Set the current to zero at once, regardless of the slew limit. */
void limits_cut(struct limits *limits);

#endif
