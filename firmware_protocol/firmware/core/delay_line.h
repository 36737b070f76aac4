/* The range of currents that may act now, if the delay of the set-point is known only to a factor of two. */
#ifndef HR_DELAY_LINE_H
#define HR_DELAY_LINE_H

#include <stdint.h>

#define DELAY_LINE_SLOTS 33
#define CURRENT_UNIT 16384 /* a quantum, in the units of the comparison */

struct delay_line {
    /* Settings: ticks that twice the delay lasts (0: no delay, nothing is put in); ticks of a slot; slots that half the
     * delay, the delay and twice the delay reach back. */
    uint16_t reach, stride, first, middle, last;
    uint16_t newest, filled; /* slot, and ticks in it */
    int16_t lowest[DELAY_LINE_SLOTS], highest[DELAY_LINE_SLOTS]; /* of each slot (quanta) */
};

/* Set the delay (ticks, not necessarily whole), and fill the line with currents of 0. */
void delay_line_configure(struct delay_line *line, double ticks);

/* Store the active current of a tick (quanta). */
void delay_line_put(struct delay_line *line, int16_t active);

/* Find the lowest and the highest current between half the delay and twice the delay. Returns the current one delay ago
 * (mean of the extremes of its slot). All in 1/CURRENT_UNIT quantum. */
int32_t delay_line_look(const struct delay_line *line, int32_t *lowest, int32_t *highest);

#endif
