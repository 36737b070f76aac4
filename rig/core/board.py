"""Constants of a rig that its device needs: they are built into the firmware and into simulated devices.

Currents are in quanta and positions in encoder counts, the device's units; only the mechanics are in SI units.

Firmware builds, simulated devices and plans use it. It must not depend on a particular board (`rig.firmware`).
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass

from firmware_protocol import dictionary as dictionaries
from firmware_protocol.dictionary import ConstantInfo, SettingValue
from firmware_protocol.parameter import Parameter, Value
from firmware_protocol.parameters import PARAMETERS
from rig.core.current_sensor import SPEED_LAG_S, CurrentSensor
from rig.core.model import RigModel
from rig.core.sample import unit_of

CURRENT_QUANTA_LIMIT = 2**15 - 1  # of an i16 on the wire
# Travel that must show an edge: one count could be just missed, wherever the handle stood in its encoder cell.
STALL_COUNTS = 2
# Above the amplifier's own peak: noise and ripple of the sensor are no fault, a shorted winding is.
OVER_CURRENT_MARGIN = 1.1
ROUNDED = math.sqrt(2.0 / 12.0)  # rms of the difference of two rounded values, in quanta
MOVED_QUANTITIES = {
    "effort_quantum": "effort",
    "effort_limit": "effort",
    "friction": "effort",
    "travel": "position",
    "inertia": "inertia",
    "damping": "damping",
    "lag_s": "s",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class MovedMechanics:
    """Mechanics by which the device computes how fast a large effort must move the rig, to detect a stalled motor.

    The firmware's `struct mechanics` has the same fields.

    Attributes
    ----------
    effort_quantum
        Effort of one current quantum (N·m or N).
    effort_limit
        Largest effort of the amplifier (N·m or N).
    friction
        Coulomb friction and weight, which the effort must overcome (N·m or N).
    travel
        Travel within which an encoder edge must occur (rad or m).
    inertia
        Inertia of all moving parts (kg·m² or kg).
    damping
        Viscous damping of a steady motion, with back-EMF under voltage drive (N·m·s/rad or N·s/m).
    lag_s
        Sum of the amplifier's lag and its set-point delay (s).
    """

    effort_quantum: float
    effort_limit: float
    friction: float
    travel: float
    inertia: float
    damping: float
    lag_s: float


def current_sensor(model: RigModel) -> CurrentSensor:
    """Return the parameters that predict the measured motor current from the commanded current.

    Their `noise` is -1, which switches the comparison of the two currents off, if the device does not measure the
    current, or if the simulation has a computation delay, which the prediction does not include.
    """
    amplifier = model.amplifier
    back_emf = amplifier.back_emf * model.encoder.resolution / amplifier.effort_quantum
    sensor = amplifier.current_noise_a / amplifier.current_quantum_a
    comparable = amplifier.current_monitor and model.simulation.computation_delay_ticks == 0
    return CurrentSensor(
        # Independent sources add in squares: the sensor's, the rounding of the current, that of the count's speed.
        noise=math.hypot(sensor, ROUNDED, ROUNDED * back_emf / SPEED_LAG_S) if comparable else -1.0,
        lag_s=amplifier.lag_s,
        delay_s=amplifier.set_point_delay_s,
        back_emf=back_emf,
    )


def peak_current(model: RigModel) -> int:
    """Return the largest current of the rig's amplifier, in whole current quanta (smallest steps of the device)."""
    # The factor makes 10.999… quanta 11: the quotient of two decimals is rounded.
    whole = model.amplifier.effort_limit / model.amplifier.effort_quantum * (1.0 + 1e-12)
    return int(min(whole, CURRENT_QUANTA_LIMIT))


def over_current(model: RigModel) -> int:
    """Return the measured current (in smallest steps, quanta) above which the device reports an overcurrent fault."""
    return int(OVER_CURRENT_MARGIN * model.amplifier.effort_limit / model.amplifier.effort_quantum)


def moved_mechanics(model: RigModel) -> MovedMechanics:
    """Return the mechanics (SI units) by which a device detects a stalled motor."""
    mechanics, amplifier = model.mechanics, model.amplifier
    return MovedMechanics(
        effort_quantum=amplifier.effort_quantum,
        effort_limit=amplifier.effort_limit,
        friction=mechanics.motor_coulomb + mechanics.link_coulomb + abs(mechanics.gravity_effort),
        travel=STALL_COUNTS * model.encoder.resolution,
        inertia=mechanics.inertia,
        damping=model.damping,
        lag_s=amplifier.lag_s + amplifier.set_point_delay_s,
    )


def constants(model: RigModel) -> tuple[ConstantInfo, ...]:
    """Return the rig's constants for the device's monitors (overcurrent, stall): name, unit and value of each."""
    mechanics = moved_mechanics(model)
    return (
        ConstantInfo("over_current", "quantum", over_current(model)),
        *(
            ConstantInfo(name, unit_of(quantity, model.motion), getattr(mechanics, name))
            for name, quantity in MOVED_QUANTITIES.items()
        ),
    )


def describe(
    model: RigModel,
    *,
    firmware: str,
    simulated: bool,
    rate_default: int,
    rate_maximum: int,
    name: str | None = None,
    narrower: Mapping[str, tuple[Value, Value]] | None = None,
    settings: Mapping[str, SettingValue] | None = None,
) -> dictionaries.Dictionary:
    """Return the description that a rig's device sends of itself: constants, settings, and parameters with ranges.

    The ranges are limited by motion, encoder and peak current of the rig, and by `narrower`: (minimum, maximum) by
    parameter name. `firmware` is the version of the device's firmware, `settings` are those with which it was built;
    `simulated` is True if the device has no real motor. Tick rates are in Hz. Without `name` the device has the name of
    the rig.
    """
    motion = 0 if model.motion == "rotary" else 1
    peak = peak_current(model)
    return dictionaries.build(
        device=name or model.name,
        firmware=firmware,
        simulated=simulated,
        current_quantum_a=model.amplifier.current_quantum_a,
        current_measured=model.amplifier.current_monitor,
        position_rate_default=rate_default,
        position_rate_maximum=rate_maximum,
        constants=constants(model),
        settings=settings,
        ranges={
            "motion": (motion, motion),
            "encoder_sign": (model.encoder.sign, model.encoder.sign),
            "current_limit": (0, peak),
            "continuous_current": (0, peak),
            **(narrower or {}),
        },
    )


def narrower(dictionary: dictionaries.Dictionary) -> list[tuple[Parameter, int, int]]:
    """Return parameter, minimum and maximum for each parameter whose range on a device differs from the standard range.

    Both bounds are the four bytes of the value on the wire, as an unsigned 32-bit number.
    """
    found: list[tuple[Parameter, int, int]] = []
    for parameter in PARAMETERS:
        info = dictionary.parameter(parameter.name)
        assert info is not None
        if (info.minimum, info.maximum) != (parameter.minimum, parameter.maximum):
            low, high = (_bits(parameter.ctype, bound) for bound in (info.minimum, info.maximum))
            found.append((parameter, low, high))
    return found


def _bits(ctype: str, value: Value) -> int:
    """Return the four bytes of a parameter's value on the wire, as an unsigned number."""
    if ctype == "f32":
        (bits,) = struct.unpack("<I", struct.pack("<f", value))
        return int(bits)
    assert math.trunc(value) == value
    return int(value) & 0xFFFFFFFF
