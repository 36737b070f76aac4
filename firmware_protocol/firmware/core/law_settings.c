#include "law_settings.h"

#include "bytes.h"

/* Values are only copied: the host has scaled them to counts, ticks and quanta. Values that the chosen law does not read
 * are copied too; their ranges were checked. */

static int32_t whole(const uint32_t *values, enum hr_parameter_index index)
{
    return signed_32(values[index]);
}

static float real(const uint32_t *values, enum hr_parameter_index index)
{
    return value_as_float(values[index]);
}

/* Join two halves to a number of 64 bits. */
static int64_t wide(const uint32_t *values, enum hr_parameter_index high, enum hr_parameter_index low)
{
    return whole(values, high) * (INT64_C(1) << 32) + (int64_t)values[low];
}

static law_biquad read_biquad(const uint32_t *values)
{
    const law_biquad biquad = {
        .b0 = whole(values, HR_PARAMETER_BIQUAD_B0),
        .b1 = whole(values, HR_PARAMETER_BIQUAD_B1),
        .b2 = whole(values, HR_PARAMETER_BIQUAD_B2),
        .a1 = whole(values, HR_PARAMETER_BIQUAD_A1),
        .a2 = whole(values, HR_PARAMETER_BIQUAD_A2),
        .coefficient_bits = whole(values, HR_PARAMETER_BIQUAD_COEFFICIENT_BITS),
        .state_bits = whole(values, HR_PARAMETER_BIQUAD_STATE_BITS),
        .word_bits = whole(values, HR_PARAMETER_BIQUAD_WORD_BITS),
        .rounding = whole(values, HR_PARAMETER_BIQUAD_ROUNDING),
    };
    return biquad;
}

/* Copy the sections of the low pass: of second order, and a last one of first order if the order is odd. */
static law_low_pass read_low_pass(const uint32_t *values)
{
    const int32_t order = whole(values, HR_PARAMETER_LOW_PASS_ORDER);
    law_low_pass low_pass = {.sections = (order + 1) / 2};
    for (int32_t i = 0; i < LAW_SECTIONS; i++) {
        law_section *section = &low_pass.section[i];
        section->inner = value_as_float(values[HR_PARAMETER_LOW_PASS_INNER_1 + i]);
        section->band = value_as_float(values[HR_PARAMETER_LOW_PASS_BAND_1 + i]);
        section->low = value_as_float(values[HR_PARAMETER_LOW_PASS_LOW_1 + i]);
        section->order = 2 * (i + 1) <= order ? 2 : 1;
    }
    return low_pass;
}

static void read_estimator(const uint32_t *values, law_parameters *law)
{
    law->estimator = whole(values, HR_PARAMETER_ESTIMATOR);
    law->biquad = read_biquad(values);
    law->low_pass = read_low_pass(values);
    law->foaw.band = whole(values, HR_PARAMETER_FOAW_BAND);
    law->foaw.limit = whole(values, HR_PARAMETER_FOAW_LIMIT);
    law->foaw.stop_first = whole(values, HR_PARAMETER_FOAW_STOP_FIRST);
    law->foaw.least_squares = whole(values, HR_PARAMETER_FOAW_LEAST_SQUARES);
    law->levant.alpha = real(values, HR_PARAMETER_LEVANT_ALPHA);
    law->levant.lambda = real(values, HR_PARAMETER_LEVANT_LAMBDA);
    law->levant.discretisation = whole(values, HR_PARAMETER_LEVANT_DISCRETISATION);
    law->levant.integrator = whole(values, HR_PARAMETER_LEVANT_INTEGRATOR);
    law->kalman.gain_position = real(values, HR_PARAMETER_KALMAN_POSITION);
    law->kalman.gain_velocity = real(values, HR_PARAMETER_KALMAN_VELOCITY);
    law->kalman.gain_acceleration = real(values, HR_PARAMETER_KALMAN_ACCELERATION);
    law->kalman.input = real(values, HR_PARAMETER_KALMAN_INPUT);
    law->two_mass.spring_motor = real(values, HR_PARAMETER_TWO_MASS_SPRING_MOTOR);
    law->two_mass.spring_link = real(values, HR_PARAMETER_TWO_MASS_SPRING_LINK);
    law->two_mass.gain_position = real(values, HR_PARAMETER_TWO_MASS_GAIN_POSITION);
    law->two_mass.gain_velocity = real(values, HR_PARAMETER_TWO_MASS_GAIN_VELOCITY);
    law->two_mass.gain_twist = real(values, HR_PARAMETER_TWO_MASS_GAIN_TWIST);
    law->two_mass.gain_link = real(values, HR_PARAMETER_TWO_MASS_GAIN_LINK);
    law->two_mass.gain_hand = real(values, HR_PARAMETER_TWO_MASS_GAIN_HAND);
    law->two_mass.input = real(values, HR_PARAMETER_TWO_MASS_INPUT);
}

