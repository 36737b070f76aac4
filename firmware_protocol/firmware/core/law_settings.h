/* From the parameters on the wire to those of the law. */
#ifndef HR_LAW_SETTINGS_H
#define HR_LAW_SETTINGS_H

#include <stdint.h>

#include "../law/law.h"
#include "board.h"
#include "configuration.h"
#include "hal.h"

/* Who computes the current: parameter `law`. */
enum law_choice {
    LAW_OF_HOST = 0,
    LAW_IN_INTEGERS = 1,
    LAW_IN_FLOAT = 2,
    LAW_ON_WHAT_IS_DRIVEN = 3, /* in float32, but for the wall, which what the board drives renders (hal.h) */
};

/* Read a law that the device is to run (parameter `law` is not LAW_OF_HOST), and check it: INCONSISTENT names a parameter that
 * the objection is about. */
struct refusal law_settings_read(const uint32_t *values, const struct board *board, const struct hal *hal,
                                 law_parameters *law);

/* Read another wall, what is live alone, into a law that has passed, and check that. */
struct refusal law_settings_read_wall(const uint32_t *values, const struct hal *hal, law_parameters *law);

#endif
