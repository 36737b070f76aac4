/* The functions and the memory of the module that a page calls. */
#ifndef RIG_H
#define RIG_H

#include <stdint.h>

enum { /* of a row */
    RIG_COUNT, RIG_ACTIVE, RIG_CURRENT, RIG_MEASURED, RIG_PHASE, RIG_FLAGS, RIG_LIMITS, RIG_VELOCITY, RIG_POSITION_TRUE,
    RIG_VELOCITY_TRUE, RIG_EFFORT_TRUE, RIG_HANDLE, RIG_HANDLE_VELOCITY, RIG_HAND, RIG_COLUMNS
};
enum { RIG_ROWS = 1 << 17, RIG_SCRIPT_ROWS = 1 << 12 };

extern double rig_setup[], rig_script[], rig_rows[];
extern uint8_t rig_block[];

/* Set up the rig from `rig_setup`, and the device from a parameter block of so many bytes in `rig_block`, as a host sends
 * it; arm, and start the law. Returns 0, or status and parameter of the device's refusal. */
int rig_begin(int bytes);

/* Run so many ticks and write a row for each, from row 0; returns the number of rows. A run ends with phase DONE or a
 * fault. `rig_script` has a row of intended position, velocity and press for each tick; the last one stays. */
int rig_run(int ticks, int script_rows);

/* Change the wall with a parameter block; it acts when the handle is outside of both walls, until then rig_waits. */
int rig_change(int bytes);
int rig_waits(void);

/* Return the size of `rig_rows`. */
int rig_most_rows(void);

/* Return the latched fault (enum hr_fault). */
int rig_fault(void);

enum { /* of rig_numbers: the fields of rig.control._measure.NUMBERS that decide the verdict of a page's hit */
    FELT, HEARD, MOVED, GROWTH, EXITS_IN_TAIL, CONTACT_S, SATURATED_FRACTION_IN_TAIL, TICKS, SLEW_BOUND_TICKS,
    OVERRULED_TICKS, INSIDE_TICKS_IN_TAIL, TOGGLES, TAIL_BEGINS_S, SETTLING_IN_TAIL_S, RIG_NUMBERS
};
enum { RIG_SATURATED = 1, RIG_SLEW_BOUND = 2, RIG_OVERRULED = 4 }; /* marks of a tick, a bit each in turn */

/* Measure a trial from four rows of RIG_ROWS signals: position, effort, penetration, marks. `rig_meter` has the settings and
 * the filters of rig.control._measure. */
extern double rig_signals[], rig_meter[], rig_numbers[];
void rig_measure(int ticks);

#endif
