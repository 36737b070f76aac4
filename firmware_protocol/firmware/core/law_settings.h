/* Convert the parameters of the protocol to those of the law. */
#ifndef HR_LAW_SETTINGS_H
#define HR_LAW_SETTINGS_H

#include <stdint.h>

#include "../law/law.h"
#include "board.h"
#include "configuration.h"
#include "hal.h"

/* Where the current is computed: parameter `law`. */
enum law_choice {
    LAW_OF_HOST = 0,
    LAW_IN_INTEGERS = 1,
    LAW_IN_FLOAT = 2,
    LAW_ON_WHAT_IS_DRIVEN = 3, /* in float32; the drive behind the board renders the wall (hal.h) */
};

/* Convert and check the law of the parameters, whose value of `law` is not LAW_OF_HOST. The detail of INCONSISTENT is
 * the id of the rejected parameter. */
struct refusal law_settings_read(const uint32_t *values, const struct board *board, const struct hal *hal,
                                 law_parameters *law);

/* Copy the live parameters of a wall into a checked law, and check the result. */
struct refusal law_settings_read_wall(const uint32_t *values, const struct hal *hal, law_parameters *law);

#endif
