#include "excitation.h"

#include "numbers.h"

/* 2^24 sin(pi/2 i/256), to the nearest; the last once more, because the line behind it is asked for. */
static const int32_t sine[258] = {
    0, 102943, 205882, 308814, 411733, 514638, 617523, 720384, 823219, 926023, 1028791, 1131521, 1234209, 1336849,
    1439440, 1541976, 1644455, 1746871, 1849222, 1951503, 2053710, 2155841, 2257890, 2359854, 2461729, 2563511,
    2665197, 2766783, 2868265, 2969638, 3070900, 3172046, 3273072, 3373976, 3474752, 3575398, 3675909, 3776281,
    3876512, 3976596, 4076531, 4176312, 4275936, 4375399, 4474698, 4573827, 4672785, 4771567, 4870169, 4968587,
    5066819, 5164860, 5262706, 5360355, 5457801, 5555042, 5652074, 5748893, 5845495, 5941878, 6038037, 6133968,
    6229669, 6325135, 6420363, 6515349, 6610090, 6704582, 6798821, 6892805, 6986529, 7079990, 7173184, 7266109,
    7358759, 7451133, 7543226, 7635036, 7726557, 7817788, 7908725, 7999364, 8089701, 8179734, 8269459, 8358873,
    8447972, 8536753, 8625213, 8713348, 8801154, 8888630, 8975771, 9062573, 9149035, 9235152, 9320922, 9406340,
    9491405, 9576112, 9660458, 9744441, 9828057, 9911303, 9994176, 10076672, 10158790, 10240524, 10321873, 10402834,
    10483403, 10563577, 10643353, 10722729, 10801701, 10880266, 10958422, 11036165, 11113493, 11190402, 11266890,
    11342953, 11418590, 11493797, 11568571, 11642909, 11716809, 11790268, 11863283, 11935852, 12007971, 12079638,
    12150850, 12221604, 12291899, 12361731, 12431097, 12499995, 12568423, 12636378, 12703856, 12770857, 12837376,
    12903413, 12968963, 13034026, 13098597, 13162675, 13226258, 13289343, 13351928, 13414009, 13475586, 13536656,
    13597215, 13657263, 13716797, 13775814, 13834313, 13892291, 13949745, 14006675, 14063077, 14118950, 14174291,
    14229098, 14283370, 14337104, 14390298, 14442951, 14495059, 14546622, 14597637, 14648103, 14698017, 14747378,
    14796184, 14844432, 14892122, 14939251, 14985817, 15031819, 15077256, 15122124, 15166424, 15210152, 15253308,
    15295889, 15337895, 15379323, 15420172, 15460440, 15500126, 15539229, 15577747, 15615678, 15653022, 15689776,
    15725939, 15761510, 15796488, 15830871, 15864658, 15897848, 15930439, 15962431, 15993821, 16024610, 16054795,
    16084375, 16113350, 16141719, 16169479, 16196631, 16223173, 16249104, 16274424, 16299131, 16323224, 16346702,
    16369565, 16391812, 16413442, 16434454, 16454846, 16474620, 16493773, 16512305, 16530216, 16547504, 16564169,
    16580211, 16595628, 16610420, 16624588, 16638129, 16651044, 16663331, 16674992, 16686025, 16696429, 16706205,
    16715352, 16723869, 16731757, 16739015, 16745643, 16751640, 16757007, 16761743, 16765847, 16769321, 16772163,
    16774374, 16775953, 16776900, 16777216, 16777216};

enum {
    NOT_YET = -1,
    GAIN_BITS = 15, /* of the ramp */
    RUN = 64        /* cosines that are summed in 32 bits */
};

int32_t law_cosine(uint32_t phase)
{
    const uint32_t turned = phase + UINT32_C(0x40000000); /* cos x = sin(x + a quarter) */
    const uint32_t within = turned & UINT32_C(0x3FFFFFFF);
    const uint32_t x = turned & UINT32_C(0x40000000) ? UINT32_C(0x40000000) - within : within;
    const int32_t *at = &sine[x >> 22];
    const int32_t share = (int32_t)(x >> 8 & UINT32_C(0x3FFF)); /* of the way to the next: 2^14 */
    const int32_t value = at[0] + ((at[1] - at[0]) * share >> 14);
    return turned & UINT32_C(0x80000000) ? -value : value;
}

uint32_t law_line_phase(uint32_t seed, uint32_t line)
{
    uint32_t z = seed + UINT32_C(0x9E3779B9) * (line + 1);
    z = (z ^ z >> 16) * UINT32_C(0x85EBCA6B);
    z = (z ^ z >> 13) * UINT32_C(0xC2B2AE35);
    return z ^ z >> 16;
}

