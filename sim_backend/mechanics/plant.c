#include "plant.h"

#include <math.h>

/* Matrices of a plant with `order` states and its two inputs and `masses` frictions. */
#define PHI(row, column) phi[(row) * order + (column)]
#define GAMMA(row, column) gamma[(row) * inputs + (column)]

static inline double clip(double value, double limit)
{
    return value < -limit ? -limit : value > limit ? limit : value;
}

static inline int64_t cell(double position, const double *p)
{
    const double cells = position / p[RESOLUTION] + p[OFFSET];
    const int64_t whole = (int64_t)cells;
    return whole - (cells < (double)whole);
}

/* Coulomb friction on a mass, and its velocity after a step: exactly zero if it comes to rest. */
static inline double rub_one(double free, double gain, double coulomb, double *velocity)
{
    double friction = free * (-1.0 / gain);
    if (fabs(friction) <= coulomb) {
        *velocity = 0.0;
        return friction;
    }
    friction = clip(friction, coulomb);
    *velocity = free + gain * friction;
    return friction;
}

struct rubbed {
    double motor, link;       /* friction */
    double v_motor, v_link;   /* velocities after the step */
};

static inline struct rubbed rub_both(double free_motor, double free_link, double gain_motor, double gain_cross,
                                     double gain_link, double coulomb_motor, double coulomb_link)
{
    const double shrink = -1.0 / (gain_motor * gain_link - gain_cross * gain_cross);
    const double motor = shrink * (gain_link * free_motor - gain_cross * free_link);
    const double link = shrink * (gain_motor * free_link - gain_cross * free_motor);
    struct rubbed r = {motor, link, 0.0, 0.0};
    if (fabs(motor) <= coulomb_motor && fabs(link) <= coulomb_link)
        return r;
    if (fabs(motor) > coulomb_motor) {
        r.motor = clip(motor, coulomb_motor);
        r.link = rub_one(free_link + gain_cross * r.motor, gain_link, coulomb_link, &r.v_link);
        r.v_motor = free_motor + gain_motor * r.motor + gain_cross * r.link;
        if (r.motor * r.v_motor <= 0.0)
            return r;
    }
    r.link = clip(link, coulomb_link);
    r.motor = rub_one(free_motor + gain_cross * r.link, gain_motor, coulomb_motor, &r.v_motor);
    r.v_link = free_link + gain_cross * r.motor + gain_link * r.link;
    return r;
}

/* Follow the encoder over a step from `before` to `after`: its cell, and the age of the last edge. */
static inline void encode(int64_t *count, double *age, double before, double after, const double *p)
{
    const int64_t next = cell(after, p);
    if (next == *count) {
        *age += p[STEP_S];
        return;
    }
    const double edge = (double)(next > *count ? next : next + 1);
    const double left = (after - (edge - p[OFFSET]) * p[RESOLUTION]) / (after - before);
    *age = (left < 0.0 ? 0.0 : left > 1.0 ? 1.0 : left) * p[STEP_S];
    *count = next;
}

static int64_t advance_rigid(double *s, const double *phi, const double *gamma, const double *p, double command,
                             double external)
{
    enum { order = RIGID_ORDER, inputs = 3 };
    double x = s[0], v = s[1], effort = s[2], age = s[3];
    const double push_x = GAMMA(0, 0) * command + GAMMA(0, 1) * external;
    const double push_v = GAMMA(1, 0) * command + GAMMA(1, 1) * external;
    const double push_e = GAMMA(2, 0) * command + GAMMA(2, 1) * external;
    int64_t count = cell(x, p);
    for (int64_t n = (int64_t)p[STEPS]; n > 0; n--) {
        const double free = PHI(1, 1) * v + PHI(1, 2) * effort + push_v;
        double v_next, x_next = x;
        const double friction = rub_one(free, GAMMA(1, 2), p[COULOMB], &v_next);
        if (v != 0.0 || v_next != 0.0)
            x_next += PHI(0, 1) * v + PHI(0, 2) * effort + push_x + GAMMA(0, 2) * friction;
        encode(&count, &age, x, x_next, p);
        effort = PHI(2, 1) * v + PHI(2, 2) * effort + push_e + GAMMA(2, 2) * friction;
        x = x_next, v = v_next;
    }
    s[0] = x, s[1] = v, s[2] = effort, s[3] = age;
    return count;
}

