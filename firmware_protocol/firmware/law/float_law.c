/* A tick in float32: steps 3 to 7. */
#include "float_law.h"

#include <math.h>

#include "estimators.h"
#include "excitation.h"
#include "phases.h"

float law_float_depth(const law_parameters *p, int32_t travel)
{
    const law_float_wall *w = &p->wall;
    return w->side * ((float)law_to_32((int64_t)travel - w->surface_whole) - w->surface_fraction);
}

/* Step 3. */

/* Acceleration by the mean current that was active since the last estimate; input: that for a quantum, 0 for an estimator
 * that does not use the effort. */
static float effort_acceleration(const law_state *s, float input)
{
    if (input == 0.0f || s->active_sum == 0)
        return 0.0f;
    return input * ((float)s->active_sum / (float)s->velocity_ticks);
}

static float estimate_of(law_state *s, const law_parameters *p, int32_t count, int32_t moved, uint32_t periods)
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
        return s->sampled ? law_kalman_run(&s->of.kalman, &p->kalman, (float)moved, slope,
                                           effort_acceleration(s, p->kalman.input), periods)
                          : 0.0f;
    case LAW_TWO_MASS:
        return s->sampled ? law_two_mass_run(&s->of.two_mass, &p->two_mass, (float)moved, slope,
                                             effort_acceleration(s, p->two_mass.input), periods)
                          : 0.0f;
    case LAW_FDM:
    case LAW_FDM_BUTTERWORTH_FIXED:
        break;
    }
    return slope;
}

static void estimate(law_state *s, const law_parameters *p, int32_t count, int32_t active, uint32_t elapsed)
{
    const int slow = p->slow_multiple != 1 && s->sampled && fabsf(s->velocity_sampled) < p->wall.slow_speed;
    const uint32_t periods = law_periods_due(s, p->velocity_divider, slow ? p->slow_multiple : 1, elapsed);

    s->velocity_ticks = law_add(s->velocity_ticks, elapsed);
    /* In integers: a float32 product and sum in every tick would cost a tenth of a tick without a floating-point unit. */
    s->active_sum += elapsed == 1 ? active : (int64_t)active * elapsed;
    if (periods > 0) {
        const int32_t moved = law_moved(s, count, periods);
        float sampled;
        if (p->estimator == LAW_FDM_BUTTERWORTH_FIXED) {
            s->velocity_fixed = law_biquad_run(&s->of.biquad, &p->biquad, moved, periods);
            sampled = (float)s->velocity_fixed * p->wall.velocity_lsb;
        } else {
            sampled = estimate_of(s, p, count, moved, periods);
        }
        if (p->extrapolate)
            s->velocity_slope = (sampled - s->velocity_sampled) / (float)s->velocity_ticks;
        s->velocity_sampled = sampled;
        s->velocity_ticks = 0;
        s->active_sum = 0;
        s->sampled = 1;
        s->flags |= LAW_VELOCITY_UPDATED;
    }
    s->velocity = s->velocity_sampled;
    if (p->extrapolate)
        s->velocity += s->velocity_slope * (float)s->velocity_ticks;
}

/* Steps 4 and 5. */

