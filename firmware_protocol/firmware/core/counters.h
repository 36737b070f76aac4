/* Counters of the link, modulo 2³². Each dropped frame increments one of them. */
#ifndef HR_COUNTERS_H
#define HR_COUNTERS_H

#include <stdint.h>

struct counters {
    uint32_t frames;
    uint32_t framing_errors;
    uint32_t crc_errors;
    uint32_t malformed;
    uint32_t unknown_type;
    uint32_t wrong_direction; /* not in STATISTICS: an echo */
    uint32_t foreign_major;
    uint32_t stale_session;
    uint32_t out_of_state;
    uint32_t lost;
    uint32_t duplicated;
    uint32_t reordered;
};

#endif
