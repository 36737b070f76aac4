/* Levant's differentiator, the Kalman filter with its steady gain and the observer of two masses, in float32, counts and
 * periods. */
#include <math.h>

#include "estimators.h"

static float sign(float x)
{
    return x > 0.0f ? 1.0f : x < 0.0f ? -1.0f : 0.0f;
}

/* One period: error is the copy of the position less the new sample, before; returns u. See rig.control.estimators._levant. */
static float levant_step(law_levant_state *s, const law_levant *p, float error)
{
    float u, push, beyond, b;

    if (p->discretisation != LAW_IMPLICIT) {
        push = sign(error);
        if (p->discretisation == LAW_SEMI_IMPLICIT)
            s->integrator -= p->alpha * push;
        u = s->integrator - p->lambda * sqrtf(fabsf(error)) * push;
        if (p->discretisation == LAW_EXPLICIT)
            s->integrator -= p->alpha * push;
        s->error = error + u;
        return u;
    }
    b = -error - s->integrator;
    beyond = fabsf(b) - p->alpha;
    if (beyond <= 0.0f) { /* the copy can be on the sample: it slides */
        s->error = 0.0f;
        s->integrator = -error;
        return -error;
    }
    push = sign(b);
    s->integrator += p->alpha * push;
    /* the positive root of r^2 + lambda r = beyond, in the form that does not cancel */
    u = s->integrator
        + p->lambda * (2.0f * beyond / (p->lambda + sqrtf(p->lambda * p->lambda + 4.0f * beyond))) * push;
    s->error = error + u;
    return u;
}

float law_levant_run(law_levant_state *s, const law_levant *p, float slope, uint32_t elapsed)
{
    float u = s->integrator;

    if (elapsed > LAW_LONGEST_GAP) {
        s->error = 0.0f;
        s->integrator = slope;
        return slope;
    }
    while (elapsed-- > 0)
        u = levant_step(s, p, s->error - slope);
    return p->integrator ? s->integrator : u;
}

float law_kalman_run(law_kalman_state *s, const law_kalman *p, float moved, float slope,
                     float effort_acceleration, uint32_t elapsed)
{
    const float acceleration = effort_acceleration == 0.0f ? s->acceleration : s->acceleration + effort_acceleration;
    float innovation;

    if (elapsed > LAW_LONGEST_GAP) {
        s->offset = 0.0f;
        s->velocity = slope;
        s->acceleration = 0.0f;
        return slope;
    }
    while (elapsed-- > 0) {
        s->offset += s->velocity + 0.5f * acceleration;
        s->velocity += acceleration;
    }
    innovation = moved - s->offset;
    s->velocity += p->gain_velocity * innovation;
    s->offset = (p->gain_position - 1.0f) * innovation;
    s->acceleration += p->gain_acceleration * innovation;
    return s->velocity;
}

/* See rig.control.estimators._disturbance_two_mass. */
float law_two_mass_run(law_two_mass_state *s, const law_two_mass *p, float moved, float slope,
                       float effort_acceleration, uint32_t elapsed)
{
    float half, motor, link, innovation;

    if (elapsed > LAW_LONGEST_GAP) {
        s->offset = s->twist = s->hand = 0.0f;
        s->velocity = s->link = slope;
        return slope;
    }
    while (elapsed-- > 0) {
        half = s->twist + 0.5f * (s->link - s->velocity);
        motor = effort_acceleration + p->spring_motor * half;
        link = s->hand - p->spring_link * half;
        s->offset += s->velocity + 0.5f * motor;
        s->twist += s->link - s->velocity + 0.5f * (link - motor);
        s->velocity += motor;
        s->link += link;
    }
    innovation = moved - s->offset;
    s->offset = (p->gain_position - 1.0f) * innovation;
    s->velocity += p->gain_velocity * innovation;
    s->twist += p->gain_twist * innovation;
    s->link += p->gain_link * innovation;
    s->hand += p->gain_hand * innovation;
    return s->velocity;
}