static float reaction(law_state *s, const law_parameters *p, float depth)
{
    const law_float_wall *w = &p->wall;
    float inwards = w->side * (float)p->sense * s->velocity, total;

    if (p->arithmetic == LAW_ELSEWHERE)
        return 0.0f;
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

/* The passivity controller, rig.control._passivity: add damping that removes the wall's excess energy within a tick. */
static float add_damping(const law_state *s, const law_parameters *p, float reacted)
{
    const float inwards = p->wall.side * (float)p->sense * s->velocity, speed = fabsf(inwards);
    float added, reduced;

    if (s->wall_energy <= 0 || speed == 0.0f)
        return reacted;
    added = (float)s->wall_energy * (1.0f / (1 << LAW_ENERGY_BITS)) * (float)p->velocity_divider / speed;
    if (added > p->wall.passive_damping * speed)
        added = p->wall.passive_damping * speed;
    if (inwards > 0.0f)
        return reacted + added;
    reduced = reacted - added > 0.0f ? reacted - added : 0.0f;
    return reduced < reacted ? reduced : reacted;
}

/* Add the energy of the last tick, active effort times travel, to the passivity observer. In integers, because a float32
 * sum of thousands of ticks drifts. */
static void observe_energy(law_state *s, const law_parameters *p, int32_t travel, int32_t active, float depth)
{
    /* Factors of at most 2^39 and 2^20, and a sum of at most 2^60: nothing overflows, whatever counts arrive. */
    enum { MOST_MOVED = 1 << 20 };
    const int64_t most = INT64_C(1) << 60;

    if (law_is_rendering(s->phase)) {
        const int64_t constant = (int64_t)(p->wall.constant * (float)(1 << LAW_ENERGY_BITS));
        int64_t moved = (int64_t)travel - s->travel;
        moved = moved > MOST_MOVED ? MOST_MOVED : moved < -MOST_MOVED ? -MOST_MOVED : moved;
        s->wall_energy += ((int64_t)active * (1 << LAW_ENERGY_BITS) - constant) * moved;
        s->wall_energy = s->wall_energy > most ? most : s->wall_energy < -most ? -most : s->wall_energy;
        if (depth <= 0.0f && s->wall_energy < 0)
            s->wall_energy = 0;
    }
    s->travel = travel;
}

/* Return the estimated position less the last count; only if law_estimates_position. */
static float position_offset(const law_state *s, const law_parameters *p)
{
    return p->estimator == LAW_TWO_MASS ? s->of.two_mass.offset : s->of.kalman.offset;
}

static float wanted(law_state *s, const law_parameters *p, float depth, int32_t travel, uint32_t elapsed)
{
    const law_float_wall *w = &p->wall;
    float total;

    if (law_is_homing(s->phase)) {
        const float error = (float)law_home_error(s, p, travel, elapsed) * (1.0f / (1 << LAW_SETPOINT_BITS));
        const float effort = w->home_stiffness * error - w->home_damping * (float)p->sense * s->velocity;
        return effort > w->home_effort ? w->home_effort : effort < -w->home_effort ? -w->home_effort : effort;
    }
    if (!law_is_rendering(s->phase))
        return 0.0f;
    if (p->estimated_position)
        depth += w->side * (float)p->sense * position_offset(s, p);
    total = reaction(s, p, depth);
    if (w->passive_damping > 0.0f && s->phase == LAW_TRIAL && depth > 0.0f)
        total = add_damping(s, p, total);
    total = w->constant - w->side * total;
    if (p->excitation.lines > 0)
        total += (float)law_excitation_run(&s->excitation, &p->excitation, elapsed) * (1.0f / (1 << LAW_LINE_BITS));
    if (s->phase == LAW_RELEASE)
        total *= 1.0f - (float)s->phase_ticks / (float)p->release_ticks;
    return total;
}

/* Steps 6 and 7. */

/* Nearest whole number, halves towards +infinity; the argument is small. */
static int32_t nearest(float x)
{
    const float up = x + 0.5f;
    const int32_t whole = (int32_t)up;
    return (float)whole > up ? whole - 1 : whole;
}

static int32_t guarded(law_state *s, const law_parameters *p, float effort, uint32_t elapsed)
{
    const law_float_wall *w = &p->wall;
    const float limit = (float)p->current_limit;
    const float step = (float)elapsed * (law_is_homing(s->phase) ? w->homing_slew : w->trial_slew);

    if (fabsf(effort) > limit) {
        effort = effort > 0.0f ? limit : -limit;
        s->flags |= LAW_SATURATED;
    }
    if (effort < s->limited - step) {
        effort = s->limited - step;
        s->flags |= LAW_SLEW_BOUND;
    } else if (effort > s->limited + step) {
        effort = s->limited + step;
        s->flags |= LAW_SLEW_BOUND;
    }
    s->limited = effort;
    return law_within(nearest(effort), p->current_limit);
}

void law_float_tick(law_state *s, const law_parameters *p, const law_input *in, law_output *out)
{
    const law_float_wall *w = &p->wall;
    const uint32_t elapsed = law_elapsed(in);
    const int32_t travel = law_travel(p, in->count);
    const float depth = law_float_depth(p, travel);
    float effort;

    s->flags = depth > 0.0f ? LAW_INSIDE : 0;
    if (w->passive_damping > 0.0f)
        observe_energy(s, p, travel, in->active, depth);
    estimate(s, p, in->count, in->active, elapsed);
    s->flags |= law_advance(s, p, travel, depth > 0.0f, elapsed);
    effort = wanted(s, p, depth, travel, elapsed);
    if (!isfinite(effort) || !isfinite(s->velocity))
        s->flags |= LAW_NONFINITE;
    s->flags |= law_out_of_window(p, travel, fabsf(s->velocity) > w->speed_limit);
    if (s->flags & LAW_ENDS_RUN) {
        law_enter(s, LAW_DONE);
        s->limited = 0.0f;
        out->current = 0;
    } else {
        out->current = guarded(s, p, effort, elapsed);
    }
    out->flags = s->flags;
    out->phase = s->phase;
}
