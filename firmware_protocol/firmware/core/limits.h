/* How much of a wanted current may flow: current limit, thermal model, slew limit, in this order. */
#ifndef HR_LIMITS_H
#define HR_LIMITS_H

#include <stdint.h>

#include "thermal.h"

struct limits {
    int16_t current; /* active (quanta) */
    uint16_t flags;  /* enum hr_limit bits that acted since they were last cleared */
    int32_t largest;
    int32_t continuous;
    int32_t slew; /* quanta a tick */
};

void limits_configure(struct limits *limits, uint16_t largest, uint16_t continuous, uint16_t slew);

/* Put into force what is allowed of a current, and return it. */
int16_t limits_apply(struct limits *limits, const struct thermal *thermal, int16_t wanted);

/* Zero at once, regardless of the slew limit. */
void limits_cut(struct limits *limits);

#endif