static void read_live_float(const uint32_t *values, law_float_wall *wall)
{
    wall->surface_whole = whole(values, HR_PARAMETER_FLOAT_SURFACE);
    wall->surface_fraction = real(values, HR_PARAMETER_FLOAT_SURFACE_FRACTION);
    wall->stiffness = real(values, HR_PARAMETER_FLOAT_STIFFNESS);
    wall->damping = real(values, HR_PARAMETER_FLOAT_DAMPING);
}

static void read_live_fixed(const uint32_t *values, law_fixed_wall *wall)
{
    wall->surface = whole(values, HR_PARAMETER_FIXED_SURFACE);
    wall->stiffness = whole(values, HR_PARAMETER_FIXED_STIFFNESS);
    wall->damping = whole(values, HR_PARAMETER_FIXED_DAMPING);
    wall->shift = whole(values, HR_PARAMETER_FIXED_SHIFT);
    wall->constant = wide(values, HR_PARAMETER_FIXED_CONSTANT_HIGH, HR_PARAMETER_FIXED_CONSTANT_LOW);
}

static void read_float_wall(const uint32_t *values, law_float_wall *wall)
{
    read_live_float(values, wall);
    wall->side = (float)whole(values, HR_PARAMETER_WALL_SIDE);
    wall->constant = real(values, HR_PARAMETER_FLOAT_CONSTANT);
    wall->trial_slew = real(values, HR_PARAMETER_FLOAT_TRIAL_SLEW);
    wall->homing_slew = real(values, HR_PARAMETER_FLOAT_HOMING_SLEW);
    wall->speed_limit = real(values, HR_PARAMETER_FLOAT_SPEED_LIMIT);
    wall->slow_speed = real(values, HR_PARAMETER_FLOAT_SLOW_SPEED);
    wall->velocity_lsb = real(values, HR_PARAMETER_FLOAT_VELOCITY_LSB);
    wall->home_stiffness = real(values, HR_PARAMETER_FLOAT_HOME_STIFFNESS);
    wall->home_damping = real(values, HR_PARAMETER_FLOAT_HOME_DAMPING);
    wall->home_effort = real(values, HR_PARAMETER_FLOAT_HOME_EFFORT);
    wall->passive_damping = real(values, HR_PARAMETER_FLOAT_PASSIVE_DAMPING);
}

static void read_fixed_wall(const uint32_t *values, int32_t sense, law_fixed_wall *wall)
{
    read_live_fixed(values, wall);
    wall->side = whole(values, HR_PARAMETER_WALL_SIDE);
    wall->direction = wall->side * sense;
    wall->trial_slew = whole(values, HR_PARAMETER_FIXED_TRIAL_SLEW);
    wall->homing_slew = whole(values, HR_PARAMETER_FIXED_HOMING_SLEW);
    wall->speed_limit = whole(values, HR_PARAMETER_FIXED_SPEED_LIMIT);
    wall->slow_speed = whole(values, HR_PARAMETER_FIXED_SLOW_SPEED);
    wall->home_stiffness = whole(values, HR_PARAMETER_FIXED_HOME_STIFFNESS);
    wall->home_damping = whole(values, HR_PARAMETER_FIXED_HOME_DAMPING);
    wall->home_shift = whole(values, HR_PARAMETER_FIXED_HOME_SHIFT);
    wall->home_effort = wide(values, HR_PARAMETER_FIXED_HOME_EFFORT_HIGH, HR_PARAMETER_FIXED_HOME_EFFORT_LOW);
    wall->reserved = 0;
}

static void read_phases(const uint32_t *values, law_parameters *law)
{
    law->home_target = whole(values, HR_PARAMETER_HOME_TARGET) * (INT64_C(1) << LAW_SETPOINT_BITS)
                       + (int64_t)values[HR_PARAMETER_HOME_TARGET_FRACTION];
    law->home_step = (int64_t)values[HR_PARAMETER_HOME_STEP];
    law->home_minimum = whole(values, HR_PARAMETER_HOME_MINIMUM);
    law->home_maximum = whole(values, HR_PARAMETER_HOME_MAXIMUM);
    law->settle_ticks = values[HR_PARAMETER_SETTLE_TICKS];
    law->home_timeout_ticks = values[HR_PARAMETER_HOME_TIMEOUT_TICKS];
    law->free_ticks = values[HR_PARAMETER_FREE_TICKS];
    law->free_minimum = whole(values, HR_PARAMETER_FREE_MINIMUM);
    law->free_maximum = whole(values, HR_PARAMETER_FREE_MAXIMUM);
    law->trial_ticks = values[HR_PARAMETER_TRIAL_TICKS];
    law->hold_ticks = values[HR_PARAMETER_HOLD_TICKS];
    law->release_ticks = values[HR_PARAMETER_RELEASE_TICKS];
}

