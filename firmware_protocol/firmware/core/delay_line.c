#include "delay_line.h"

#include <math.h>
#include <stdbool.h>

void delay_line_configure(struct delay_line *line, double ticks)
{
    const uint32_t reach = (uint32_t)ceil(2.0 * ticks - 1e-9), slots = DELAY_LINE_SLOTS - 1u;
    const uint32_t needed = (reach + slots - 1u) / slots, stride = needed > 1u ? needed : 1u;
    line->reach = (uint16_t)reach;
    line->stride = (uint16_t)stride;
    line->first = (uint16_t)((uint32_t)floor(0.5 * ticks + 1e-9) / stride);
    line->middle = (uint16_t)((uint32_t)ceil(ticks - 1e-9) / stride);
    line->last = (uint16_t)((reach + stride - 1u) / stride);
    line->newest = 0;
    line->filled = (uint16_t)stride;
    for (uint32_t slot = 0; slot < DELAY_LINE_SLOTS; slot++)
        line->lowest[slot] = line->highest[slot] = 0;
}

void delay_line_put(struct delay_line *line, int16_t active)
{
    if (line->filled >= line->stride) {
        line->filled = 0;
        line->newest = line->newest + 1u < DELAY_LINE_SLOTS ? (uint16_t)(line->newest + 1u) : 0;
    }
    int16_t *lowest = &line->lowest[line->newest], *highest = &line->highest[line->newest];
    const bool begins = line->filled++ == 0;
    if (begins || active < *lowest)
        *lowest = active;
    if (begins || active > *highest)
        *highest = active;
}

/* Return the index of the slot `back` slots before the newest. */
static uint32_t slot_behind(const struct delay_line *line, uint32_t back)
{
    return line->newest >= back ? line->newest - back : line->newest + DELAY_LINE_SLOTS - back;
}

int32_t delay_line_look(const struct delay_line *line, int32_t *lowest, int32_t *highest)
{
    uint32_t at = slot_behind(line, line->first);
    int32_t low = line->lowest[at], high = line->highest[at];
    for (uint32_t left = line->last - line->first; left > 0; left--) {
        at = at > 0 ? at - 1u : DELAY_LINE_SLOTS - 1u;
        low = line->lowest[at] < low ? line->lowest[at] : low;
        high = line->highest[at] > high ? line->highest[at] : high;
    }
    *lowest = low * CURRENT_UNIT;
    *highest = high * CURRENT_UNIT;
    const uint32_t middle = slot_behind(line, line->middle);
    return (line->lowest[middle] + line->highest[middle]) * (CURRENT_UNIT / 2);
}
