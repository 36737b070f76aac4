/* Compare the measured current with the set one, to detect a broken lead, a dead amplifier, a wrong sign or scale; and
 * follow the sensor's zero. */
#ifndef HR_CURRENT_H
#define HR_CURRENT_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "delay_line.h"

/* What every tick uses comes first: a Cortex-M0+ reaches the first 62 bytes of half-words and 124 of words in one
 * instruction. */
struct current_check {
    uint16_t ticks;           /* of a window */
    uint16_t passed, awaited; /* ticks of this window; until the active current of each delay is known */
    /* Settings: sum of a window that is noise; shares of the lag, of half of it and of twice it in a tick (1/65536);
     * quanta of back-EMF for a count in a tick (1/256). */
    uint32_t noise, decay, quick_decay, slow_decay, back_emf;
    /* Memory: of this window; the largest of the one before, where it still acts. */
    uint32_t difference, largest, sum, last_largest;
    /* Expected current, back-EMF apart, behind the lag; lowest current of all delays behind half the lag and behind twice
     * the lag, and the highest, which is followed only where there is a delay (1/16384 quantum). */
    int32_t expected, quick_low, slow_low, quick_high, slow_high;
    /* What the sensor shows without a current (1/256 quantum), and how much that may be. */
    int32_t zero, largest_zero;
    /* Settings with back-EMF: share of the speed's lag in a tick; of what a lag's input changes by in a tick, how much
     * comes late (1/65536). */
    uint32_t speed_decay, late;
    /* Memory with back-EMF: last count; speed, and behind the lag (1/16384 count a tick); residual, smoothed and not;
     * expected current, smoothed (1/16384 quantum); difference of the bounds from the expected current, smoothed. */
    int32_t count, speed, moved, left, before, smooth, quick_low_left, slow_low_left, quick_high_left, slow_high_left;
    int8_t encoder_sign;
    uint8_t known; /* counts: 0, 1 or more */
    struct delay_line line;
};

void current_configure(struct current_check *check, const struct board *board, uint32_t rate);

/* Begin a new window of the comparison, at the start of a session. */
void current_forget(struct current_check *check);

/* Return the measured current minus the sensor's zero (quanta). While the amplifier is `off`, the zero is adapted. */
int16_t current_subtract_zero(struct current_check *check, int16_t measured, bool off);

/* Compare set (`active`) and measured current (quanta) of one tick, at the end of which the encoder has `count`.
 * Returns true at the end of a window in which the two currents disagree. */
bool current_disagrees(struct current_check *check, int32_t count, int16_t active, int16_t measured);

#endif
