/* The finite difference through a Butterworth low pass: in integers, and in float32. */
#include "estimators.h"
#include "numbers.h"

static void biquad_step(law_biquad_state *s, const law_biquad *p, int32_t x)
{
    const int64_t total = law_product(p->b0, x) + law_product(p->b1, s->x1) + law_product(p->b2, s->x2)
                          - law_product(p->a1, s->y1) - law_product(p->a2, s->y2);
    s->x2 = s->x1;
    s->x1 = x;
    s->y2 = s->y1;
    s->y1 = law_saturate(law_shift_right(total, p->coefficient_bits, p->rounding), p->word_bits);
}

int32_t law_biquad_run(law_biquad_state *s, const law_biquad *p, int32_t moved, uint32_t elapsed)
{
    int64_t wide = law_product(moved, (int32_t)1 << p->state_bits);

    if (elapsed == 1) { /* nearly always: by itself, so that no loop costs registers */
        biquad_step(s, p, law_saturate(wide, p->word_bits));
    } else {
        uint32_t runs = elapsed < LAW_LONGEST_GAP ? elapsed : LAW_LONGEST_GAP;
        wide = law_divide(wide, elapsed, p->rounding);
        while (runs-- > 0)
            biquad_step(s, p, law_saturate(wide, p->word_bits));
    }
    return s->y1;
}

float law_low_pass_run(law_low_pass_state *s, const law_low_pass *p, float slope, uint32_t elapsed)
{
    uint32_t runs = elapsed < LAW_LONGEST_GAP ? elapsed : LAW_LONGEST_GAP;
    float out = slope;

    while (runs-- > 0) {
        int32_t i;
        out = slope;
        for (i = 0; i < p->sections; i++) {
            const law_section *c = &p->section[i];
            const float off = out - s->outer[i];
            if (c->order == 1) {
                const float half = c->low * off;
                out = s->outer[i] + half;
                s->outer[i] = out + half;
            } else {
                const float speed = c->inner * s->inner[i] + c->band * off;
                const float half = c->band * s->inner[i] + c->low * off;
                out = s->outer[i] + half;
                s->inner[i] = 2.0f * speed - s->inner[i];
                s->outer[i] = out + half;
            }
        }
    }
    return out;
}
