#include "law.h"

#include <math.h>

#include "estimators.h"
#include "multisine.h"
#include "numbers.h"

enum {
    MOST_ELAPSED = 1 << 30, /* ticks of a gap: a longer one is counted as this */
    MOST_STEPS = 65535,     /* of those, for a product with a step of the set point: it has arrived long before */
    RELEASE_BITS = 15       /* of the share that is left in the release */
};

/* What one tick works on besides what it keeps. */
typedef struct {
    law_state *s;
    const law_parameters *p;
    uint32_t elapsed;
    int32_t travel; /* counts from the reference, along the position */
} tick;

void law_reset(law_state *s, const law_parameters *p)
{
    *s = (law_state){0};
    s->since = p->velocity_divider - 1; /* the first sample begins a period */
    law_multisine_reset(&s->multisine, &p->multisine);
}

/* Step 3. */

static int slow(const law_state *s, const law_parameters *p)
{
    if (p->slow_multiple == 1 || !s->sampled)
        return 0;
    if (p->arithmetic == LAW_FLOAT)
        return fabsf(s->velocity_sampled) < p->wall.slow_speed;
    return s->velocity_fixed < p->fixed_wall.slow_speed && s->velocity_fixed > -p->fixed_wall.slow_speed;
}

static float float_estimate(law_state *s, const law_parameters *p, int32_t count, int32_t moved, uint32_t periods)
{
    const float slope = periods == 1 ? (float)moved : (float)moved / (float)periods;

    switch ((law_estimator)p->estimator) {
    case LAW_FDM_BUTTERWORTH:
        return law_low_pass_run(&s->of.low_pass, &p->low_pass, slope, periods);
    case LAW_FOAW_END:
        return law_foaw_end(&s->of.foaw, &p->foaw, count, periods, &s->window);
    case LAW_FOAW_BEST:
        return law_foaw_best(&s->of.foaw, &p->foaw, count, periods, &s->window);
    case LAW_LEVANT:
        return s->sampled ? law_levant_run(&s->of.levant, &p->levant, slope, periods) : 0.0f;
    case LAW_KALMAN:
        return s->sampled ? law_kalman_run(&s->of.kalman, &p->kalman, (float)moved, slope, periods) : 0.0f;
    case LAW_FDM:
    case LAW_FDM_BUTTERWORTH_FIXED:
        break;
    }
    return slope;
}

static void estimate(const tick *t, int32_t count)
{
    law_state *s = t->s;
    const law_parameters *p = t->p;
    const uint32_t divider = p->velocity_divider;
    uint32_t periods = 1;
    int32_t moved = 0;

    s->since = law_add(s->since, t->elapsed);
    s->velocity_ticks = law_add(s->velocity_ticks, t->elapsed);
    if (s->since >= (slow(s, p) ? p->slow_multiple * divider : divider)) {
        if (s->since >= 2 * divider)
            periods = s->since / divider;
        s->since -= periods * divider;
        if (s->sampled) {
            moved = law_count_difference(count, s->previous);
            s->window = periods;
        }
        s->previous = count;
        if (p->estimator == LAW_FDM_BUTTERWORTH_FIXED)
            s->velocity_fixed = law_biquad_run(&s->of.biquad, &p->biquad, moved, periods);
        if (p->arithmetic == LAW_FLOAT) {
            const float sampled = p->estimator == LAW_FDM_BUTTERWORTH_FIXED
                                      ? (float)s->velocity_fixed * p->wall.velocity_lsb
                                      : float_estimate(s, p, count, moved, periods);
            if (p->extrapolate)
                s->velocity_slope = (sampled - s->velocity_sampled) / (float)s->velocity_ticks;
            s->velocity_sampled = sampled;
        }
        s->velocity_ticks = 0;
        s->sampled = 1;
        s->flags |= LAW_VELOCITY_UPDATED;
    }
    s->velocity = s->velocity_sampled;
    if (p->extrapolate)
        s->velocity += s->velocity_slope * (float)s->velocity_ticks;
}

