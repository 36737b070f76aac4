"""Predict stability and passivity of dual-rate virtual walls by linear theory, in milliseconds and without simulation.

    from rig.analysis import theory

    theory.k_max("koul-compliant", "dual:20k/2k", 0.5).stiffness
    theory.spectral_radius("my-rig.toml", "uniform:20k", stiffness=560.0, damping=0.0)
    theory.passivity_bound("koul-rigid", "dual:20k/2k").beta

A rig is a preset's name, a TOML file, an experiment or a `rig.core.model.RigModel`; a sampling scheme is a text or a
`rig.config.schemes.Scheme`. The docstring of `rig.analysis.theory._loop` lists what the theory leaves out (Coulomb
friction, the encoder's quantum, saturation, release) and how much each changes the result.

`rig theory`, `rig design`, the checks of a run and the reproductions of papers call it. Nothing here simulates, decides
whether the motor may be armed, or commands a device.
"""

from rig.analysis.theory._describing import LimitCycle, limit_cycle
from rig.analysis.theory._lifted import Lifted, spectral_radius
from rig.analysis.theory._limits import (
    DampingLimit,
    Island,
    Limit,
    StabilityMap,
    as_lifted,
    b_max,
    damping_range,
    k_max,
    k_max_curve,
    stability_map,
    stiffnesses,
)
from rig.analysis.theory._linear import NotLinearError, Realisation, realise
from rig.analysis.theory._loop import LinearLoop, Subject, linear_loop, resolve, with_linear_wall
from rig.analysis.theory._passivity import (
    Bound,
    Diolaiti,
    PassivityBound,
    beta,
    diolaiti,
    passive_curve,
    passivity_bound,
    rigid_b_max,
)
from rig.analysis.theory._summary import (
    AtDamping,
    InHand,
    NotLinear,
    SchemeTheory,
    Theory,
    default_schemes,
    theory_of,
)

__all__ = [
    "AtDamping", "Bound", "DampingLimit", "Diolaiti", "InHand", "Island", "Lifted", "Limit", "LimitCycle",
    "LinearLoop", "NotLinear", "NotLinearError", "PassivityBound", "Realisation", "SchemeTheory",
    "StabilityMap", "Subject", "Theory", "as_lifted", "b_max", "beta", "damping_range", "default_schemes",
    "diolaiti", "k_max", "k_max_curve", "limit_cycle", "linear_loop", "passive_curve", "passivity_bound", "realise",
    "resolve", "rigid_b_max", "spectral_radius", "stability_map", "stiffnesses", "theory_of",
    "with_linear_wall",
]  # fmt: skip
