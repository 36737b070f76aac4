/* The active parameters, and how a block becomes a set of them. */
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

/* A set under way: what a block would make of the active parameters. */
struct candidate {
    uint32_t values[HR_PARAMETERS];
    bool given[HR_PARAMETERS]; /* by the block */
    bool homes;                /* it sets reference_count */
    int32_t previous;          /* id of its last entry, -1 before the first */
    size_t index;              /* of that parameter */
};

/* What the device starts with: the table's values, inside this board's ranges. */
void configuration_initial(const struct board *board, struct candidate *candidate);

/* Read a block on top of the active parameters and check it, all of it. A block with other parameters than live ones
 * that does not repeat `verified` clears it. */
struct refusal configuration_read(const struct configuration *configuration, const struct board *board,
                                  const uint8_t *block, size_t count, struct candidate *candidate);

/* The same piece by piece: begin, take each entry, check all. An armed device takes live parameters alone. */
void configuration_begin(const struct configuration *configuration, struct candidate *candidate);
struct refusal configuration_take(struct candidate *candidate, const uint8_t *entry);
struct refusal configuration_check(struct candidate *candidate, const struct board *board, bool armed);

/* Write the entry of a parameter, by its index. */
void configuration_entry(const uint32_t *values, size_t index, uint8_t *entry);

/* Activate one parameter; the CRC is left to the caller. */
void configuration_put(struct configuration *configuration, const struct candidate *candidate, size_t index);

void configuration_activate(struct configuration *configuration, const struct candidate *candidate);

/* A float as the parameters hold it. */
float value_as_float(uint32_t bits);

#endif