/* Between steps 3 and 4: homing, settling, trial and release. */

static void enter(law_state *s, law_phase phase)
{
    s->phase = phase;
    s->phase_ticks = 0;
}

static void advance_phase(const tick *t)
{
    law_state *s = t->s;
    const law_parameters *p = t->p;

    s->phase_ticks = law_add(s->phase_ticks, t->elapsed);
    switch ((law_phase)s->phase) {
    case LAW_WAIT:
        s->setpoint = t->travel * ((int64_t)1 << LAW_SETPOINT_BITS);
        enter(s, LAW_HOMING);
        break;
    case LAW_HOMING:
    case LAW_SETTLE:
        if (t->travel < p->home_minimum || t->travel > p->home_maximum || s->setpoint != p->home_target) {
            s->rest_ticks = 0;
            s->phase = LAW_HOMING;
        } else {
            s->rest_ticks = law_add(s->rest_ticks, t->elapsed);
            s->phase = LAW_SETTLE;
        }
        if (s->phase == LAW_SETTLE && s->rest_ticks >= p->settle_ticks) {
            enter(s, LAW_TRIAL);
        } else if (s->phase_ticks > p->home_timeout_ticks) {
            s->flags |= LAW_HOMING_FAILED;
            enter(s, LAW_DONE);
        }
        break;
    case LAW_TRIAL:
        if (s->phase_ticks >= p->trial_ticks)
            enter(s, LAW_RELEASE);
        break;
    case LAW_RELEASE:
        if (s->phase_ticks >= p->release_ticks)
            enter(s, LAW_DONE);
        break;
    case LAW_DONE:
        break;
    }
}

static int homing(const law_state *s)
{
    return s->phase == LAW_HOMING || s->phase == LAW_SETTLE;
}

/* Move the set point by at most one step a tick, and return its distance from the handle (counts * 2^24). */
static int64_t home_error(const tick *t)
{
    law_state *s = t->s;
    const int64_t target = t->p->home_target;
    const int64_t step = t->p->home_step * (int64_t)(t->elapsed < MOST_STEPS ? t->elapsed : MOST_STEPS);
    s->setpoint += law_at_most(target - s->setpoint, step);
    return s->setpoint - t->travel * ((int64_t)1 << LAW_SETPOINT_BITS);
}

/* Whether the run must end here, and if so, that it does. */
static int cut(const tick *t, int too_fast)
{
    law_state *s = t->s;
    if (t->travel < t->p->window_minimum || t->travel > t->p->window_maximum || too_fast)
        s->flags |= LAW_OUT_OF_WINDOW;
    if ((s->flags & LAW_ENDS_RUN) == 0)
        return 0;
    enter(s, LAW_DONE);
    s->limited = 0.0f;
    s->limited_fixed = 0;
    return 1;
}

static int32_t within(int32_t quanta, int32_t limit)
{
    return quanta > limit ? limit : quanta < -limit ? -limit : quanta;
}

/* Steps 4 to 7 in float32. */

static float float_reaction(law_state *s, const law_parameters *p, float depth)
{
    const law_float_wall *w = &p->wall;
    float inwards = w->side * (float)p->sense * s->velocity, total;

    if (p->bilateral)
        return w->stiffness * depth + w->damping * inwards;
    if (depth <= 0.0f)
        return 0.0f;
    if (p->entry_only && inwards < 0.0f)
        inwards = 0.0f;
    total = w->stiffness * depth + w->damping * inwards;
    if (total < 0.0f && !p->may_pull) {
        s->flags |= LAW_CLAMPED;
        return 0.0f;
    }
    return total;
}

