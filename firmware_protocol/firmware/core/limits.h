/* How much of a wanted current may flow: a position that nothing confirms, current limit, thermal model, slew limit, in
 * this order. */
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
    uint32_t confirm; /* ticks under effort with the count on two neighbours, after which it fades; 0: never */
    uint32_t fade;    /* ticks that this takes */
    uint32_t unmoved; /* such ticks so far; beyond `confirm` since the effort began to fade, too */
    int32_t low;      /* the lower of those two counts */
    bool moved;       /* whether the last tick left them */
    bool beside;      /* something else is to give an effort beside this current */
};

struct limits_settings {
    uint32_t rate; /* Hz */
    uint16_t largest, continuous, slew;
    uint32_t confirm_ms;
};

void limits_configure(struct limits *limits, const struct limits_settings *settings);

/* A tick has passed, and ended with this count. */
void limits_pass(struct limits *limits, int32_t count);

/* Put into force what is allowed of a current, and return it. */
int16_t limits_apply(struct limits *limits, const struct thermal *thermal, int16_t wanted);

/* What is left of a wanted effort that nothing confirms. */
int16_t limits_confirmed(struct limits *limits, int16_t wanted);

/* Zero at once, regardless of the slew limit. */
void limits_cut(struct limits *limits);

#endif