static int64_t advance_two_mass(double *s, const double *phi, const double *gamma, const double *p, double command,
                                double external)
{
    enum { order = TWO_MASS_ORDER, inputs = 4 };
    double x = s[0], v = s[1], y = s[2], w = s[3], effort = s[4], age = s[5]; /* motor, link */
    double push[order];
    for (int i = 0; i < order; i++)
        push[i] = GAMMA(i, 0) * command + GAMMA(i, 1) * external;
    int64_t count = cell(x, p);
    for (int64_t n = (int64_t)p[STEPS]; n > 0; n--) {
        const double stretch = y - x;
        const double free_v = PHI(1, 1) * v + PHI(1, 2) * stretch + PHI(1, 3) * w + PHI(1, 4) * effort + push[1];
        const double free_w = PHI(3, 1) * v + PHI(3, 2) * stretch + PHI(3, 3) * w + PHI(3, 4) * effort + push[3];
        const struct rubbed r = rub_both(free_v, free_w, GAMMA(1, 2), GAMMA(3, 2), GAMMA(3, 3), p[COULOMB],
                                         p[COULOMB_LINK]);
        double x_next = x, y_next = y;
        if (v != 0.0 || r.v_motor != 0.0) {
            x_next += PHI(0, 1) * v + PHI(0, 2) * stretch + PHI(0, 3) * w + PHI(0, 4) * effort + push[0];
            x_next += GAMMA(0, 2) * r.motor + GAMMA(0, 3) * r.link;
        }
        if (w != 0.0 || r.v_link != 0.0) {
            y_next += PHI(2, 1) * v - PHI(2, 0) * stretch + PHI(2, 3) * w + PHI(2, 4) * effort + push[2];
            y_next += GAMMA(2, 2) * r.motor + GAMMA(2, 3) * r.link;
        }
        encode(&count, &age, x, x_next, p);
        effort = PHI(4, 1) * v + PHI(4, 2) * stretch + PHI(4, 3) * w + PHI(4, 4) * effort + push[4];
        effort += GAMMA(4, 2) * r.motor + GAMMA(4, 3) * r.link;
        x = x_next, v = r.v_motor, y = y_next, w = r.v_link;
    }
    s[0] = x, s[1] = v, s[2] = y, s[3] = w, s[4] = effort, s[5] = age;
    return count;
}

/* In a hand: inputs are held over a tick, and so are the last two states, its intended velocity and its press. */
static double hand_push(const double *phi, const double *gamma, int order, int inputs, int row, double command,
                        double external, double velocity, double press)
{
    const double hand = PHI(row, order - 2) * velocity + PHI(row, order - 1) * press;
    return GAMMA(row, 0) * command + GAMMA(row, 1) * external + hand;
}

static int64_t advance_rigid_held(double *s, const double *phi, const double *gamma, const double *p, double command,
                                  double external)
{
    enum { order = RIGID_ORDER + HAND_ORDER, inputs = 3 };
    double x = s[0], v = s[1], effort = s[2], h = s[3], g = s[4]; /* link, motor effort, hand */
    const double goal = s[5];
    double age = s[8], push[5];
    for (int i = 0; i < 5; i++)
        push[i] = hand_push(phi, gamma, order, inputs, i, command, external, s[6], s[7]);
    int64_t count = cell(x, p);
    for (int64_t n = (int64_t)p[STEPS]; n > 0; n--) {
        const double grip = h - x, wish = goal - x, want = goal - h;
        const double free = PHI(1, 1) * v + PHI(1, 2) * effort + PHI(1, 4) * g + PHI(1, 3) * grip + PHI(1, 5) * wish
                            + push[1];
        double v_next, x_next = x;
        const double friction = rub_one(free, GAMMA(1, 2), p[COULOMB], &v_next);
        if (v != 0.0 || v_next != 0.0) {
            x_next += PHI(0, 1) * v + PHI(0, 2) * effort + PHI(0, 4) * g + PHI(0, 3) * grip + PHI(0, 5) * wish;
            x_next += push[0] + GAMMA(0, 2) * friction;
        }
        const double h_next =
            PHI(3, 1) * v + PHI(3, 2) * effort + PHI(3, 4) * g - PHI(3, 0) * grip + PHI(3, 5) * want;
        const double g_next =
            PHI(4, 1) * v + PHI(4, 2) * effort + PHI(4, 4) * g - PHI(4, 0) * grip + PHI(4, 5) * want;
        effort = PHI(2, 1) * v + PHI(2, 2) * effort + PHI(2, 4) * g + PHI(2, 3) * grip + PHI(2, 5) * wish;
        effort += push[2] + GAMMA(2, 2) * friction;
        h += h_next + push[3] + GAMMA(3, 2) * friction;
        g = g_next + push[4] + GAMMA(4, 2) * friction;
        encode(&count, &age, x, x_next, p);
        x = x_next, v = v_next;
    }
    s[0] = x, s[1] = v, s[2] = effort, s[3] = h, s[4] = g, s[8] = age;
    return count;
}

