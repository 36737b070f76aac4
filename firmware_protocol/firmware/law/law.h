/* The law of one tick, for a device that runs the loop itself: count in, current out.
 *
 * What rig.control.step does in float64 on a host, in integers (rig.control._fixed_wall, to the bit) or in float32. The order of a
 * tick is that of rig.control.step and normative:
 *
 *   1. the count becomes travel along the position, from the reference;
 *   2. the depth inside the wall;
 *   3. when a velocity period begins, the estimator runs, with the periods since its last run;
 *   4. the wall answers this tick's depth and the held velocity;
 *   5. constant effort and excitation, or the homing servo, are added;
 *   6. the guard limits the sum once;
 *   7. the sum is rounded to whole current quanta, to the nearest, halves towards +infinity.
 *
 * Units. The device has no radians: lengths are counts, velocities counts per velocity period, currents quanta of
 * the wire, times ticks. The host scales everything once (the design) and the device only multiplies. What is
 * compared with a count (window, homing tolerance) is a whole count here, so the device decides as the host would.
 *
 * Nothing is allocated, nothing is global: all memory is in law_state, and law_tick is a function of its arguments.
 * The only function of libm is sqrtf, for Levant's estimator. Arithmetic shifts of negative integers are required
 * (gcc and clang have them). Compile with -ffp-contract=off when the results must equal another machine's.
 */
#ifndef LAW_H
#define LAW_H

#include <stdint.h>

enum {
    LAW_LONGEST_WINDOW = 64, /* velocity periods of a FOAW window */
    LAW_RING = 128,          /* samples that FOAW keeps: a power of two above the longest window */
    LAW_SECTIONS = 4         /* of the float32 low pass: order 8 */
};

enum { LAW_DEPTH_BITS = 8 };     /* fractional bits of a depth in the fixed wall (counts) */
enum { LAW_SETPOINT_BITS = 24 }; /* of the homing set point (counts) */
enum { LAW_SLEW_BITS = 15 };     /* of efforts and slew limits in the fixed law's guard (quanta) */
enum { LAW_ENERGY_BITS = 8 };    /* of the passivity observer (quanta) */
enum { LAW_LINE_BITS = 16 };     /* of the excitation, its lines and their sum (quanta) */

typedef enum {
    LAW_FIXED = 0,
    LAW_FLOAT = 1,
    LAW_ELSEWHERE = 2 /* in float32; the drive behind the board renders the effort of the wall itself */
} law_arithmetic;

typedef enum {
    LAW_FDM_BUTTERWORTH_FIXED = 0, /* the only one of the fixed law; serves the float law too */
    LAW_FDM = 1,                   /* this and all below: float32 */
    LAW_FDM_BUTTERWORTH = 2,
    LAW_FOAW_END = 3,
    LAW_FOAW_BEST = 4,
    LAW_LEVANT = 5,
    LAW_KALMAN = 6,
    LAW_TWO_MASS = 7
} law_estimator;

/* Return 1 if an estimator estimates the position, too. */
static inline int law_estimates_position(int32_t estimator)
{
    return estimator == LAW_KALMAN || estimator == LAW_TWO_MASS;
}

typedef enum { LAW_FLOOR = 0, LAW_ZERO = 1, LAW_NEAREST = 2 } law_rounding; /* rig.control._fixed_point.ROUNDINGS */
typedef enum { LAW_HASHED = 0, LAW_SCHROEDER = 1 } law_phases; /* of the excitation's lines */
typedef enum { LAW_EXPLICIT = 0, LAW_SEMI_IMPLICIT = 1, LAW_IMPLICIT = 2 } law_discretisation;

typedef enum { /* rig.core.sample.Phase */
    LAW_WAIT = 0,
    LAW_HOMING = 1,
    LAW_SETTLE = 2,
    LAW_TRIAL = 3,
    LAW_RELEASE = 4,
    LAW_DONE = 5,
    LAW_FREE = 6 /* between settling and trial */
} law_phase;

enum { /* rig.core.sample.RowFlag */
    LAW_INSIDE = 1,
    LAW_VELOCITY_UPDATED = 2,
    LAW_SATURATED = 4,
    LAW_SLEW_BOUND = 8,
    LAW_CLAMPED = 16,
    LAW_NONFINITE = 128,
    LAW_OUT_OF_WINDOW = 256,
    LAW_HOMING_FAILED = 512,
    LAW_ENDS_RUN = LAW_NONFINITE | LAW_OUT_OF_WINDOW | LAW_HOMING_FAILED
};