/* harmonic / period in 2^-32 turns, and the rest. */
static void turn(uint32_t harmonic, uint32_t period, uint32_t *whole, uint32_t *rest)
{
    const uint64_t turns = (uint64_t)harmonic << 32;
    *whole = (uint32_t)(turns / period);
    *rest = (uint32_t)(turns % period);
}

static void add_turn(uint32_t *phase, uint32_t *rest, uint32_t whole, uint32_t more, uint32_t period)
{
    *phase += whole;
    *rest += more;
    if (*rest >= period) {
        *rest -= period;
        ++*phase;
    }
}

void law_excitation_begin(law_excitation_work *w, const law_excitation *p, int16_t *table)
{
    *w = (law_excitation_work){0};
    w->p = *p;
    w->table = table;
    if (p->lines == 0)
        return;
    turn(p->first, p->period, &w->first_turn, &w->first_turn_rest);
    turn(p->step, p->period, &w->step_turn, &w->step_turn_rest);
    w->share = (uint32_t)((UINT64_C(1) << 32) / p->lines);
}

/* Sum of the cosines of so many lines from w->line on: at most RUN, which 32 bits hold. */
static int32_t run_of_lines(const law_excitation_work *w, uint32_t lines)
{
    const uint32_t end = w->line + lines, step = w->step;
    uint32_t phase = w->first + w->line * step, line;
    int32_t sum = 0;

    if (w->p.phases == LAW_SCHROEDER) {
        for (line = w->line; line < end; line++) {
            sum += law_cosine(phase - (line * (line + 1) >> 1) * w->share);
            phase += step;
        }
    } else {
        for (line = w->line; line < end; line++) {
            sum += law_cosine(phase + law_line_phase(w->p.seed, line));
            phase += step;
        }
    }
    return sum;
}

/* Amplitude * sum of cosines in the table's format, to the nearest; a table that is too small for it saturates. */
static int16_t round_sum(const law_excitation_work *w)
{
    const uint32_t shift = (uint32_t)LAW_COSINE_BITS + (uint32_t)LAW_LINE_BITS - w->p.bits;
    const int64_t value = ((w->sum * (int64_t)w->p.amplitude >> (shift - 1)) + 1) >> 1;
    return (int16_t)law_saturate(value, 16);
}

bool law_excitation_continue(law_excitation_work *w, uint32_t cosines)
{
    const law_excitation *p = &w->p;

    while (p->lines > 0 && w->tick < p->period && cosines > 0) {
        const uint32_t left = p->lines - w->line, most = cosines < RUN ? cosines : RUN;
        const uint32_t lines = left < most ? left : most;
        w->sum += run_of_lines(w, lines);
        w->line += lines;
        cosines -= lines;
        if (w->line == p->lines) {
            w->table[w->tick++] = round_sum(w);
            w->line = 0;
            w->sum = 0;
            add_turn(&w->first, &w->first_rest, w->first_turn, w->first_turn_rest, p->period);
            add_turn(&w->step, &w->step_rest, w->step_turn, w->step_turn_rest, p->period);
        }
    }
    return p->lines == 0 || w->tick == p->period;
}

void law_excitation_reset(law_excitation_state *s, const law_excitation *p, const int16_t *table)
{
    s->at = NOT_YET;
    s->rising = p->ramp;
    s->rise = p->ramp > 0 ? (UINT32_C(1) << 31) / p->ramp : 0;
    s->table = table;
}

int32_t law_excitation_run(law_excitation_state *s, const law_excitation *p, uint32_t elapsed)
{
    int32_t gain = 1 << GAIN_BITS;

    if (s->at == NOT_YET) {
        s->at = 0;
    } else {
        uint32_t at = (uint32_t)s->at + elapsed;
        if (at >= p->period)
            at = elapsed == 1 ? 0 : at % p->period;
        s->at = (int32_t)at;
        s->rising -= elapsed < s->rising ? elapsed : s->rising;
    }
    if (s->rising > 0) /* (1 - cos(pi t/ramp))/2 */
        gain = ((1 << LAW_COSINE_BITS) - law_cosine((p->ramp - s->rising) * s->rise)) >> (LAW_COSINE_BITS + 1 - GAIN_BITS);
    return s->table[s->at] * gain * (1 << (LAW_LINE_BITS - GAIN_BITS)) >> p->bits;
}
