"""List the parameters of the control law that runs on the device, in the device's own units.

The host designs the law and its filters (`rig.config.device_law`); the device only computes with the resulting numbers.
Lengths are encoder counts, velocities counts per velocity period, currents quanta, times ticks; see firmware/law/law.h.
`firmware_protocol.parameters` joins them to its list. An id must not be reused: it identifies the parameter in
messages.
"""

from firmware_protocol.parameter import Parameter, Value

_FIRST_ID = 32
_I32 = (-(2**31), 2**31 - 1)
_U32 = (0, 2**32 - 1)
_FLOAT = (-(2.0**30), 2.0**30)
_POSITIVE = (0.0, 2.0**30)
_SECTIONS = 4
_Row = tuple[str, str, str, tuple[Value, Value], Value, str, bool]


def _rows() -> list[_Row]:
    """Return (name, C type, unit, range, default, meaning, may change while armed) of each law parameter by id."""
    fixed = False
    rows: list[_Row] = [
        ("law", "u8", "", (0, 3), 0,
         "place of the law: 0 host; device: 1 integers, 2 float32, 3 float32 and a wall by the drive", fixed),
        ("batch_layout", "u8", "", (0, 2), 0, "layout of BATCH (BATCH_LAYOUTS)", fixed),
        ("batch_samples", "u8", "tick", (1, 76), 45, "largest number of samples in a frame", fixed),
        ("estimator", "u8", "", (0, 7), 0, "0 fdm-butterworth in integers; 1 fdm, 2 fdm-butterworth, "
         "3 foaw-end, 4 foaw-best, 5 levant, 6 kalman, 7 disturbance-two-mass", fixed),
        ("velocity_divider", "u16", "tick", (1, 1_000), 1, "the velocity is sampled every N ticks, T2 = N T1", fixed),
        ("extrapolate", "u8", "", (0, 1), 0, "1: first-order prediction between velocity samples; float32 only", fixed),
        ("wall_side", "i8", "", (-1, 1), 1, "+1: the wall fills the positions above its surface, -1: below", fixed),
        ("wall_pull", "u8", "", (0, 1), 0, "0: the wall only pushes (effort clamped at zero), 1: it may pull", fixed),
        ("damping_on_entry", "u8", "", (0, 1), 0, "1: damping acts on the way in only", fixed),
        ("bilateral", "u8", "", (0, 1), 0, "1: spring and damper on both sides of the surface", fixed),
        ("slow_multiple", "u16", "", (1, 65_535), 1, "velocity periods between samples of a slow handle", fixed),
        ("settle_ticks", "u32", "tick", _U32, 0, "how long the handle must rest at the start", fixed),
        ("home_timeout_ticks", "u32", "tick", _U32, 0, "homing fails after this time", fixed),
        ("trial_ticks", "u32", "tick", _U32, 0, "length of the trial", fixed),
        ("release_ticks", "u32", "tick", (1, _U32[1]), 1, "duration of the ramp to zero effort after the trial", fixed),
        ("law_window_minimum", "i32", "count", _I32, 0, "position from the reference", fixed),
        ("law_window_maximum", "i32", "count", _I32, 0, "position from the reference", fixed),
        ("home_minimum", "i32", "count", _I32, 0, "range that counts as the start", fixed),
        ("home_maximum", "i32", "count", _I32, 0, "range that counts as the start", fixed),
        ("home_target", "i32", "count", _I32, 0, "position from the reference; rounded down", fixed),
        ("home_target_fraction", "u32", "2⁻²⁴ count", (0, 2**24 - 1), 0, "remainder of the rounding", fixed),
        ("home_step", "u32", "2⁻²⁴ count/tick", _U32, 0, "travel of the homing set point", fixed),
        ("biquad_b0", "i32", "2⁻ᵇ", _I32, 0, "low pass in integers, b = biquad_coefficient_bits", fixed),
        ("biquad_b1", "i32", "2⁻ᵇ", _I32, 0, "", fixed),
        ("biquad_b2", "i32", "2⁻ᵇ", _I32, 0, "", fixed),
        ("biquad_a1", "i32", "2⁻ᵇ", _I32, 0, "", fixed),
        ("biquad_a2", "i32", "2⁻ᵇ", _I32, 0, "", fixed),
        ("biquad_coefficient_bits", "u8", "", (0, 30), 0, "fractional bits of the coefficients", fixed),
        ("biquad_state_bits", "u8", "", (0, 30), 0, "fractional bits of input and output", fixed),
        ("biquad_word_bits", "u8", "", (2, 32), 32, "word length of input and output", fixed),
        ("biquad_rounding", "u8", "", (0, 2), 0, "0 down, 1 to zero, 2 to the nearest", fixed),
        ("low_pass_order", "u8", "", (1, 2 * _SECTIONS), 1, "low pass in float32; the last section of an odd one is of "
         "first order", fixed),
    ]  # fmt: skip
    for part in ("inner", "band", "low"):
        rows += [
            (f"low_pass_{part}_{n + 1}", "f32", "", _FLOAT, 0.0, f"section {n + 1}: see law.h", fixed)
            for n in range(_SECTIONS)
        ]
    rows += [
        ("foaw_band", "i32", "2⁻⁸ count", (0, _I32[1]), 0, "noise margin", fixed),
        ("foaw_limit", "u8", "period", (1, 64), 1, "longest window", fixed),
        ("foaw_stop_first", "u8", "", (0, 1), 0, "1: window before the first that fails, 0: longest", fixed),
        (
            "foaw_least_squares",
            "u8",
            "",
            (0, 1),
            0,
            "1: least-squares line, 0: through the newest sample",
            fixed,
        ),
        ("levant_alpha", "f32", "count/period²", _FLOAT, 0.0, "", fixed),
        ("levant_lambda", "f32", "√count/period", _FLOAT, 0.0, "", fixed),
        ("levant_discretisation", "u8", "", (0, 2), 0, "0 explicit, 1 semi-implicit, 2 implicit", fixed),
        ("levant_integrator", "u8", "", (0, 1), 0, "1: the velocity is u1, 0: u", fixed),
        ("kalman_position", "f32", "", _FLOAT, 0.0, "steady gain", fixed),
        ("kalman_velocity", "f32", "1/period", _FLOAT, 0.0, "steady gain", fixed),
        ("kalman_acceleration", "f32", "1/period²", _FLOAT, 0.0, "steady gain", fixed),
    ]
    return rows + _wall_rows()


