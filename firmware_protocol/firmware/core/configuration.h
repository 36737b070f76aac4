/* The parameters in force, and how a block becomes a set of them. */
#ifndef HR_CONFIGURATION_H
#define HR_CONFIGURATION_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "board.h"
#include "protocol.h"

#define HR_FULL_BLOCK_BYTES (HR_PARAMETERS * HR_PARAMETER_BYTES)

struct configuration {
    uint32_t values[HR_PARAMETERS]; /* as on the wire */
    uint32_t crc;                   /* of the block */
    bool homed;                     /* reference_count was set since the start */
    uint8_t block[HR_FULL_BLOCK_BYTES];
};

struct refusal {
    enum hr_status status; /* OK: not refused */
    uint16_t detail;       /* id of a parameter, or 0 */
};

/* A set under way: what a block would make of the parameters in force. */
struct candidate {
    uint32_t values[HR_PARAMETERS];
    bool homes; /* the block sets reference_count */
};

/* What the device starts with: the table's values, inside this board's ranges. */
void configuration_initial(const struct board *board, struct candidate *candidate);

/* Read a block on top of the parameters in force and check it, all of it. An armed device takes live parameters alone;
 * any other block that does not repeat `verified` clears it. */
struct refusal configuration_read(const struct configuration *configuration, const struct board *board, bool armed,
                                  const uint8_t *block, size_t count, struct candidate *candidate);

void configuration_put_in_force(struct configuration *configuration, const struct candidate *candidate);

/* A float as the parameters hold it. */
float value_as_float(uint32_t bits);

#endif
