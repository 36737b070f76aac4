/* An excited run once more in C, as a careful programmer writes it for one rigid rig, one estimator and the bilateral wall: the
   yardstick of test_impedance.py. Estimator, guard and encoder are those of trial.c. The results are the same to the last
   bit. */
#include "trial.c"

static inline int64_t advance_inner(double *s, const double (*phi)[3], const double (*gamma)[3], const double *p,
    double command, double external)
{
    const struct plant plant = {3, 0, *phi, *gamma, p, s};
    return plant_advance(&plant, command, external);
}

static inline double ramp(int64_t tick, int64_t ticks)
{
    return tick >= ticks ? 1.0 : 0.5 - 0.5 * cos(3.141592653589793 * (double)tick / (double)ticks);
}

/* Until the guard ends it or n ticks are over; returns their number. */
int64_t excite(const struct control *control, const double *estimator, const double *wall,
    const double (*phi)[3], const double (*gamma)[3], const double *plant, double *state,
    const double *excitation, int64_t *counts, double *positions, double *velocities, double *withheld,
    int64_t period, int64_t ramp_steps, int64_t n, int64_t ratio, int64_t every)
{
    const struct control *c = control;
    struct memory m = {.index = -1, .velocity_period = -1, .phase = TRIAL};
    struct difference d = {0};
    int64_t count = 0, j = 0, row = 0, phase = 0;
    for (int64_t k = 0; k < n; k++) {
        m.flags = 0;
        m.index++;
        m.position = c->resolution * (double)count_difference(count, c->reference_count);
        m.penetration = c->wall_side * (m.position - c->wall_position);
        int64_t elapsed = m.index / c->velocity_divider - m.velocity_period;
        if (elapsed >= 1) {
            m.velocity_period += elapsed;
            m.velocity = estimate(count, elapsed, &d, estimator);
        }
        double reaction = wall[STIFFNESS] * m.penetration + wall[DAMPING] * (c->wall_side * m.velocity);
        double wanted = c->constant_effort - c->wall_side * reaction;
        double effort = (double)guarded(c, &m, wanted) * c->effort_quantum;
        if (m.phase != TRIAL)
            return k;
        withheld[k] = effort - wanted;
        for (int64_t i = 0; i < ratio; i++) {
            if (row * every == j) {
                counts[row] = count;
                positions[row] = state[0];
                velocities[row] = state[1];
                row++;
            }
            double push = excitation[phase];
            if (j < ramp_steps)
                push *= ramp(j, ramp_steps);
            count = advance_inner(state, phi, gamma, plant, effort, push);
            j++;
            if (++phase == period)
                phase = 0;
        }
    }
    return n;
}
