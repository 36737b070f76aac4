/* Whether the measured current is the one that was set: a lead that came off, a dead amplifier, a wrong sign or scale.
 * And the sensor's zero. */
#ifndef HR_CURRENT_H
#define HR_CURRENT_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"

#define CURRENT_SLOTS 33

struct current_check {
    /* Settings: shares of a lag in a tick (1/65536), quanta of back-EMF for a count in a tick (1/256), which way it
     * acts; ticks of a window, and the sum in it that is noise; of what a lag's input changes by in a tick, how much
     * comes late (1/65536); shares of half the lag and of twice the lag. Of the delay line: ticks of a slot, slots that
     * half the delay, the delay and twice the delay reach back, ticks that twice the delay lasts. */
    uint32_t decay, speed_decay, back_emf, late, quick_decay, slow_decay;
    int8_t encoder_sign;
    uint16_t ticks;
    uint32_t noise;
    uint16_t stride, first, middle, last, delayed;
    /* Memory: expected current, back-EMF apart, behind the lag; lowest and highest current of all delays behind half the
     * lag and behind twice the lag (1/16384 quantum); last count, how many are known (0, 1 or more); newest slot of the
     * delay line, ticks in it, ticks until the active current of each delay is known. */
    int32_t expected, quick_low, quick_high, slow_low, slow_high, count;
    uint8_t known;
    uint16_t newest, filled, awaited;
    /* With back-EMF: speed, and behind the lag (1/16384 count a tick); what is left, smoothed and not; expected current,
     * smoothed (1/16384 quantum); what the four bounds differ by from the expected current, smoothed. */
    int32_t speed, moved, left, before, smooth, quick_low_left, quick_high_left, slow_low_left, slow_high_left;
    /* Of this window; the largest of the one before, where it still acts. */
    uint16_t passed;
    uint32_t difference, largest, sum, last_largest;
    /* What the sensor shows without a current (1/256 quantum), and how much that may be. */
    int32_t zero, largest_zero;
    /* Delay line: lowest and highest active current of each slot (quanta). */
    int16_t lowest[CURRENT_SLOTS], highest[CURRENT_SLOTS];
};

void current_configure(struct current_check *check, const struct board *board, uint32_t rate);

/* Begin a window: another session. */
void current_forget(struct current_check *check);

/* Take the zero off a measured current (quanta); while the amplifier is off, the zero follows it. */
int16_t current_zeroed(struct current_check *check, int16_t measured, bool off);

/* Take one tick: the count at its end, the current that was set, the one that was measured at the end (quanta). True at
 * the end of a window in which the two disagree. */
bool current_disagrees(struct current_check *check, int32_t count, int16_t active, int16_t measured);

#endif