static void read_excitation(const uint32_t *values, law_excitation *excitation)
{
    excitation->lines = values[HR_PARAMETER_EXCITATION_LINES];
    excitation->first = values[HR_PARAMETER_EXCITATION_FIRST];
    excitation->step = values[HR_PARAMETER_EXCITATION_STEP];
    excitation->period = values[HR_PARAMETER_EXCITATION_PERIOD];
    excitation->ramp = values[HR_PARAMETER_EXCITATION_RAMP];
    excitation->amplitude = values[HR_PARAMETER_EXCITATION_AMPLITUDE];
    excitation->bits = values[HR_PARAMETER_EXCITATION_BITS];
    excitation->phases = values[HR_PARAMETER_EXCITATION_PHASES];
    excitation->seed = values[HR_PARAMETER_EXCITATION_SEED];
}

/* Return the parameter to report for a rejected law. */
static enum hr_parameter_index subject(law_verdict verdict, const law_parameters *law)
{
    switch (verdict) {
    case LAW_BAD_RATE:
        return HR_PARAMETER_VELOCITY_DIVIDER;
    case LAW_BAD_LIMIT:
        return law->window_minimum > law->window_maximum ? HR_PARAMETER_LAW_WINDOW_MAXIMUM
                                                         : HR_PARAMETER_HOME_MAXIMUM;
    case LAW_BAD_FILTER:
        return law->estimator == LAW_FDM_BUTTERWORTH_FIXED ? HR_PARAMETER_BIQUAD_B0 : HR_PARAMETER_FOAW_BAND;
    case LAW_BAD_WALL:
        return law->arithmetic == LAW_FIXED ? HR_PARAMETER_FIXED_STIFFNESS : HR_PARAMETER_FLOAT_STIFFNESS;
    case LAW_BAD_EXCITATION:
        return HR_PARAMETER_EXCITATION_LINES;
    case LAW_BAD_CHOICE:
    case LAW_GOOD:
    default:
        return HR_PARAMETER_ESTIMATOR;
    }
}

static struct refusal inconsistent(enum hr_parameter_index index)
{
    const struct refusal refusal = {HR_STATUS_INCONSISTENT, hr_parameters[index].id};
    return refusal;
}

static bool is_rendered(const uint32_t *values, const struct hal *hal, const law_parameters *law)
{
    return law->arithmetic != LAW_ELSEWHERE
           || (hal->renders != NULL && hal->renders(hal->context, law, values[HR_PARAMETER_POSITION_RATE]));
}

static struct refusal refusal_of(law_verdict verdict, const uint32_t *values, const struct hal *hal,
                                 const law_parameters *law)
{
    const struct refusal accepted = {HR_STATUS_OK, 0};
    if (verdict == LAW_GOOD && !is_rendered(values, hal, law))
        return inconsistent(HR_PARAMETER_FLOAT_STIFFNESS);
    return verdict == LAW_GOOD ? accepted : inconsistent(subject(verdict, law));
}

struct refusal law_settings_read_wall(const uint32_t *values, const struct hal *hal, law_parameters *law)
{
    read_live_float(values, &law->wall);
    read_live_fixed(values, &law->fixed_wall);
    return refusal_of(law_check_wall(law), values, hal, law);
}

static int32_t arithmetic_of(uint32_t choice)
{
    return choice == LAW_IN_INTEGERS ? LAW_FIXED : choice == LAW_IN_FLOAT ? LAW_FLOAT : LAW_ELSEWHERE;
}

struct refusal law_settings_read(const uint32_t *values, const struct board *board, const struct hal *hal,
                                 law_parameters *law)
{
    const bool excites = values[HR_PARAMETER_EXCITATION_LINES] > 0;
    if (excites && values[HR_PARAMETER_EXCITATION_PERIOD] > board->excitation_length)
        return inconsistent(HR_PARAMETER_EXCITATION_PERIOD);
    *law = (law_parameters){0};
    law->arithmetic = arithmetic_of(values[HR_PARAMETER_LAW]);
    law->reference = whole(values, HR_PARAMETER_REFERENCE_COUNT);
    law->sense = board->encoder_sign;
    law->window_minimum = whole(values, HR_PARAMETER_LAW_WINDOW_MINIMUM);
    law->window_maximum = whole(values, HR_PARAMETER_LAW_WINDOW_MAXIMUM);
    law->current_limit = whole(values, HR_PARAMETER_CURRENT_LIMIT);
    law->may_pull = whole(values, HR_PARAMETER_WALL_PULL);
    law->entry_only = whole(values, HR_PARAMETER_DAMPING_ON_ENTRY);
    law->bilateral = whole(values, HR_PARAMETER_BILATERAL);
    law->extrapolate = whole(values, HR_PARAMETER_EXTRAPOLATE);
    law->estimated_position = whole(values, HR_PARAMETER_ESTIMATED_POSITION);
    law->velocity_divider = values[HR_PARAMETER_VELOCITY_DIVIDER];
    law->slow_multiple = values[HR_PARAMETER_SLOW_MULTIPLE];
    read_phases(values, law);
    read_estimator(values, law);
    read_float_wall(values, &law->wall);
    read_fixed_wall(values, law->sense, &law->fixed_wall);
    read_excitation(values, &law->excitation);
    return refusal_of(law_check(law), values, hal, law);
}