/* Finite difference and a second-order low pass in integers; rig.control._fixed_point.Biquad describes each. */
typedef struct {
    int32_t b0, b1, b2, a1, a2;
    int32_t coefficient_bits; /* 0 ... 30 */
    int32_t state_bits;       /* fractional bits of input and output, 0 ... 30 */
    int32_t word_bits;        /* of both, 2 ... 32 */
    int32_t rounding;         /* law_rounding */
} law_biquad;

/* One section of the float32 low pass, as two trapezoidal integrators: the transfer function of the bilinear
 * biquad, with a gain at rest of exactly 1 whatever the rounding of the coefficients. Design, from the
 * denominator 1, a1, a2 of a section: g^2 = (1 + a1 + a2)/(1 - a1 + a2), kg = 2 (1 - a2)/(1 - a1 + a2),
 * inner = 1/(1 + kg + g^2), band = g inner, low = g^2 inner. First order (1, a1): low = g/(1 + g) with
 * g = (1 + a1)/(1 - a1). */
typedef struct {
    float inner, band, low;
    int32_t order; /* 1 or 2 */
} law_section;

typedef struct {
    int32_t sections; /* 1 ... LAW_SECTIONS */
    law_section section[LAW_SECTIONS];
} law_low_pass;

/* Adaptive window; windows are decided in integers, so they are the host's to the period. */
typedef struct {
    int32_t band;         /* counts * 2^8 */
    int32_t limit;        /* velocity periods, 1 ... LAW_LONGEST_WINDOW */
    int32_t stop_first;   /* 1: the window before the first that fails; 0: the longest that passes */
    int32_t least_squares; /* best fit: 1 the least-squares intercept, 0 through the newest sample */
} law_foaw;

typedef struct {
    float alpha, lambda; /* counts and periods: alpha T^2/resolution, lambda T/sqrt(resolution) */
    int32_t discretisation;
    int32_t integrator; /* 1: the velocity is u1, 0: u */
} law_levant;

typedef struct {
    float gain_position, gain_velocity, gain_acceleration; /* steady, counts and periods */
    float input; /* acceleration for a quantum of active current: counts per period^2; 0: it knows no effort */
} law_kalman;

/* Disturbance observer of a motor, on which the encoder is, and a link behind a spring; counts and periods. */
typedef struct {
    float spring_motor, spring_link; /* acceleration of each mass for a twist of one count */
    float gain_position, gain_velocity, gain_twist, gain_link, gain_hand;
    float input; /* acceleration of the motor for a quantum of active current */
} law_two_mass;

/* The wall in integers: rig.control._fixed_wall.FixedWall, and what the guard and homing need in the same arithmetic. */
typedef struct {
    int64_t constant;     /* quanta * 2^shift */
    int64_t home_effort;  /* most that the servo gives, quanta * 2^home_shift */
    int32_t trial_slew;   /* quanta * 2^LAW_SLEW_BITS per tick */
    int32_t homing_slew;
    int32_t speed_limit;  /* LSB of the velocity */
    int32_t slow_speed;   /* LSB of the velocity */
    int32_t direction;    /* +1: the wall is entered with rising counts */
    int32_t side;         /* +1: with rising position */
    int32_t surface;      /* counts * 2^LAW_DEPTH_BITS along direction */
    int32_t stiffness;    /* quanta per LSB of depth * 2^shift */
    int32_t damping;      /* quanta per LSB of velocity * 2^shift */
    int32_t shift;        /* 1 ... 40 */
    int32_t home_stiffness; /* quanta per LSB of depth * 2^home_shift */
    int32_t home_damping;   /* quanta per LSB of velocity * 2^home_shift */
    int32_t home_shift;
    int32_t reserved; /* 0: fills the last eight bytes, everywhere alike */
} law_fixed_wall;

/* The wall in float32. The surface is a whole count and a fraction: differences of counts are exact, so that the
 * depth is precise near the surface wherever that lies. */
