/* A whole trial once more in C, as a careful programmer writes it for one rig, one estimator and one law: the yardstick of
   test_trial.py, which compiles this with -O3. The plant is sim_backend/mechanics/plant.c; finite difference and
   Butterworth at T2; the law with its clamp, homing, guard and whole current quanta. `struct control`, the places of
   parameters and the phases and flags come from the Python modules, by records.h. The results are the same to the last
   bit. */
#include <math.h>
#include <stdint.h>
#include "../../sim_backend/mechanics/plant.c"
#include "records.h"

struct memory {
    int64_t index, velocity_period, phase, phase_ticks, rest_ticks, flags;
    double setpoint, velocity, limited_effort, position, penetration;
};

struct difference {
    int64_t started, previous;
    double s1, s2;
};

static inline int64_t floor_of(double value)
{
    int64_t whole = (int64_t)value;
    return whole - (value < (double)whole);
}

/* s: positions and velocities of motor and link, effort, age of the edge */
#define ORDER 5
#define INPUTS 4

static inline int64_t advance(double *s, const double (*phi)[ORDER], const double (*gamma)[INPUTS], const double *p,
    double command)
{
    const struct plant plant = {ORDER, 0, *phi, *gamma, p, s};
    return plant_advance(&plant, command, 0.0);
}

/* Controller ------------------------------------------------------------------------------------------------------- */

static inline int64_t count_difference(int64_t newer, int64_t older)
{
    return (int32_t)(uint32_t)(uint64_t)(newer - older);
}

static inline double estimate(int64_t count, int64_t elapsed, struct difference *d, const double *p)
{
    double slope = 0.0, out;
    if (d->started)
        slope = (double)count_difference(count, d->previous) * p[RESOLUTION_SIGNED] / ((double)elapsed * p[PERIOD]);
    d->started = 1;
    d->previous = count;
    for (out = slope; elapsed > 0; elapsed--) {
        out = p[B0] * slope + d->s1;
        d->s1 = p[B1] * slope - p[A1] * out + d->s2;
        d->s2 = p[B2] * slope - p[A2] * out;
    }
    return out;
}

static inline double spring_damper(double penetration, double velocity, const double *p, int64_t *flags)
{
    if (penetration <= 0.0)
        return 0.0;
    if (p[ENTRY_ONLY] != 0.0 && velocity < 0.0)
        velocity = 0.0;
    double reaction = p[STIFFNESS] * penetration + p[DAMPING] * velocity;
    if (reaction < 0.0 && p[MAY_PULL] == 0.0) {
        *flags |= CLAMPED;
        return 0.0;
    }
    return reaction;
}

static inline void enter(struct memory *m, int64_t phase)
{
    m->phase = phase;
    m->phase_ticks = 0;
}

static inline void advance_phase(const struct control *c, struct memory *m)
{
    m->phase_ticks++;
    switch (m->phase) {
    case WAIT:
        m->setpoint = m->position;
        enter(m, HOMING);
        break;
    case HOMING:
    case SETTLE:
        if (fabs(m->position - c->home_target) > c->home_tolerance || m->setpoint != c->home_target) {
            m->rest_ticks = 0;
            m->phase = HOMING;
        } else {
            m->rest_ticks++;
            m->phase = SETTLE;
        }
        if (m->phase == SETTLE && m->rest_ticks >= c->settle_ticks) {
            enter(m, TRIAL);
        } else if (m->phase_ticks > c->home_timeout_ticks) {
            m->flags |= HOMING_FAILED;
            enter(m, DONE);
        }
        break;
    case TRIAL:
        if (m->phase_ticks >= c->trial_ticks)
            enter(m, RELEASE);
        break;
    case RELEASE:
        if (m->phase_ticks >= c->release_ticks)
            enter(m, DONE);
        break;
    }
}

