/* Whether the measured current is the one that was set: a lead that came off, a dead amplifier, a wrong sign or scale.
 * And the sensor's zero. */
#ifndef HR_CURRENT_H
#define HR_CURRENT_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"

struct current_check {
    /* Settings: shares of a lag in a tick (1/65536), quanta of back-EMF for a count in a tick (1/256), which way it
     * acts; ticks of a window, and the sum in it that is noise; of what a lag's input changes by in a tick, how much
     * comes late (1/65536); shares of half the lag and of twice the lag. */
    uint32_t decay, speed_decay, back_emf, late, quick_decay, slow_decay;
    int8_t encoder_sign;
    uint16_t ticks;
    uint32_t noise;
    /* Memory: expected current, back-EMF apart, behind the lag, half of it and twice of it (1/16384 quantum); last
     * count, how many are known (0, 1 or more). */
    int32_t expected, quick, slow, count;
    uint8_t known;
    /* With back-EMF: speed, and behind the lag (1/16384 count a tick); what is left, smoothed and not; expected current,
     * smoothed (1/16384 quantum); what half the lag and twice the lag differ by from the lag, smoothed. */
    int32_t speed, moved, left, before, smooth, quick_left, slow_left;
    /* Of this window; the largest of the one before, where it still acts. */
    uint16_t passed;
    uint32_t difference, largest, sum, last_largest;
    /* What the sensor shows without a current (1/256 quantum), and how much that may be. */
    int32_t zero, largest_zero;
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