typedef struct {
    float surface_fraction; /* 0 ... 1 */
    float side;             /* +1.0 or -1.0 */
    float stiffness;        /* quanta per count */
    float damping;          /* quanta per count per velocity period */
    float constant;         /* quanta */
    float trial_slew;       /* quanta per tick */
    float homing_slew;
    float speed_limit;      /* counts per velocity period */
    float slow_speed;
    float velocity_lsb;     /* of LAW_FDM_BUTTERWORTH_FIXED: 2^-state_bits */
    float home_stiffness;   /* quanta per count */
    float home_damping;     /* quanta per count per velocity period */
    float home_effort;      /* quanta */
    float passive_damping;  /* largest of the passivity controller: quanta per count per velocity period; 0: none */
    int32_t surface_whole;  /* counts from the reference, along the position */
} law_float_wall;

/* Excitation: amplitude * sum over j of cos(2 pi (harmonic[j] * t / period + phase[j])), t in ticks since the trial
 * began, harmonic[j] = first + j * step, faded in by a raised cosine. excitation.h has its phases and its table. */
typedef struct {
    uint32_t lines; /* 0: none; at most 4096 */
    uint32_t first, step;
    uint32_t period; /* ticks, 2 ... 2^16; harmonics are below half of it */
    uint32_t ramp;   /* ticks, at most 2^24 */
    uint32_t amplitude; /* of each line: quanta * 2^LAW_LINE_BITS */
    uint32_t bits;   /* of the table: quanta * 2^bits, 0 ... 15 */
    uint32_t phases; /* law_phases */
    uint32_t seed;   /* of hashed phases */
} law_excitation;

typedef struct {
    int64_t home_target; /* counts * 2^LAW_SETPOINT_BITS from the reference, along the position */
    int64_t home_step;   /* the same per tick */
    int32_t arithmetic;  /* law_arithmetic */
    int32_t estimator;   /* law_estimator */
    int32_t reference;   /* count at position zero */
    int32_t sense;       /* +1: the position rises with the count */
    int32_t window_minimum, window_maximum; /* counts from the reference, along the position */
    int32_t home_minimum, home_maximum;     /* at the start: within the tolerance of the target */
    int32_t free_minimum, free_maximum;     /* a handle outside in free space is a false start: no trial follows */
    int32_t current_limit;                  /* quanta */
    int32_t may_pull;   /* 1: the wall may pull a handle that leaves it */
    int32_t entry_only; /* 1: damping acts on the way in only */
    int32_t bilateral;  /* 1: spring and damper on both sides of the surface (for impedances) */
    int32_t extrapolate; /* 1: first-order prediction between velocity samples; float law only */
    int32_t estimated_position; /* 1: the spring sees the estimator's position (law_estimates_position); float law,
                                   velocity_divider 1 */
    uint32_t velocity_divider; /* ticks of a velocity period; 1: uniform */
    uint32_t slow_multiple;    /* velocity periods between samples of a slow handle; 1: every one */
    uint32_t settle_ticks, home_timeout_ticks;
    uint32_t free_ticks;  /* of free space before the trial; 0: none */
    uint32_t trial_ticks; /* of the trial, or of a trial without a contact */
    uint32_t hold_ticks;  /* from the first contact to the end; 0: contact or not, trial_ticks */
    uint32_t release_ticks;
    law_biquad biquad;
    law_low_pass low_pass;
    law_foaw foaw;
    law_levant levant;
    law_kalman kalman;
    law_two_mass two_mass;
    law_float_wall wall;
    law_fixed_wall fixed_wall;
    law_excitation excitation;
} law_parameters;

typedef struct {
    int32_t x1, x2; /* inputs: counts when whole is 2, else in the format of the filter */
    int32_t y1, y2;
    int32_t quick;  /* which short cut is exact for the coefficients (filters.c) */
    int32_t whole;  /* of the last inputs, how many were a few whole counts; at most 2 */
} law_biquad_state;

typedef struct {
    float inner[LAW_SECTIONS], outer[LAW_SECTIONS];
} law_low_pass_state;

typedef struct {
    uint32_t samples; /* kept, at most LAW_RING */
    uint32_t newest;  /* slot */
    uint32_t period;  /* of the newest sample, modulo 2^32 */
    int32_t count[LAW_RING];
    uint32_t taken[LAW_RING]; /* period of each sample */
    int32_t rise[LAW_LONGEST_WINDOW + 1]; /* the window laid out flat, best fit */
    int32_t span[LAW_LONGEST_WINDOW + 1];
} law_foaw_state;

typedef struct {
    float error, integrator;
} law_levant_state;

typedef struct {
    float offset, velocity, acceleration;
} law_kalman_state;

