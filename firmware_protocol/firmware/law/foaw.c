/* First-order adaptive windowing: the slope of the longest line that the last samples allow.
 *
 * Whether a line passes is decided in integers: with whole counts a sample is often exactly on the edge of the band, and
 * the rounding of float32 would decide it differently each time. The slope itself is one division. */
#include "estimators.h"
#include "numbers.h"

enum {
    BAND_BITS = 8,
    MOST_RISE = 1 << 20 /* counts in a window: products of longer ones would leave 64 bits */
};

/* Store a sample and return the number of other stored samples. */
static int32_t remember(law_foaw_state *s, int32_t count, uint32_t elapsed)
{
    const uint32_t others = s->samples;
    if (others > 0) {
        s->newest = (s->newest + 1) % LAW_RING;
        s->period += elapsed;
    }
    s->count[s->newest] = count;
    s->taken[s->newest] = s->period;
    s->samples = others < LAW_RING ? others + 1 : others;
    return (int32_t)(others < LAW_RING ? others : LAW_RING - 1);
}

/* Return the counts, and set `*span` to the periods, from the n-th sample before the newest to the newest. */
static int32_t rise_from(const law_foaw_state *s, int32_t n, uint32_t *span)
{
    const uint32_t slot = (s->newest - (uint32_t)n) % LAW_RING;
    *span = s->period - s->taken[slot];
    return law_count_difference(s->count[s->newest], s->count[slot]);
}

static int32_t least(int32_t a, int32_t b)
{
    return a < b ? a : b;
}

/* The cone of slopes that pass all samples so far, as two fractions: rise over span, rises in counts * 2^8. */
float law_foaw_end(law_foaw_state *s, const law_foaw *p, int32_t count, uint32_t elapsed, uint32_t *window)
{
    const int32_t longest = least(remember(s, count, elapsed), p->limit);
    int64_t lowest = 0, highest = 0; /* of a cone that is open while its spans are 0 */
    int64_t lowest_span = 0, highest_span = 0;
    int32_t chosen_rise = 0, n;
    uint32_t chosen_span = 0;

    for (n = 1; n <= longest; n++) {
        uint32_t span;
        int32_t rise = rise_from(s, n, &span);
        int64_t wide;
        int passes;
        if (n > 1 && span > (uint32_t)p->limit)
            break;
        if (n == 1) { /* two samples are always on a line */
            chosen_rise = rise;
            chosen_span = span;
        }
        rise = (int32_t)law_at_most(rise, MOST_RISE);
        wide = (int64_t)rise * (1 << BAND_BITS);
        passes = n == 1 || (lowest * span <= wide * lowest_span && wide * highest_span <= highest * span);
        if (passes && n > 1) {
            chosen_rise = rise;
            chosen_span = span;
        }
        if (!passes && (p->stop_first || lowest * highest_span > highest * lowest_span))
            break;
        if (n == 1 || (wide - p->band) * lowest_span > lowest * span) {
            lowest = wide - p->band;
            lowest_span = span;
        }
        if (n == 1 || (wide + p->band) * highest_span < highest * span) {
            highest = wide + p->band;
            highest_span = span;
        }
    }
    *window = chosen_span;
    return chosen_span == 0 ? 0.0f : (float)chosen_rise / (float)chosen_span;
}

/* Least squares over n + 1 samples: slope = top / bottom, both whole. Times bottom * points, so is the line's distance
 * from a sample: across * rise - along * span - at_newest. */
float law_foaw_best(law_foaw_state *s, const law_foaw *p, int32_t count, uint32_t elapsed, uint32_t *window)
{
    const int32_t longest = least(remember(s, count, elapsed), p->limit);
    int64_t sum_rise = 0, sum_span = 0, sum_product = 0, sum_square = 0, chosen_top = 0, chosen_bottom = 0;
    uint32_t chosen_span = 0;
    int32_t n;

    s->rise[0] = 0;
    s->span[0] = 0;
    for (n = 1; n <= longest; n++) {
        const int64_t points = n + 1;
        int64_t top, bottom, across, along, at_newest, band;
        uint32_t span;
        int32_t rise = rise_from(s, n, &span), i, outside = 0;
        if (n == 1) {
            chosen_top = rise;
            chosen_bottom = span;
            chosen_span = span;
            if (span > (uint32_t)p->limit)
                break; /* so is every later one */
        } else if (span > (uint32_t)p->limit) {
            break;
        }
        rise = (int32_t)law_at_most(rise, MOST_RISE);
        s->rise[n] = rise;
        s->span[n] = (int32_t)span;
        sum_rise += rise;
        sum_span += span;
        sum_product += (int64_t)rise * span;
        sum_square += (int64_t)span * span;
        if (n == 1)
            continue;
        top = points * sum_product - sum_span * sum_rise;
        bottom = points * sum_square - sum_span * sum_span;
        across = bottom * points;
        along = top * points;
        at_newest = p->least_squares ? bottom * sum_rise - top * sum_span : 0;
        band = p->band * across;
        for (i = 0; i <= n && outside == 0; i++) {
            const int64_t off = across * s->rise[i] - along * s->span[i] - at_newest;
            outside = (off < 0 ? -off : off) * (1 << BAND_BITS) > band;
        }
        if (!outside) {
            chosen_top = top;
            chosen_bottom = bottom;
            chosen_span = span;
        } else if (p->stop_first) {
            break;
        }
    }
    *window = chosen_span;
    return chosen_bottom == 0 ? 0.0f : (float)chosen_top / (float)chosen_bottom;
}
