/* Faults of the motion: over-speed, position window, runaway, over-current. */
#ifndef HR_MONITOR_H
#define HR_MONITOR_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"

/* Speed is counted over 5 ms. Shorter, and one count is a large speed; longer, and a runaway has gone far. */
#define HR_SPEED_WINDOWS_A_SECOND 200u
#define HR_WINDOW_TICKS_MAXIMUM 250u /* at 50 kHz */

struct monitor {
    uint16_t flags; /* enum hr_limit bits since they were last cleared */
    int8_t encoder_sign;
    int8_t pushed; /* direction of the last large effort */
    int16_t over_current;
    uint8_t peaks; /* of the last two ticks: was the measured current above it? */
    int32_t large; /* five times an effort above which motion is watched (quanta) */
    uint32_t driven, still; /* ticks of large effort: along the motion, and on two neighbouring counts */
    uint32_t stall_ticks;
    uint32_t fastest, near_fastest; /* counts in the window */
    int32_t first, last;            /* the position window */
    int32_t near_first, near_last;  /* between these nothing is near its ends; crossed over when it is narrow */
    uint16_t ticks, slot; /* of the speed window */
    int32_t counts[HR_WINDOW_TICKS_MAXIMUM];
};

struct monitor_settings {
    uint32_t rate; /* Hz */
    uint32_t speed_limit;
    int32_t window_minimum, window_maximum;
    uint16_t current_limit;
    bool hold_to_run;
};

/* Set the monitor's limits, and begin the speed check at `count`. */
void monitor_configure(struct monitor *monitor, const struct board *board, const struct monitor_settings *settings,
                       int32_t count);

/* Restart the runaway check, at the start of a session. */
void monitor_forget(struct monitor *monitor);

bool monitor_in_window(const struct monitor *monitor, int32_t count);

/* Check one tick: count at its end, true if it stayed on two neighbouring counts, active and measured current (quanta).
 * Returns the detected faults as bits 1 << code. */
uint32_t monitor_check(struct monitor *monitor, int32_t count, bool stood, int16_t current, int16_t measured);

#endif
