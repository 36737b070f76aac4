/* A tick in float32. */
#ifndef LAW_FLOAT_LAW_H
#define LAW_FLOAT_LAW_H

#include <stdint.h>

#include "law.h"

void law_float_tick(law_state *s, const law_parameters *p, const law_input *in, law_output *out);

/* Depth inside the wall (counts). */
float law_float_depth(const law_parameters *p, int32_t travel);

#endif
