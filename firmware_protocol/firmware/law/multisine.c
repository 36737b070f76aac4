/* The excitation in integers: no table, no libm, no drift.
 *
 * Each line keeps harmonic * tick modulo the period, a whole number, so that after any number of periods it is where it
 * began. The cosine is a polynomial. */
#include "multisine.h"

#include "numbers.h"

enum { COSINE_BITS = 30 };

uint32_t law_line_phase(uint32_t seed, uint32_t line)
{
    uint32_t z = seed + UINT32_C(0x9E3779B9) * (line + 1);
    z = (z ^ z >> 16) * UINT32_C(0x85EBCA6B);
    z = (z ^ z >> 13) * UINT32_C(0xC2B2AE35);
    return z ^ z >> 16;
}

int32_t law_cosine(uint32_t phase)
{
    /* sin(pi/2 x) / x in powers of x^2, a Chebyshev fit over 0 ... 1, times 2^30 */
    static const int32_t c[] = {1686629706, -693598306, 85566403, -5018831, 162860};
    const uint32_t turned = phase + UINT32_C(0x40000000); /* cos x = sin(x + a quarter) */
    const int32_t within = (int32_t)(turned & UINT32_C(0x3FFFFFFF));
    const int32_t x = turned & UINT32_C(0x40000000) ? (1 << COSINE_BITS) - within : within;
    const int32_t square = (int32_t)(law_product(x, x) >> COSINE_BITS);
    int32_t sum = c[4], value, i;

    for (i = 3; i >= 0; i--)
        sum = c[i] + (int32_t)(law_product(sum, square) >> COSINE_BITS);
    value = (int32_t)(law_product(sum, x) >> COSINE_BITS);
    return turned & UINT32_C(0x80000000) ? -value : value;
}

void law_multisine_reset(law_multisine_state *s, const law_multisine *p)
{
    uint32_t j;
    s->inverse = p->lines > 0 ? (UINT64_C(1) << 56) / p->period : 0;
    s->played = 0;
    for (j = 0; j < p->lines; j++) {
        s->residue[j] = 0;
        s->phase[j] = law_line_phase(p->seed, j);
    }
}

int32_t law_multisine_run(law_multisine_state *s, const law_multisine *p, uint32_t elapsed)
{
    const uint32_t moved = s->played == 0 ? 0 : elapsed;
    int64_t sum = 0;
    uint32_t tick, j;

    s->played = s->played == 0 ? 1 : law_add(s->played, elapsed);
    tick = s->played - 1; /* asked only whether the ramp is over */
    for (j = 0; j < p->lines; j++) {
        uint32_t residue = s->residue[j], phase;
        if (moved == 1) {
            residue += p->harmonic[j];
            if (residue >= p->period)
                residue -= p->period;
        } else if (moved > 1) {
            residue = (uint32_t)((residue + (uint64_t)p->harmonic[j] * moved) % p->period);
        }
        s->residue[j] = residue;
        phase = (uint32_t)((residue * s->inverse) >> 24) + s->phase[j];
        sum += law_product(p->amplitude[j], law_cosine(phase));
    }
    sum >>= COSINE_BITS;
    if (tick < p->ramp) {
        const int32_t turn = law_cosine((uint32_t)(((uint64_t)tick << 31) / p->ramp));
        sum = (sum * (((1 << COSINE_BITS) - (int64_t)turn) >> 1)) >> COSINE_BITS;
    }
    return (int32_t)sum;
}
