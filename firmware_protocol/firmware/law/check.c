/* Checks of the parameters that law_tick relies on, made once when they arrive. */
#include <math.h>

#include "law.h"

enum { MOST_DIVIDER = 1 << 16, MOST_SHIFT = 40, MOST_CURRENT = 32767, MOST_BAND = 1 << 28 };
enum { MOST_LINES = 4096, MOST_PERIOD = 1 << 16, MOST_RAMP = 1 << 24, MOST_TABLE_BITS = 15 };

static const int64_t most_setpoint = INT64_C(1) << (31 + LAW_SETPOINT_BITS);
static const int64_t most_home_step = INT64_C(1) << 40;                    /* 2^16 counts a tick */
static const int64_t most_lines = INT64_C(1) << 38; /* quanta * 2^16: times a cosine, 2^62 */

static int between(int64_t value, int64_t low, int64_t high)
{
    return low <= value && value <= high;
}

static int is_sign(int32_t value)
{
    return value == 1 || value == -1;
}

static int64_t size(int64_t value)
{
    return value < 0 ? -value : value;
}

static int good_choices(const law_parameters *p)
{
    return between(p->arithmetic, LAW_FIXED, LAW_ELSEWHERE) && between(p->estimator, LAW_FDM_BUTTERWORTH_FIXED, LAW_TWO_MASS)
           && is_sign(p->sense) && between(p->may_pull, 0, 1) && between(p->entry_only, 0, 1)
           && between(p->bilateral, 0, 1) && between(p->extrapolate, 0, p->arithmetic != LAW_FIXED)
           && between(p->estimated_position, 0,
                      p->arithmetic != LAW_FIXED && law_estimates_position(p->estimator) && p->velocity_divider == 1)
           && (p->arithmetic != LAW_FIXED || p->estimator == LAW_FDM_BUTTERWORTH_FIXED);
}

static int good_limits(const law_parameters *p)
{
    return between(p->current_limit, 0, MOST_CURRENT) && p->window_minimum <= p->window_maximum
           && p->home_minimum <= p->home_maximum && between(p->home_target, -most_setpoint, most_setpoint)
           && between(p->home_step, 0, most_home_step) && p->release_ticks > 0;
}

/* The widest sum of the biquad, with the word that rounding adds, must fit 64 bits. */
static int good_biquad(const law_biquad *f)
{
    int64_t sum;
    if (!between(f->coefficient_bits, 0, 30) || !between(f->state_bits, 0, 30) || !between(f->word_bits, 2, 32)
        || !between(f->rounding, LAW_FLOOR, LAW_NEAREST))
        return 0;
    sum = size(f->b0) + size(f->b1) + size(f->b2) + size(f->a1) + size(f->a2);
    return sum <= (INT64_MAX - (INT64_C(1) << f->coefficient_bits)) >> (f->word_bits - 1);
}

static int good_filter(const law_parameters *p)
{
    int32_t i;
    switch ((law_estimator)p->estimator) {
    case LAW_FDM_BUTTERWORTH_FIXED:
        return good_biquad(&p->biquad);
    case LAW_FDM_BUTTERWORTH:
        if (!between(p->low_pass.sections, 1, LAW_SECTIONS))
            return 0;
        for (i = 0; i < p->low_pass.sections; i++)
            if (!between(p->low_pass.section[i].order, 1, 2))
                return 0;
        return 1;
    case LAW_FOAW_END:
    case LAW_FOAW_BEST:
        return between(p->foaw.band, 0, MOST_BAND) && between(p->foaw.limit, 1, LAW_LONGEST_WINDOW)
               && between(p->foaw.stop_first, 0, 1) && between(p->foaw.least_squares, 0, 1);
    case LAW_LEVANT:
        return between(p->levant.discretisation, LAW_EXPLICIT, LAW_IMPLICIT) && between(p->levant.integrator, 0, 1);
    case LAW_FDM:
    case LAW_KALMAN:
    case LAW_TWO_MASS:
        break;
    }
    return 1;
}

static int good_excitation(const law_excitation *e)
{
    if (e->lines == 0)
        return 1;
    return e->lines <= MOST_LINES && between(e->period, 2, MOST_PERIOD) && e->ramp <= MOST_RAMP && e->first >= 1
           && e->step >= 1 && e->first + (int64_t)(e->lines - 1) * e->step <= (e->period - 1) / 2
           && e->bits <= MOST_TABLE_BITS && e->phases <= LAW_SCHROEDER && (int64_t)e->lines * e->amplitude <= most_lines;
}

/* The most that a table can hold (quanta * 2^LAW_LINE_BITS). */
static int64_t most_excitation(const law_excitation *e)
{
    return e->lines == 0 ? 0 : (INT64_C(1) << 31) >> e->bits;
}

static int good_float_wall(const law_float_wall *w)
{
    return (w->side == 1.0f || w->side == -1.0f) && w->surface_fraction >= 0.0f && w->surface_fraction <= 1.0f
           && w->trial_slew >= 0.0f && w->homing_slew >= 0.0f && w->speed_limit >= 0.0f && w->home_effort >= 0.0f
           && w->passive_damping >= 0.0f && isfinite(w->stiffness) && isfinite(w->damping) && isfinite(w->constant)
           && isfinite(w->home_stiffness) && isfinite(w->home_damping) && isfinite(w->velocity_lsb);
}

/* Depth and velocity at the ends of their words, and the excitation, may come together. */
static int good_fixed_wall(const law_fixed_wall *w, int32_t sense, int64_t excitation)
{
    int64_t room = INT64_MAX;
    if (!is_sign(w->side) || w->direction != w->side * sense || !between(w->shift, 1, MOST_SHIFT)
        || !between(w->home_shift, 1, MOST_SHIFT) || w->stiffness < 0 || w->damping < 0 || w->home_stiffness < 0
        || w->home_damping < 0 || w->home_effort < 0 || w->speed_limit < 0 || w->slow_speed < 0
        || w->trial_slew < 0 || w->homing_slew < 0 || w->constant < -INT64_MAX)
        return 0;
    room -= (int64_t)w->stiffness << 31;
    room -= (int64_t)w->damping << 31; /* both below 2^62 */
    room -= w->shift > LAW_LINE_BITS ? excitation << (w->shift - LAW_LINE_BITS) : excitation;
    return room >= size(w->constant);
}

law_verdict law_check_wall(const law_parameters *p)
{
    const int good = p->arithmetic == LAW_FIXED
                         ? good_fixed_wall(&p->fixed_wall, p->sense, most_excitation(&p->excitation))
                         : good_float_wall(&p->wall);
    return good ? LAW_GOOD : LAW_BAD_WALL;
}

law_verdict law_check(const law_parameters *p)
{
    if (!good_choices(p))
        return LAW_BAD_CHOICE;
    if (!between(p->velocity_divider, 1, MOST_DIVIDER) || !between(p->slow_multiple, 1, MOST_DIVIDER - 1))
        return LAW_BAD_RATE;
    if (!good_limits(p))
        return LAW_BAD_LIMIT;
    if (!good_filter(p))
        return LAW_BAD_FILTER;
    if (!good_excitation(&p->excitation))
        return LAW_BAD_EXCITATION;
    return law_check_wall(p);
}
