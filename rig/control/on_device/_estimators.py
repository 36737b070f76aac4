"""Device parameters of an estimator, converted from those of the host's kernel.

A device has the finite difference, its Butterworth low pass (float32, or order 2 in integers), `foaw-end`, `foaw-best`,
Levant's differentiator, the Kalman filter with its steady gain, which also runs `tracking` and `disturbance`, and the
disturbance observer of two masses. Others are rejected: `period` and `period-frequency` need edge times, a recursive
gain takes longer than a tick allows, and `optimal` and `foaw-levant` are not implemented in firmware.
`rig.config.device_law` and exports of an estimator use it. Change it only together with firmware/law.
"""

import math
from collections.abc import Callable

from firmware_protocol.parameter import Value
from rig.control._fixed_point import Format
from rig.control.estimators import _disturbance_two_mass as two_mass
from rig.control.estimators import _fdm_butterworth as fdm_butterworth
from rig.control.estimators import _fdm_butterworth_fixed as fixed
from rig.control.estimators import _foaw as foaw
from rig.control.estimators import _foaw_best as foaw_best
from rig.control.estimators import _kalman as kalman
from rig.control.estimators import _levant as levant
from rig.control.estimators.estimator import Floats, Prepared
from rig.control.on_device._errors import refusal

ESTIMATORS = (  # in the order of the parameter `estimator`
    "fdm-butterworth-fixed",
    "fdm",
    "fdm-butterworth",
    "foaw-end",
    "foaw-best",
    "levant",
    "kalman",
    "disturbance-two-mass",
)
_SAME_RECURSION = {"tracking": "kalman", "disturbance": "kalman"}  # with other gains, and an input
_EDGES = ": it needs the time of each encoder edge"
_ABSENT = {  # why a built-in one is not there
    "period": _EDGES,
    "period-frequency": _EDGES,
    "foaw-levant": ": it runs on the host only",
    "optimal": ": it runs on the host only",
}
BAND_BITS = 8  # of a noise band in counts
WORD_BITS = 32

Values = dict[str, Value]


def estimator_parameters(prepared: Prepared, effort_quantum: float = 1.0) -> Values:
    """Return the device parameters, by name, that select a velocity estimator and set its gains and limits.

    `effort_quantum` is the effort of one quantum of the active current (N·m or N).

    Raises
    ------
    PlanError
        The device does not have the estimator or this variant of it.
    """
    name = prepared.estimator.name
    runs_as = _SAME_RECURSION.get(name, name)
    if runs_as not in ESTIMATORS:
        raise refusal(
            "controller.estimator",
            name,
            f"a device does not have this estimator{_ABSENT.get(name, '')}",
            f"choose one of: {', '.join((*ESTIMATORS, *_SAME_RECURSION))}",
        )
    numbers = _NUMBERS.get(runs_as)
    own = numbers(prepared.parameters) if numbers is not None else {}
    if runs_as in _INPUTS:
        parameter, at = _INPUTS[runs_as]
        own[parameter] = float(prepared.parameters[at]) * effort_quantum
    return {"estimator": ESTIMATORS.index(runs_as), **own}


def velocity_format(prepared: Prepared) -> Format:
    """Return the fixed-point format of an estimator's velocity (counts per period), in words of 32 bits."""
    return Format(WORD_BITS, int(prepared.parameters[fixed.STATE_BITS]))


def _biquad(own: Floats) -> Values:
    names = ("b0", "b1", "b2", "a1", "a2", "coefficient_bits", "state_bits", "word_bits", "rounding")
    values: Values = {
        f"biquad_{name}": int(value)
        for name, value in zip(names, own[fixed.B0 : fixed.ROUNDING + 1], strict=True)
    }
    if values["biquad_word_bits"] > WORD_BITS:
        raise refusal(
            "controller.parameters.word_bits",
            values["biquad_word_bits"],
            f"the firmware computes in words of {WORD_BITS} bits",
            f"choose {WORD_BITS} or less",
        )
    return values