static inline double wanted_effort(const struct control *c, struct memory *m, const double *wall)
{
    double total;
    switch (m->phase) {
    case HOMING:
    case SETTLE:
        if (m->setpoint < c->home_target)
            m->setpoint = fmin(m->setpoint + c->home_step, c->home_target);
        else
            m->setpoint = fmax(m->setpoint - c->home_step, c->home_target);
        total = c->home_stiffness * (m->setpoint - m->position) - c->home_damping * m->velocity;
        return clip(total, c->home_effort);
    case TRIAL:
    case RELEASE:
        total = c->constant_effort
            - c->wall_side * spring_damper(m->penetration, c->wall_side * m->velocity, wall, &m->flags);
        if (m->phase == TRIAL)
            return total;
        if (m->phase_ticks < c->release_ticks)
            return total * (1.0 - (double)m->phase_ticks / (double)c->release_ticks);
    }
    return 0.0;
}

static inline int64_t guarded(const struct control *c, struct memory *m, double wanted)
{
    if (!isfinite(wanted) || !isfinite(m->velocity))
        m->flags |= NONFINITE;
    if (!(c->window_minimum <= m->position && m->position <= c->window_maximum) || fabs(m->velocity) > c->speed_limit)
        m->flags |= OUT_OF_WINDOW;
    if (m->flags & ENDS_RUN) {
        enter(m, DONE);
        return 0;
    }
    double effort = clip(wanted, c->effort_limit);
    if (effort != wanted)
        m->flags |= SATURATED;
    double slew = m->phase == HOMING || m->phase == SETTLE ? c->homing_slew : c->trial_slew;
    double low = m->limited_effort - slew, high = m->limited_effort + slew;
    double allowed = effort < low ? low : effort > high ? high : effort;
    if (allowed != effort)
        m->flags |= SLEW_BOUND;
    m->limited_effort = allowed;
    return floor_of(clip(allowed / c->effort_quantum + 0.5, 32767.0));
}

static inline int64_t step(const struct control *c, struct memory *m, struct difference *d, const double *estimator,
    const double *wall, int64_t count)
{
    m->flags = 0;
    m->index++;
    m->position = c->resolution * (double)count_difference(count, c->reference_count);
    m->penetration = c->wall_side * (m->position - c->wall_position);
    if (m->penetration > 0.0)
        m->flags |= INSIDE;
    int64_t elapsed = m->index / c->velocity_divider - m->velocity_period;
    if (elapsed >= 1) {
        m->velocity_period += elapsed;
        m->velocity = estimate(count, elapsed, d, estimator);
        m->flags |= VELOCITY_UPDATED;
    }
    advance_phase(c, m);
    return guarded(c, m, wanted_effort(c, m, wall));
}

/* Until the law is done or n ticks are over; returns their number. The age of the edge is rounded to device time, which
   only other estimators read. */
int64_t trial(const struct control *control, const double *estimator, const double *wall,
    const double (*phi)[ORDER], const double (*gamma)[INPUTS], const double *plant, double *state,
    int64_t n,
    double (*states)[ORDER + 1], double *velocities, int64_t *counts, int64_t *phases, int64_t *active,
    int64_t *currents, int64_t *flags)
{
    struct memory m = {.index = -1, .velocity_period = -1};
    struct difference d = {0};
    int64_t count = advance(state, phi, gamma, plant, 0.0);
    for (int64_t k = 0; k < n; k++) {
        active[k] = k > 0 ? currents[k - 1] : 0;
        int64_t current = step(control, &m, &d, estimator, wall, count);
        for (int i = 0; i <= ORDER; i++)
            states[k][i] = state[i];
        counts[k] = count;
        phases[k] = m.phase;
        velocities[k] = m.velocity;
        currents[k] = m.phase == DONE ? 0 : current;
        flags[k] = m.flags;
        if (m.phase == DONE)
            return k + 1;
        count = advance(state, phi, gamma, plant, (double)current * control->effort_quantum);
    }
    return n;
}
