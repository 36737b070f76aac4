/* Run a golden vector (golden.py has the format) with the law that this is linked with. */
#ifndef GOLDEN_H
#define GOLDEN_H

#include <stddef.h>
#include <stdint.h>

#include "law.h"

typedef enum {
    GOLDEN_MET = 0,
    GOLDEN_BAD_FILE,   /* another format, or parameters of another size */
    GOLDEN_REFUSED,    /* law_check refuses the parameters */
    GOLDEN_DIFFERENT,  /* at least one tick is not what it must be */
    GOLDEN_OTHER_BITS  /* all are, but not the bits of the build that made the file */
} golden_verdict;

typedef struct {
    uint32_t verdict; /* golden_verdict */
    uint32_t ticks;   /* that ran */
    uint32_t wrong;   /* of them */
    uint32_t first;   /* wrong tick, if any */
    int32_t worst;    /* difference of currents (quanta) */
    uint32_t crc;
} golden_result;

/* `file` is aligned for law_parameters; `s` is memory for the law. */
golden_result golden_run(law_state *s, const uint8_t *file, size_t bytes);

#endif
