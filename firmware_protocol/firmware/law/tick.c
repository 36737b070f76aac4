/* A tick in either arithmetic. */
#include "law.h"

#include "estimators.h"
#include "excitation.h"
#include "fixed_law.h"
#include "float_law.h"
#include "phases.h"

void law_reset(law_state *s, const law_parameters *p, const int16_t *table)
{
    *s = (law_state){0};
    s->since = p->velocity_divider - 1; /* the first sample begins a period */
    if (p->estimator == LAW_FDM_BUTTERWORTH_FIXED)
        law_biquad_reset(&s->of.biquad, &p->biquad);
    law_excitation_reset(&s->excitation, &p->excitation, table);
}

int law_inside(const law_parameters *p, int32_t count)
{
    const int32_t travel = law_travel(p, count);
    return p->arithmetic == LAW_FIXED ? law_fixed_depth(p, travel) > 0 : law_float_depth(p, travel) > 0.0f;
}

int law_is_free(const law_parameters *p, int32_t count)
{
    return !p->bilateral && !law_inside(p, count);
}

law_output law_tick(law_state *s, const law_parameters *p, const law_input *in)
{
    law_output out;

    if (p->arithmetic == LAW_FIXED)
        law_fixed_tick(s, p, in, &out);
    else
        law_float_tick(s, p, in, &out);
    return out;
}