static float float_wanted(const tick *t, float depth)
{
    law_state *s = t->s;
    const law_parameters *p = t->p;
    const law_float_wall *w = &p->wall;
    float total;

    if (homing(s)) {
        const float error = (float)home_error(t) * (1.0f / (1 << LAW_SETPOINT_BITS));
        const float effort = w->home_stiffness * error - w->home_damping * (float)p->sense * s->velocity;
        return effort > w->home_effort ? w->home_effort : effort < -w->home_effort ? -w->home_effort : effort;
    }
    if (s->phase != LAW_TRIAL && s->phase != LAW_RELEASE)
        return 0.0f;
    total = w->constant - w->side * float_reaction(s, p, depth);
    if (p->multisine.lines > 0)
        total += (float)law_multisine_run(&s->multisine, &p->multisine, t->elapsed) * (1.0f / (1 << LAW_LINE_BITS));
    if (s->phase == LAW_RELEASE)
        total *= 1.0f - (float)s->phase_ticks / (float)p->release_ticks;
    return total;
}

/* Nearest whole number, halves towards +infinity; the argument is small. */
static int32_t nearest(float x)
{
    const float up = x + 0.5f;
    const int32_t whole = (int32_t)up;
    return (float)whole > up ? whole - 1 : whole;
}

static float float_depth(const law_parameters *p, int32_t travel)
{
    const law_float_wall *w = &p->wall;
    return w->side * ((float)law_to_32((int64_t)travel - w->surface_whole) - w->surface_fraction);
}

static int32_t float_current(const tick *t)
{
    law_state *s = t->s;
    const law_parameters *p = t->p;
    const law_float_wall *w = &p->wall;
    const float depth = float_depth(p, t->travel), limit = (float)p->current_limit;
    float effort, step;

    if (depth > 0.0f)
        s->flags |= LAW_INSIDE;
    advance_phase(t);
    effort = float_wanted(t, depth);
    if (!isfinite(effort) || !isfinite(s->velocity))
        s->flags |= LAW_NONFINITE;
    if (cut(t, fabsf(s->velocity) > w->speed_limit))
        return 0;
    if (fabsf(effort) > limit) {
        effort = effort > 0.0f ? limit : -limit;
        s->flags |= LAW_SATURATED;
    }
    step = (float)t->elapsed * (homing(s) ? w->homing_slew : w->trial_slew);
    if (effort < s->limited - step) {
        effort = s->limited - step;
        s->flags |= LAW_SLEW_BOUND;
    } else if (effort > s->limited + step) {
        effort = s->limited + step;
        s->flags |= LAW_SLEW_BOUND;
    }
    s->limited = effort;
    return within(nearest(effort), p->current_limit);
}

/* Steps 4 to 7 in integers: rig.fixed_wall, with homing, release and slew around it. */

static int64_t fixed_reaction(law_state *s, const law_parameters *p, int32_t depth)
{
    const law_fixed_wall *w = &p->fixed_wall;
    int64_t total, damping = 0;

    if (depth <= 0 && !p->bilateral)
        return 0;
    if (p->bilateral || !p->entry_only || (s->velocity_fixed > 0) == (w->direction > 0))
        damping = law_with_sign(law_product(w->damping, s->velocity_fixed), w->direction);
    total = law_product(w->stiffness, depth) + damping;
    if (total < 0 && !p->may_pull && !p->bilateral) {
        s->flags |= LAW_CLAMPED;
        return 0;
    }
    return total;
}

/* An effort in quanta * 2^from, at another binary point and rounded down; its value must fit there. */
static int64_t rescaled(int64_t effort, int32_t from, int32_t to)
{
    return from >= to ? effort >> (from - to) : effort * ((int64_t)1 << (to - from));
}

