/* Code of both laws between the estimate and the effort: when a velocity period is due, homing, settling, free space,
 * trial and release, and the end of a run. */
#ifndef LAW_PHASES_H
#define LAW_PHASES_H

#include <stdint.h>

#include "law.h"
#include "numbers.h"

enum {
    LAW_MOST_ELAPSED = 1 << 30, /* ticks of a gap: a longer one is counted as this */
    LAW_MOST_STEPS = 65535      /* of those, for a product with a step of the set point: it has arrived long before */
};

static inline uint32_t law_elapsed(const law_input *in)
{
    const uint32_t elapsed = in->elapsed_ticks;
    return elapsed < 1 ? 1 : elapsed > LAW_MOST_ELAPSED ? LAW_MOST_ELAPSED : elapsed;
}

/* Counts from the reference, along the position. */
static inline int32_t law_travel(const law_parameters *p, int32_t count)
{
    return law_signed(law_count_difference(count, p->reference), p->sense);
}

/* Velocity periods since the last estimate when one is due now, else 0. `multiple` is how many make one due. */
static inline uint32_t law_periods_due(law_state *s, uint32_t divider, uint32_t multiple, uint32_t elapsed)
{
    uint32_t since = law_add(s->since, elapsed), periods = 0;

    if (since >= (multiple == 1 ? divider : multiple * divider)) {
        periods = since < 2 * divider ? 1 : since / divider;
        since -= periods == 1 ? divider : periods * divider;
    }
    s->since = since;
    return periods;
}

/* Counts moved since the last estimate. */
static inline int32_t law_moved(law_state *s, int32_t count, uint32_t periods)
{
    int32_t moved = 0;

    if (s->sampled) {
        moved = law_count_difference(count, s->previous);
        s->window = periods;
    }
    s->previous = count;
    return moved;
}

static inline void law_enter(law_state *s, law_phase phase)
{
    s->phase = phase;
    s->phase_ticks = 0;
}

/* When the trial ends, in its ticks; `inside`: the handle is in the wall. */
static inline uint32_t law_end(law_state *s, const law_parameters *p, int inside)
{
    if (p->hold_ticks > 0 && s->contact_ticks == 0 && inside)
        s->contact_ticks = s->phase_ticks;
    return s->contact_ticks > 0 ? law_add(s->contact_ticks, p->hold_ticks) : p->trial_ticks;
}

/* Advance to the phase of this tick. Returns the flag of a failed homing, or 0. */
static inline uint32_t law_advance(law_state *s, const law_parameters *p, int32_t travel, int inside, uint32_t elapsed)
{
    const uint32_t ticks = law_add(s->phase_ticks, elapsed);

    s->phase_ticks = ticks;
    switch ((law_phase)s->phase) {
    case LAW_WAIT:
        s->setpoint = travel * ((int64_t)1 << LAW_SETPOINT_BITS);
        law_enter(s, LAW_HOMING);
        break;
    case LAW_HOMING:
    case LAW_SETTLE:
        if (travel < p->home_minimum || travel > p->home_maximum || s->setpoint != p->home_target) {
            s->rest_ticks = 0;
            s->phase = LAW_HOMING;
        } else {
            s->rest_ticks = law_add(s->rest_ticks, elapsed);
            s->phase = LAW_SETTLE;
        }
        if (s->phase == LAW_SETTLE && s->rest_ticks >= p->settle_ticks) {
            law_enter(s, p->free_ticks > 0 ? LAW_FREE : LAW_TRIAL);
        } else if (ticks > p->home_timeout_ticks) {
            law_enter(s, LAW_DONE);
            return LAW_HOMING_FAILED;
        }
        break;
    case LAW_FREE:
        if (travel < p->free_minimum || travel > p->free_maximum)
            law_enter(s, LAW_DONE);
        else if (ticks >= p->free_ticks)
            law_enter(s, LAW_TRIAL);
        break;
    case LAW_TRIAL:
        if (ticks >= law_end(s, p, inside))
            law_enter(s, LAW_RELEASE);
        break;
    case LAW_RELEASE:
        if (ticks >= p->release_ticks)
            law_enter(s, LAW_DONE);
        break;
    case LAW_DONE:
        break;
    }
    return 0;
}

/* Distance of the homing set point from the handle (counts * 2^LAW_SETPOINT_BITS), once it has moved by at most one
 * step a tick. */
static inline int64_t law_home_error(law_state *s, const law_parameters *p, int32_t travel, uint32_t elapsed)
{
    const int64_t target = p->home_target;

    if (s->setpoint != target) {
        int64_t step = p->home_step;
        if (elapsed > 1)
            step *= elapsed < LAW_MOST_STEPS ? elapsed : LAW_MOST_STEPS;
        s->setpoint += law_at_most(target - s->setpoint, step);
    }
    return s->setpoint - travel * ((int64_t)1 << LAW_SETPOINT_BITS);
}

static inline int law_is_homing(uint32_t phase)
{
    return phase == LAW_HOMING || phase == LAW_SETTLE;
}

static inline int law_is_rendering(uint32_t phase)
{
    return phase == LAW_TRIAL || phase == LAW_RELEASE;
}

/* Return the flag of a handle that is outside of its window or too fast, or 0. */
static inline uint32_t law_out_of_window(const law_parameters *p, int32_t travel, int too_fast)
{
    return travel < p->window_minimum || travel > p->window_maximum || too_fast ? LAW_OUT_OF_WINDOW : 0;
}

static inline int32_t law_within(int32_t quanta, int32_t limit)
{
    return quanta > limit ? limit : quanta < -limit ? -limit : quanta;
}

#endif