static int64_t advance_two_mass_held(double *s, const double *phi, const double *gamma, const double *p,
                                     double command, double external)
{
    enum { order = TWO_MASS_ORDER + HAND_ORDER, inputs = 4 };
    double x = s[0], v = s[1], y = s[2], w = s[3], effort = s[4]; /* motor, link, motor effort */
    double h = s[5], g = s[6];                                    /* hand */
    const double goal = s[7];
    double age = s[10], push[7];
    for (int i = 0; i < 7; i++)
        push[i] = hand_push(phi, gamma, order, inputs, i, command, external, s[8], s[9]);
    int64_t count = cell(x, p);
#define CARRY(row) (PHI(row, 1) * v + PHI(row, 3) * w + PHI(row, 4) * effort + PHI(row, 6) * g)
    for (int64_t n = (int64_t)p[STEPS]; n > 0; n--) {
        const double stretch = y - x, reach = h - x, far = goal - x; /* as seen from the motor */
        const double grip = h - y, wish = goal - y, want = goal - h; /* from the link; from the hand */
        double free_v = PHI(1, 2) * stretch + PHI(1, 5) * reach + PHI(1, 7) * far;
        free_v += CARRY(1) + push[1];
        double free_w = PHI(3, 5) * grip + PHI(3, 7) * wish - PHI(3, 0) * stretch;
        free_w += CARRY(3) + push[3];
        const struct rubbed r = rub_both(free_v, free_w, GAMMA(1, 2), GAMMA(3, 2), GAMMA(3, 3), p[COULOMB],
                                         p[COULOMB_LINK]);
        double x_next = x, y_next = y;
        if (v != 0.0 || r.v_motor != 0.0) {
            x_next += PHI(0, 2) * stretch + PHI(0, 5) * reach + PHI(0, 7) * far;
            x_next += CARRY(0) + push[0] + GAMMA(0, 2) * r.motor + GAMMA(0, 3) * r.link;
        }
        if (w != 0.0 || r.v_link != 0.0) {
            y_next += PHI(2, 5) * grip + PHI(2, 7) * wish - PHI(2, 0) * stretch;
            y_next += CARRY(2) + push[2] + GAMMA(2, 2) * r.motor + GAMMA(2, 3) * r.link;
        }
        double h_next = PHI(5, 7) * want - PHI(5, 2) * grip - PHI(5, 0) * reach;
        const double g_next = PHI(6, 7) * want - PHI(6, 2) * grip - PHI(6, 0) * reach;
        h_next += CARRY(5) + push[5] + GAMMA(5, 2) * r.motor + GAMMA(5, 3) * r.link;
        double e_next = PHI(4, 2) * stretch + PHI(4, 5) * reach + PHI(4, 7) * far;
        e_next += CARRY(4) + push[4] + GAMMA(4, 2) * r.motor + GAMMA(4, 3) * r.link;
        g = g_next + CARRY(6) + push[6] + GAMMA(6, 2) * r.motor + GAMMA(6, 3) * r.link;
        h += h_next;
        effort = e_next;
        encode(&count, &age, x, x_next, p);
        x = x_next, v = r.v_motor, y = y_next, w = r.v_link;
    }
#undef CARRY
    s[0] = x, s[1] = v, s[2] = y, s[3] = w, s[4] = effort;
    s[5] = h, s[6] = g, s[10] = age;
    return count;
}

int64_t plant_count(const struct plant *plant)
{
    const int64_t count = cell(plant->state[0], plant->parameters);
    return plant->parameters[SIGN] < 0.0 ? -count : count;
}

int64_t plant_advance(const struct plant *plant, double command, double external)
{
    const double *phi = plant->phi, *gamma = plant->gamma, *p = plant->parameters;
    double *s = plant->state, *waiting = s + plant->order + 1;
    double active = command;
    if (plant->delay_ticks > 0) {
        active = waiting[0];
        for (int i = 1; i < plant->delay_ticks; i++)
            waiting[i - 1] = waiting[i];
        waiting[plant->delay_ticks - 1] = command;
    }
    active = clip(active, p[EFFORT_LIMIT]);
    external += p[GRAVITY_EFFORT];
    const int64_t count = plant->order == RIGID_ORDER      ? advance_rigid(s, phi, gamma, p, active, external)
                          : plant->order == TWO_MASS_ORDER ? advance_two_mass(s, phi, gamma, p, active, external)
                          : plant->order == RIGID_ORDER + HAND_ORDER
                              ? advance_rigid_held(s, phi, gamma, p, active, external)
                              : advance_two_mass_held(s, phi, gamma, p, active, external);
    return p[SIGN] < 0.0 ? -count : count;
}
