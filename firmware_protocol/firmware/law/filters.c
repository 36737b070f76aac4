/* The finite difference through a Butterworth low pass: in integers, and in float32. */
#include "estimators.h"
#include "numbers.h"

enum { QUICK_NOT = 0, QUICK_INPUTS = 1, QUICK_SHORT = 2 }; /* law_biquad_state.quick */

enum {
    MOST_COUNTS = 1 << 13,    /* in a period, of a quick step */
    MOST_STATE_BITS = 17,     /* so that those counts fit 32 bits in the filter's format */
    MOST_NUMERATOR = 1 << 16, /* b0, b1 and b2: the sum of their products with those counts fits 32 bits */
    SHORT = 1 << 15,          /* a1 and a2: their products with half an output fit 32 bits */
    WHOLE = 2                 /* law_biquad_state.whole: both inputs are counts */
};

/* The general case: five products of 32 by 32 bits. */
static void biquad_step(law_biquad_state *s, const law_biquad *p, int32_t x)
{
    const int64_t total = law_product(p->b0, x) + law_product(p->b1, s->x1) + law_product(p->b2, s->x2)
                          - law_product(p->a1, s->y1) - law_product(p->a2, s->y2);
    s->x2 = s->x1;
    s->x1 = x;
    s->y2 = s->y1;
    s->y1 = law_saturate(law_shift_right(total, p->coefficient_bits, p->rounding), p->word_bits);
}

/* The same for inputs that are a few whole counts, as they nearly always are. The sum of their products fits 32 bits
 * before it is scaled; and short coefficients, of 14 fractional bits or less, are multiplied by halves of the outputs. */
static void biquad_step_of_counts(law_biquad_state *s, const law_biquad *p, int32_t moved)
{
    const int32_t y1 = s->y1, y2 = s->y2, bits = p->coefficient_bits;
    const int32_t inputs = p->b0 * moved + p->b1 * s->x1 + p->b2 * s->x2;
    int64_t total = law_shift_left(inputs, p->state_bits);

    if (s->quick == QUICK_SHORT) {
        const int32_t high = p->a1 * (y1 >> 16) + p->a2 * (y2 >> 16);
        const int32_t low = p->a1 * (y1 & 0xFFFF) + p->a2 * (y2 & 0xFFFF);
        total -= high * (INT64_C(1) << 16);
        total -= low;
    } else {
        total -= law_product(p->a1, y1);
        total -= law_product(p->a2, y2);
    }
    if (p->rounding == LAW_NEAREST)
        total += (int32_t)1 << (bits - 1);
    s->x2 = s->x1;
    s->x1 = moved;
    s->y2 = y1;
    s->y1 = law_to_32(law_shift(total, bits));
}

static int32_t size(int32_t value)
{
    return value < 0 ? -value : value;
}

static int within(int32_t value, int32_t limit)
{
    return value >= -limit && value <= limit;
}

/* Which of the quick steps is exact for these numbers. */
static int32_t quick(const law_biquad *p)
{
    if (p->word_bits != 32 || p->state_bits < 1 || p->state_bits > MOST_STATE_BITS || p->coefficient_bits < 1
        || p->rounding == LAW_ZERO || !within(p->b0, MOST_NUMERATOR) || !within(p->b1, MOST_NUMERATOR) || !within(p->b2, MOST_NUMERATOR))
        return QUICK_NOT;
    if (!within(p->a1, SHORT) || !within(p->a2, SHORT))
        return QUICK_INPUTS;
    /* opposite signs keep the sum of two products in 32 bits, as in any low pass below a quarter of the rate */
    return (p->a1 <= 0 && p->a2 >= 0) || size(p->a1) + size(p->a2) <= SHORT ? QUICK_SHORT : QUICK_INPUTS;
}

void law_biquad_reset(law_biquad_state *s, const law_biquad *p)
{
    *s = (law_biquad_state){0};
    s->quick = quick(p);
    s->whole = s->quick == QUICK_NOT ? 0 : WHOLE;
}

/* From here on the inputs before this one are kept as the general case has them. */
static void leave_counts(law_biquad_state *s, const law_biquad *p)
{
    if (s->whole == WHOLE) {
        s->x1 *= (int32_t)1 << p->state_bits;
        s->x2 *= (int32_t)1 << p->state_bits;
    }
    s->whole = 0;
}

/* The general case for a period whose input would do for the quick one; both inputs kept are such, from now on. */
static void approach_counts(law_biquad_state *s, const law_biquad *p, int32_t moved)
{
    biquad_step(s, p, moved * ((int32_t)1 << p->state_bits));
    if (++s->whole == WHOLE) {
        s->x1 >>= p->state_bits;
        s->x2 >>= p->state_bits;
    }
}

int32_t law_biquad_run(law_biquad_state *s, const law_biquad *p, int32_t moved, uint32_t elapsed)
{
    if (elapsed == 1 && s->quick != QUICK_NOT && within(moved, MOST_COUNTS)) {
        if (s->whole == WHOLE)
            biquad_step_of_counts(s, p, moved);
        else
            approach_counts(s, p, moved);
    } else {
        const int64_t wide = law_product(moved, (int32_t)1 << p->state_bits);
        const int32_t x = law_saturate(elapsed > 1 ? law_divide(wide, elapsed, p->rounding) : wide, p->word_bits);
        uint32_t runs = elapsed < LAW_LONGEST_GAP ? elapsed : LAW_LONGEST_GAP;
        leave_counts(s, p);
        while (runs-- > 0)
            biquad_step(s, p, x);
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
