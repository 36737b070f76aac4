"""Small rigs with round numbers, so that results can be computed by hand."""

from dataclasses import replace
from typing import Any

from rig.core.model import Amplifier, Encoder, Mechanics, RigModel, Simulation


def rotary_rig(
    *, inertia: float = 1e-3, damping: float = 0.0, coulomb: float = 0.0, **others: Any
) -> RigModel:
    """Return a rigid rig, frictionless by default: 0.1 N·m/A, 1 mA, 20 000 counts a revolution."""
    simulation = {
        key: others.pop(key) for key in ("initial_position", "computation_delay_ticks") if key in others
    }
    encoder = {"counts_per_revolution": 5000, **{k: others.pop(k) for k in ("offset", "sign") if k in others}}
    amplifier = {"effort_per_ampere": 0.1, "effort_limit": 1.0, "current_quantum_a": 0.001, **others}
    return RigModel(
        name="test-rotary",
        motion="rotary",
        mechanics=Mechanics(
            structure="rigid",
            motor_inertia=inertia,
            link_inertia=0.0,
            motor_damping=damping,
            motor_coulomb=coulomb,
        ),
        amplifier=Amplifier(**amplifier),
        encoder=Encoder(**encoder),
        simulation=Simulation(**simulation),
    )


def unmeasured(model: RigModel) -> RigModel:
    """Return the rig without a current sensor, so that simulated currents need not match the commands."""
    return replace(model, amplifier=replace(model.amplifier, current_monitor=False))


def linear_rig() -> RigModel:
    """Return a sliding mass of 0.5 kg with 1 µm counts and 10 N/A."""
    return RigModel(
        name="test-linear",
        motion="linear",
        mechanics=Mechanics(structure="rigid", motor_inertia=0.5, link_inertia=0.0),
        amplifier=Amplifier(effort_per_ampere=10.0, effort_limit=50.0, current_quantum_a=0.001),
        encoder=Encoder(quantum=1e-6),
    )
