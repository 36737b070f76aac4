/* Velocity from counts: each takes the counts moved and the periods elapsed since its last run (at least 1).
 *
 * All but the fixed one answer counts per velocity period in float32. The first sample has no predecessor; it is
 * tick.c that answers zero for it, except for FOAW and the filters, which have to see it. */
#ifndef LAW_ESTIMATORS_H
#define LAW_ESTIMATORS_H

#include <stdint.h>

#include "law.h"

enum { LAW_LONGEST_GAP = 1000 }; /* velocity periods, after which earlier samples are ignored */

void law_biquad_reset(law_biquad_state *s, const law_biquad *p);
int32_t law_biquad_run(law_biquad_state *s, const law_biquad *p, int32_t moved, uint32_t elapsed);
float law_low_pass_run(law_low_pass_state *s, const law_low_pass *p, float slope, uint32_t elapsed);
float law_foaw_end(law_foaw_state *s, const law_foaw *p, int32_t count, uint32_t elapsed, uint32_t *window);
float law_foaw_best(law_foaw_state *s, const law_foaw *p, int32_t count, uint32_t elapsed, uint32_t *window);
float law_levant_run(law_levant_state *s, const law_levant *p, float slope, uint32_t elapsed);
float law_kalman_run(law_kalman_state *s, const law_kalman *p, float moved, float slope,
                     float effort_acceleration, uint32_t elapsed);
float law_two_mass_run(law_two_mass_state *s, const law_two_mass *p, float moved, float slope,
                       float effort_acceleration, uint32_t elapsed);

#endif
