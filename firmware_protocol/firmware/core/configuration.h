/* The active parameters, and the check of a parameter block before it becomes active. */
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

/* A candidate: the parameters that would be active after a block, before they are checked and activated. */
struct candidate {
    uint32_t values[HR_PARAMETERS];
    bool given[HR_PARAMETERS]; /* by the block */
    bool homes;                /* it sets reference_count */
    int32_t previous;          /* id of its last entry, -1 before the first */
    size_t index;              /* of that parameter */
};

/* Set the parameters with which the device starts: the table's defaults, limited to this board's ranges. */
void configuration_initial(const struct board *board, struct candidate *candidate);

/* Set the candidate to the active parameters with the values of a block, and check all of them. A block that contains a
 * parameter that is not live clears `verified`, unless the block sets it. */
struct refusal configuration_read(const struct configuration *configuration, const struct board *board,
                                  const uint8_t *block, size_t count, struct candidate *candidate);

/* Do the same as configuration_read in steps: begin, take each entry of the block, check all. An armed device accepts
 * only live parameters. */
void configuration_begin(const struct configuration *configuration, struct candidate *candidate);
struct refusal configuration_take(struct candidate *candidate, const uint8_t *entry);
struct refusal configuration_check(struct candidate *candidate, const struct board *board, bool armed);

/* Write the entry (id, value) of a parameter block for the parameter with an index. */
void configuration_entry(const uint32_t *values, size_t index, uint8_t *entry);

/* Activate one parameter of the candidate; the caller must update the CRC. */
void configuration_put(struct configuration *configuration, const struct candidate *candidate, size_t index);

void configuration_activate(struct configuration *configuration, const struct candidate *candidate);

/* Return the float whose bits a parameter contains. */
float value_as_float(uint32_t bits);

#endif