/* Returns the wanted effort in quanta * 2^*shift. */
static int64_t fixed_wanted(const tick *t, int32_t depth, int32_t *shift)
{
    law_state *s = t->s;
    const law_parameters *p = t->p;
    const law_fixed_wall *w = &p->fixed_wall;
    int64_t total;

    *shift = w->shift;
    if (homing(s)) {
        const int32_t error = law_to_32(home_error(t) >> (LAW_SETPOINT_BITS - LAW_DEPTH_BITS));
        *shift = w->home_shift;
        total = law_product(w->home_stiffness, error)
                - law_with_sign(law_product(w->home_damping, s->velocity_fixed), p->sense);
        return law_at_most(total, w->home_effort);
    }
    if (s->phase != LAW_TRIAL && s->phase != LAW_RELEASE)
        return 0;
    total = w->constant - law_with_sign(fixed_reaction(s, p, depth), w->side);
    if (p->multisine.lines > 0)
        total += rescaled(law_multisine_run(&s->multisine, &p->multisine, t->elapsed), LAW_LINE_BITS, w->shift);
    if (s->phase == LAW_RELEASE) { /* total * share / 2^15, rounded down, without a product of more than 64 bits */
        const int64_t left = (int64_t)p->release_ticks - s->phase_ticks;
        const int64_t share = left * (1 << RELEASE_BITS) / p->release_ticks;
        const int64_t rest = total & ((1 << RELEASE_BITS) - 1);
        total = (total >> RELEASE_BITS) * share + ((rest * share) >> RELEASE_BITS);
    }
    return total;
}

static int32_t fixed_depth(const law_parameters *p, int32_t travel)
{
    const law_fixed_wall *w = &p->fixed_wall;
    return law_to_32(law_with_sign(travel, w->side) * (1 << LAW_DEPTH_BITS) - w->surface);
}

/* Limit and slew work on the effort rounded down to 2^-15 quanta, in 32 bits. To round that to the nearest quantum is
 * to round the effort itself: half a quantum is a whole number of those steps. */
static int32_t fixed_current(const tick *t)
{
    law_state *s = t->s;
    const law_parameters *p = t->p;
    const law_fixed_wall *w = &p->fixed_wall;
    const int32_t depth = fixed_depth(p, t->travel), limit = p->current_limit * (1 << LAW_SLEW_BITS);
    int64_t effort;
    int32_t fine, step, change, shift;

    if (depth > 0)
        s->flags |= LAW_INSIDE;
    advance_phase(t);
    effort = fixed_wanted(t, depth, &shift);
    if (cut(t, s->velocity_fixed > w->speed_limit || s->velocity_fixed < -w->speed_limit))
        return 0;
    if (shift < LAW_SLEW_BITS)
        effort = law_at_most(effort, INT64_C(1) << 32); /* still beyond any limit, and it can be scaled up */
    fine = law_to_32(rescaled(effort, shift, LAW_SLEW_BITS));
    if (fine > limit || fine < -limit) {
        fine = fine > 0 ? limit : -limit;
        s->flags |= LAW_SATURATED;
    }
    step = homing(s) ? w->homing_slew : w->trial_slew;
    if (t->elapsed > 1)
        step = law_to_32(step * (int64_t)t->elapsed);
    change = fine - s->limited_fixed; /* both within 2^15 quanta */
    if (change > step || change < -step) {
        fine = change > 0 ? s->limited_fixed + step : s->limited_fixed - step;
        s->flags |= LAW_SLEW_BOUND;
    }
    s->limited_fixed = fine;
    return within((fine + (1 << (LAW_SLEW_BITS - 1))) >> LAW_SLEW_BITS, p->current_limit);
}

static int32_t travel_of(const law_parameters *p, int32_t count)
{
    return law_to_32(law_with_sign(law_count_difference(count, p->reference), p->sense));
}

int law_inside(const law_parameters *p, int32_t count)
{
    const int32_t travel = travel_of(p, count);
    return p->arithmetic == LAW_FLOAT ? float_depth(p, travel) > 0.0f : fixed_depth(p, travel) > 0;
}

law_output law_tick(law_state *s, const law_parameters *p, const law_input *in)
{
    tick t;
    law_output out;

    t.s = s;
    t.p = p;
    t.elapsed = in->elapsed_ticks < 1 ? 1 : in->elapsed_ticks > MOST_ELAPSED ? MOST_ELAPSED : in->elapsed_ticks;
    t.travel = travel_of(p, in->count);
    s->flags = 0;
    estimate(&t, in->count);
    out.current = p->arithmetic == LAW_FLOAT ? float_current(&t) : fixed_current(&t);
    out.flags = s->flags;
    out.phase = s->phase;
    return out;
}