def _low_pass(own: Floats) -> Values:
    """Return the device parameters of a Butterworth low pass (gains of integrators) from the host's sections."""
    sections = own[fdm_butterworth.B0 :].reshape(-1, fdm_butterworth.SECTION).tolist()
    # All zeros are at -1, so it does not matter which section scipy gave them to, nor where the odd one stands.
    sections.sort(key=lambda section: section[-1] == 0.0)
    values: Values = {"low_pass_order": sum(1 if a2 == 0.0 else 2 for *_, a2 in sections)}
    for n, (*_, a1, a2) in enumerate(sections, start=1):
        if a2 == 0.0:
            g = (1.0 + a1) / (1.0 - a1)
            values[f"low_pass_low_{n}"] = g / (1.0 + g)
            continue
        bottom = 1.0 - a1 + a2
        g, kg = math.sqrt((1.0 + a1 + a2) / bottom), 2.0 * (1.0 - a2) / bottom
        inner = 1.0 / (1.0 + kg + g * g)
        values |= {
            f"low_pass_inner_{n}": inner,
            f"low_pass_band_{n}": g * inner,
            f"low_pass_low_{n}": g * g * inner,
        }
    return values


def _foaw(own: Floats) -> Values:
    return {
        "foaw_band": math.floor(own[foaw.BAND] * 2**BAND_BITS),  # its margin keeps a whole band whole
        "foaw_limit": int(own[foaw.LIMIT]),
        "foaw_stop_first": int(own[foaw.STOP] == foaw.STOP_FIRST),
    }


def _foaw_best(own: Floats) -> Values:
    anchor = foaw_best.ANCHORS[int(own[foaw_best.ANCHOR])]
    if anchor == "literal":
        raise refusal(
            "controller.parameters.anchor",
            anchor,
            "the firmware does not support this rule for the intercept of the fitted line",
            'choose anchor = "lsq" or "last"',
        )
    return {**_foaw(own), "foaw_least_squares": int(anchor == "lsq")}


def _levant(own: Floats) -> Values:
    return {
        "levant_alpha": float(own[levant.ALPHA]),
        "levant_lambda": float(own[levant.LAMBDA]),
        "levant_discretisation": int(own[levant.SCHEME]),
        "levant_integrator": int(own[levant.OUTPUT]),
    }


def _kalman(own: Floats) -> Values:
    if own[kalman.STEADY] == 0.0:
        raise refusal(
            "controller.parameters.gain",
            "recursive",
            "a device has only the steady gain, to which the recursive gain converges within a few periods",
            'choose gain = "steady" (and no fading)',
        )
    position, velocity, acceleration = own[kalman.GAIN1 : kalman.GAIN3 + 1].tolist()
    return {"kalman_position": position, "kalman_velocity": velocity, "kalman_acceleration": acceleration}


def _two_mass(own: Floats) -> Values:
    gains = (f"gain_{state}" for state in ("position", "velocity", "twist", "link", "hand"))
    values = zip(
        ("spring_motor", "spring_link", *gains), own[two_mass.SPRING_MOTOR : two_mass.INPUT], strict=True
    )
    return {f"two_mass_{name}": float(value) for name, value in values}


# Parameter for the acceleration by a quantum of active current, and its index in those of the host's kernel. It is sent
# although it is 0 for `kalman` and `tracking`: a device keeps what a block does not contain, and the input of a
# `disturbance` that ran before would remain.
_INPUTS = {
    "kalman": ("kalman_input", kalman.INPUT),
    "disturbance-two-mass": ("two_mass_input", two_mass.INPUT),
}
_NUMBERS: dict[str, Callable[[Floats], Values]] = {
    "fdm-butterworth-fixed": _biquad,
    "fdm-butterworth": _low_pass,
    "foaw-end": _foaw,
    "foaw-best": _foaw_best,
    "levant": _levant,
    "kalman": _kalman,
    "disturbance-two-mass": _two_mass,
}
