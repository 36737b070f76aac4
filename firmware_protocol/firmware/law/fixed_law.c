/* A tick in integers, steps 3 to 7: rig.control._fixed_wall, with homing, release and slew around it.
 *
 * Written for a processor with few registers and no 64-bit product. Values that are nearly always small are first tried in
 * 32 bits, and rare cases are in separate functions. */
#include "fixed_law.h"

#include "estimators.h"
#include "excitation.h"
#include "phases.h"

enum {
    RELEASE_BITS = 15,    /* of the share that is left in the release: law_part */
    MOST_ALONG = 1 << 22, /* counts from the reference: 2^30 as a depth, which leaves room for as much surface */
    MOST_SURFACE = 1 << 30
};

int32_t law_fixed_depth(const law_parameters *p, int32_t travel)
{
    const int32_t along = law_signed(travel, p->fixed_wall.side), surface = p->fixed_wall.surface;
    if (along >= -MOST_ALONG && along < MOST_ALONG && surface >= -MOST_SURFACE && surface <= MOST_SURFACE)
        return along * (1 << LAW_DEPTH_BITS) - surface; /* as always; the other way takes 64 bits */
    return law_to_32((int64_t)along * (1 << LAW_DEPTH_BITS) - surface);
}

static uint32_t multiple(const law_state *s, const law_parameters *p)
{
    const int32_t speed = p->fixed_wall.slow_speed;
    if (p->slow_multiple == 1 || !s->sampled || s->velocity_fixed >= speed || s->velocity_fixed <= -speed)
        return 1;
    return p->slow_multiple;
}

/* An effort in quanta * 2^from, at another binary point and rounded down; its value must fit there. */
static int64_t rescale(int64_t effort, int32_t from, int32_t to)
{
    return from >= to ? law_shift(effort, from - to) : effort * ((int64_t)1 << (to - from));
}

/* The remaining share of the effort in the release, floor(2^15 left/release_ticks): a division when the release
 * begins, and where ticks were missed; else what one tick takes away. */
static uint32_t release_share(law_state *s, uint32_t ticks, uint32_t elapsed)
{
    if (s->phase_ticks == 0) {
        s->release_share = (uint32_t)1 << RELEASE_BITS;
        s->release_rest = 0;
        s->release_step = s->release_share / ticks;
        s->release_step_rest = s->release_share % ticks;
    } else if (elapsed == 1) {
        s->release_share -= s->release_step;
        if (s->release_rest < s->release_step_rest) {
            s->release_share--;
            s->release_rest += ticks;
        }
        s->release_rest -= s->release_step_rest;
    } else {
        const uint64_t left = (uint64_t)(ticks - s->phase_ticks) << RELEASE_BITS;
        s->release_share = (uint32_t)(left / ticks);
        s->release_rest = (uint32_t)(left % ticks);
    }
    return s->release_share;
}

/* Quanta * 2^home_shift. */
static int64_t servo(law_state *s, const law_parameters *p, int32_t travel, uint32_t elapsed)
{
    const law_fixed_wall *w = &p->fixed_wall;
    const int64_t distance = law_home_error(s, p, travel, elapsed) >> (LAW_SETPOINT_BITS - LAW_DEPTH_BITS);
    const int64_t damping = law_product(w->home_damping, s->velocity_fixed);
    const int64_t total = law_product(w->home_stiffness, law_to_32(distance)) - law_with_sign(damping, p->sense);
    return law_at_most(total, w->home_effort);
}

/* Return the wall's effort, inside the wall or on both sides (bilateral); sets LAW_CLAMPED in `flags`. */
static int64_t reaction(const law_parameters *p, int32_t depth, int32_t velocity, uint32_t *flags)
{
    const law_fixed_wall *w = &p->fixed_wall;
    int64_t total = law_product(w->stiffness, depth);

    if (p->bilateral)
        return total + law_with_sign(law_product(w->damping, velocity), w->direction);
    if (!p->entry_only || (velocity > 0) == (w->direction > 0))
        total += law_with_sign(law_product(w->damping, velocity), w->direction);
    if (total < 0 && !p->may_pull) {
        *flags |= LAW_CLAMPED;
        return 0;
    }
    return total;
}

/* Limit and slew work on the effort rounded down to 2^-15 quanta, in 32 bits. To round that to the nearest quantum is
 * to round the effort itself: half a quantum is a whole number of those steps. */
static int32_t guarded(law_state *s, const law_parameters *p, int32_t fine, uint32_t elapsed, uint32_t *flags)
{
    const int32_t limit = p->current_limit * (1 << LAW_SLEW_BITS), before = s->limited_fixed;
    int32_t step = law_is_homing(s->phase) ? p->fixed_wall.homing_slew : p->fixed_wall.trial_slew;
    int32_t change;

    if (fine > limit || fine < -limit) {
        fine = fine > 0 ? limit : -limit;
        *flags |= LAW_SATURATED;
    }
    if (elapsed > 1)
        step = law_to_32(step * (int64_t)elapsed);
    change = fine - before; /* both within 2^15 quanta */
    if (change > step || change < -step) {
        fine = change > 0 ? before + step : before - step;
        *flags |= LAW_SLEW_BOUND;
    }
    s->limited_fixed = fine;
    return law_within((fine + (1 << (LAW_SLEW_BITS - 1))) >> LAW_SLEW_BITS, p->current_limit);
}

void law_fixed_tick(law_state *s, const law_parameters *p, const law_input *in, law_output *out)
{
    const law_fixed_wall *w = &p->fixed_wall;
    const uint32_t elapsed = law_elapsed(in), periods = law_periods_due(s, p->velocity_divider, multiple(s, p), elapsed);
    const int32_t travel = law_travel(p, in->count);
    uint32_t flags = 0, phase;
    const int32_t depth = law_fixed_depth(p, travel);
    int32_t shift = w->shift, velocity;
    int64_t effort = 0;

    if (periods > 0) {
        s->velocity_fixed = law_biquad_run(&s->of.biquad, &p->biquad, law_moved(s, in->count, periods), periods);
        s->sampled = 1;
        flags = LAW_VELOCITY_UPDATED;
    }
    flags |= law_advance(s, p, travel, depth > 0, elapsed);
    phase = s->phase;
    velocity = s->velocity_fixed;
    if (depth > 0)
        flags |= LAW_INSIDE;
    if (law_is_rendering(phase)) {
        effort = w->constant;
        if (depth > 0 || p->bilateral)
            effort -= law_with_sign(reaction(p, depth, velocity, &flags), w->side);
        if (p->excitation.lines > 0)
            effort += rescale(law_excitation_run(&s->excitation, &p->excitation, elapsed), LAW_LINE_BITS, shift);
        if (phase == LAW_RELEASE)
            effort = law_part(effort, release_share(s, p->release_ticks, elapsed));
    } else if (law_is_homing(phase)) {
        effort = servo(s, p, travel, elapsed);
        shift = w->home_shift;
    }
    flags |= law_out_of_window(p, travel, velocity > w->speed_limit || velocity < -w->speed_limit);
    if (flags & LAW_ENDS_RUN) {
        law_enter(s, LAW_DONE);
        s->limited_fixed = 0;
        out->current = 0;
    } else {
        if (shift < LAW_SLEW_BITS)
            effort = law_at_most(effort, INT64_C(1) << 32); /* still beyond any limit, and it can be scaled up */
        out->current = guarded(s, p, law_to_32(rescale(effort, shift, LAW_SLEW_BITS)), elapsed, &flags);
    }
    s->flags = flags;
    out->flags = flags;
    out->phase = s->phase;
}