def _wall_rows() -> list[_Row]:
    """Return the end of `_rows`: parameters of walls and excitation, and those that later protocol versions added."""
    fixed, live = False, True
    return [
        ("float_surface", "i32", "count", _I32, 0, "position from the reference; rounded down", live),
        ("float_surface_fraction", "f32", "count", (0.0, 1.0), 0.0, "remainder of the rounding", live),
        ("float_stiffness", "f32", "quantum/count", _POSITIVE, 0.0, "", live),
        ("float_damping", "f32", "quantum·period/count", _POSITIVE, 0.0, "", live),
        ("float_constant", "f32", "quantum", _FLOAT, 0.0, "constant effort", fixed),
        ("float_trial_slew", "f32", "quantum/tick", _POSITIVE, 0.0, "", fixed),
        ("float_homing_slew", "f32", "quantum/tick", _POSITIVE, 0.0, "", fixed),
        ("float_speed_limit", "f32", "count/period", _POSITIVE, 0.0, "speed at which the run ends", fixed),
        ("float_slow_speed", "f32", "count/period", _POSITIVE, 0.0, "", fixed),
        ("float_velocity_lsb", "f32", "count/period", _POSITIVE, 0.0, "LSB of the estimator in integers", fixed),
        ("float_home_stiffness", "f32", "quantum/count", _POSITIVE, 0.0, "", fixed),
        ("float_home_damping", "f32", "quantum·period/count", _POSITIVE, 0.0, "", fixed),
        ("float_home_effort", "f32", "quantum", _POSITIVE, 0.0, "", fixed),
        ("fixed_surface", "i32", "2⁻⁸ count", _I32, 0, "the wall's surface, along the direction that enters it", live),
        ("fixed_stiffness", "i32", "quantum·2⁻ˢ", _I32, 0, "for an LSB of depth; s = fixed_shift", live),
        ("fixed_damping", "i32", "quantum·2⁻ˢ", _I32, 0, "for an LSB of velocity", live),
        ("fixed_shift", "u8", "", (1, 40), 1, "s", live),
        ("fixed_constant_high", "i32", "quantum·2³²⁻ˢ", _I32, 0, "constant effort, upper half", live),
        ("fixed_constant_low", "u32", "quantum·2⁻ˢ", _U32, 0, "constant effort, lower half", live),
        ("fixed_trial_slew", "i32", "2⁻¹⁵ quantum/tick", (0, _I32[1]), 0, "", fixed),
        ("fixed_homing_slew", "i32", "2⁻¹⁵ quantum/tick", (0, _I32[1]), 0, "", fixed),
        ("fixed_speed_limit", "i32", "velocity LSB", (0, _I32[1]), 0, "speed at which the run ends", fixed),
        ("fixed_slow_speed", "i32", "velocity LSB", (0, _I32[1]), 0, "", fixed),
        ("fixed_home_stiffness", "i32", "quantum·2⁻ʰ", _I32, 0, "for an LSB of depth; h = fixed_home_shift", fixed),
        ("fixed_home_damping", "i32", "quantum·2⁻ʰ", _I32, 0, "for an LSB of velocity", fixed),
        ("fixed_home_shift", "u8", "", (1, 40), 1, "h", fixed),
        ("fixed_home_effort_high", "i32", "quantum·2³²⁻ʰ", _I32, 0, "most effort of the servo, upper half", fixed),
        ("fixed_home_effort_low", "u32", "quantum·2⁻ʰ", _U32, 0, "most effort of the servo, lower half", fixed),
        ("excitation_lines", "u16", "", (0, 4_096), 0, "lines of the multisine; 0: none", fixed),
        ("excitation_first", "u16", "", (1, 32_767), 1, "harmonic of the first line", fixed),
        ("excitation_step", "u16", "", (1, 32_767), 1, "harmonics between lines", fixed),
        ("excitation_period", "u32", "tick", (2, 65_536), 2, "one period; see the device's own maximum", fixed),
        ("excitation_ramp", "u32", "tick", (0, 2**24), 0, "raised cosine at the beginning", fixed),
        ("excitation_amplitude", "u32", "2⁻¹⁶ quantum", (0, _I32[1]), 0, "peak of each line", fixed),
        ("excitation_bits", "u8", "", (0, 15), 0, "fractional bits of the table that the device keeps (quanta)", fixed),
        ("excitation_phases", "u8", "", (0, 1), 0, "0 from the seed, 1 Schroeder's", fixed),
        ("excitation_seed", "u32", "", _U32, 0, "seed of the phases", fixed),
        ("free_ticks", "u32", "tick", _U32, 0, "time in free space before the trial; 0: none", fixed),
        ("free_minimum", "i32", "count", _I32, 0, "in free space: a handle below is a false start, no trial", fixed),
        ("free_maximum", "i32", "count", _I32, 0, "in free space: a handle above is a false start, no trial", fixed),
        ("hold_ticks", "u32", "tick", _U32, 0, "length of the trial from first contact; 0: trial_ticks", fixed),
        ("kalman_input", "f32", "count/period²/quantum", _FLOAT, 0.0, "acceleration for a quantum of active current; "
         "0: the estimator does not use the effort", fixed),
        ("estimated_position", "u8", "", (0, 1), 0, "1: the wall sees the position that the estimator (6 or 7) "
         "estimates; float32, velocity_divider 1", fixed),
        ("float_passive_damping", "f32", "quantum·period/count", _POSITIVE, 0.0, "largest damping of the passivity "
         "controller; 0: none", fixed),
        ("two_mass_spring_motor", "f32", "1/period²", _FLOAT, 0.0, "acceleration of the motor for a twist", fixed),
        ("two_mass_spring_link", "f32", "1/period²", _FLOAT, 0.0, "acceleration of the link for a twist", fixed),
        ("two_mass_gain_position", "f32", "", _FLOAT, 0.0, "gain of the motor's position", fixed),
        ("two_mass_gain_velocity", "f32", "1/period", _FLOAT, 0.0, "gain of the motor's velocity", fixed),
        ("two_mass_gain_twist", "f32", "", _FLOAT, 0.0, "gain of link less motor", fixed),
        ("two_mass_gain_link", "f32", "1/period", _FLOAT, 0.0, "gain of the link's velocity", fixed),
        ("two_mass_gain_hand", "f32", "1/period²", _FLOAT, 0.0, "gain of the link's acceleration by the hand", fixed),
        ("two_mass_input", "f32", "count/period²/quantum", _FLOAT, 0.0, "acceleration of the motor for a quantum of "
         "active current", fixed),
    ]  # fmt: skip


# Ids follow from the order of the rows and never change: new parameters go to the end of `_wall_rows`.
LAW_PARAMETERS: tuple[Parameter, ...] = tuple(
    Parameter(
        _FIRST_ID + n,
        name,
        ctype,
        unit,
        *bounds,
        default,
        meaning or f"see {name.split('_')[0]} in law.h",
        excluded=(0,) if name == "wall_side" else (),
        live=live,
    )
    for n, (name, ctype, unit, bounds, default, meaning, live) in enumerate(_rows())
)
