/* A tick in integers. */
#ifndef LAW_FIXED_LAW_H
#define LAW_FIXED_LAW_H

#include <stdint.h>

#include "law.h"

void law_fixed_tick(law_state *s, const law_parameters *p, const law_input *in, law_output *out);

/* Depth inside the wall (counts * 2^LAW_DEPTH_BITS). */
int32_t law_fixed_depth(const law_parameters *p, int32_t travel);

#endif
