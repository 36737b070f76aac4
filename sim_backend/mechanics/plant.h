/* The plant of plant.py in C: the same operations in the same order, so that the states are equal to the last bit. A motor
 * that cogs is missing. Compile with -ffp-contract=off. */
#ifndef HR_PLANT_H
#define HR_PLANT_H

#include <stdint.h>

enum { /* of the parameters: inner.py */
    STEP_S, STEPS, EFFORT_LIMIT, GRAVITY_EFFORT, COULOMB, COULOMB_LINK, RESOLUTION, OFFSET, SIGN, MEAN, RIPPLE,
    PLANT_PARAMETERS
};

enum { RIGID_ORDER = 3, TWO_MASS_ORDER = 5, HAND_ORDER = 5, INTENTIONS = 3 };

struct plant {
    int order;           /* states: rigid or two masses, and HAND_ORDER more in a hand; then the age of the last edge */
    int delay_ticks;     /* states behind the age: commands that do not act yet, oldest first */
    const double *phi;   /* order x order, row by row */
    const double *gamma; /* a row for each state: command, external effort, friction of each mass */
    const double *parameters;
    double *state;
};

/* Move the plant by one tick; return the encoder count at its end. Efforts in N m or N, finite; `command` acts after the
 * delay, `external` acts on the link. */
int64_t plant_advance(const struct plant *plant, double command, double external);

/* Return the encoder count at the present position. */
int64_t plant_count(const struct plant *plant);

#endif