typedef struct {
    float offset, velocity; /* of the motor */
    float twist;            /* link less motor */
    float link;             /* velocity */
    float hand;             /* acceleration of the link by the hand */
} law_two_mass_state;

typedef struct {
    int32_t at;      /* tick of the period; -1 before the first */
    uint32_t rising; /* ticks of the ramp that are left */
    uint32_t rise;   /* of its phase in a tick, 2^-32 turns */
    const int16_t *table; /* one period, quanta * 2^bits */
} law_excitation_state;

typedef struct {
    int64_t setpoint;      /* of the homing servo */
    int64_t wall_energy;   /* that the wall has given: 2^-LAW_ENERGY_BITS quanta times counts */
    int64_t active_sum;    /* current active in each tick since the last estimate, added up (quanta) */
    int32_t limited_fixed; /* last effort before rounding, which the slew limit starts from: quanta * 2^15 */
    float limited;         /* the same in the float law (quanta) */
    float velocity;        /* what the wall sees (float law), positive with rising counts */
    float velocity_sampled; /* the estimate itself */
    float velocity_slope;  /* its change per tick between the last two samples */
    int32_t velocity_fixed; /* the estimate of LAW_FDM_BUTTERWORTH_FIXED (LSB), in either law */
    uint32_t window;       /* velocity periods that the estimate spans */
    uint32_t since;        /* ticks since the velocity period of the last estimate began */
    uint32_t velocity_ticks; /* ticks since the last estimate */
    uint32_t sampled;      /* 1 once the estimator has run */
    uint32_t phase;        /* law_phase */
    uint32_t phase_ticks, rest_ticks;
    uint32_t contact_ticks; /* of the trial before the first contact; 0: none yet */
    uint32_t release_share, release_rest; /* of the effort, 2^-15, in the fixed law: quotient and remainder */
    uint32_t release_step, release_step_rest; /* of the share, in a tick */
    int32_t previous;      /* count of the last estimate */
    int32_t travel;        /* of the last tick */
    uint32_t flags;
    union {
        law_biquad_state biquad;
        law_low_pass_state low_pass;
        law_foaw_state foaw;
        law_levant_state levant;
        law_kalman_state kalman;
        law_two_mass_state two_mass;
    } of;
    law_excitation_state excitation; /* at the end: its pointer has another size elsewhere */
} law_state;

typedef struct {
    int32_t count;          /* of the encoder, may wrap */
    uint32_t elapsed_ticks; /* since the previous call, 1 when none was missed */
    int32_t active;         /* current that was active when the count was taken (quanta); stands for all elapsed ticks */
} law_input;

typedef struct {
    int32_t current; /* to command (quanta), within current_limit and 16 bits */
    uint32_t flags;
    uint32_t phase; /* law_phase of this tick */
} law_output;

/* Reason why parameters are rejected; 0: accepted. With accepted parameters no arithmetic of law_tick overflows. */
typedef enum {
    LAW_GOOD = 0,
    LAW_BAD_CHOICE,   /* an invalid value of an enumeration or a sign, or a combination that does not exist */
    LAW_BAD_RATE,     /* dividers and multiples from 1 to 2^16 */
    LAW_BAD_LIMIT,    /* current limit, window, slew, homing */
    LAW_BAD_FILTER,   /* word lengths, sections, window, or products that leave 64 bits */
    LAW_BAD_WALL,     /* gains or sums that leave 64 bits, or a shift */
    LAW_BAD_EXCITATION /* lines, harmonics, period, amplitude, format */
} law_verdict;

law_verdict law_check(const law_parameters *p);

/* The same of the wall alone, when nothing else has changed since. */
law_verdict law_check_wall(const law_parameters *p);

/* Reset to the state before the first sample. The parameters must have passed law_check. `table` is what law_excitation_continue has
 * completed; it must live as long, and may be NULL when there are no lines. */
void law_reset(law_state *s, const law_parameters *p, const int16_t *table);

/* One tick. A wall or a limit may change between two ticks; another estimator or excitation needs law_reset. */
law_output law_tick(law_state *s, const law_parameters *p, const law_input *in);

/* Return true if a handle at this count is inside the wall. */
int law_inside(const law_parameters *p, int32_t count);

/* Return true if the wall may be changed or switched on at this count: the handle is outside of it. A bilateral wall has
 * no such count, since its spring acts on both sides. */
int law_is_free(const law_parameters *p, int32_t count);

#endif
