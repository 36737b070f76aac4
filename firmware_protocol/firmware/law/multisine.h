/* The excitation of one tick; see law_multisine. */
#ifndef LAW_MULTISINE_H
#define LAW_MULTISINE_H

#include "law.h"

void law_multisine_reset(law_multisine_state *s, const law_multisine *p);

/* Effort along the position in quanta * 2^LAW_LINE_BITS, for the ticks since the previous call. */
int32_t law_multisine_run(law_multisine_state *s, const law_multisine *p, uint32_t elapsed);

#endif
