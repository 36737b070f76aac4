"""What exact linear theory says about dual-rate walls: no simulation, no trial, milliseconds.

    from rig.analysis import theory

    theory.k_max("koul-compliant", "dual:20k/2k", 0.5).stiffness
    theory.spectral_radius("my-rig.toml", "uniform:20k", stiffness=560.0, damping=0.0)
    theory.passivity_bound("koul-rigid", "dual:20k/2k").beta

A rig is a preset's name, a TOML file, an experiment or a `rig.core.model.RigModel`; a scheme is a text or a
`rig.config.schemes.Scheme`. What the theory leaves out (Coulomb friction, the encoder's quantum, saturation, release)
stands in `rig.analysis.theory.loop`, with what that is worth.

* `linear`: any linear estimator as a state space, found by probing it
* `loop`: rig and scheme as matrices
* `lifted`: the loop over one velocity period and its spectral radius
* `limits`: K_max, B_max, islands, maps
* `dissipation`: the work that a wall gives back, exactly
* `passivity`: the multi-rate bound and the conditions of the literature
* `describing`: the limit cycle of the encoder's quantum
* `summary`: all of it for a rig, as `rig theory walls` prints and draws it
"""

from rig.analysis.theory.describing import LimitCycle, limit_cycle
from rig.analysis.theory.lifted import Lifted, spectral_radius
from rig.analysis.theory.limits import (
    DampingLimit,
    Island,
    Limit,
    StabilityMap,
    as_lifted,
    b_max,
    k_max,
    k_max_curve,
    stability_map,
)
from rig.analysis.theory.linear import NotLinearError, Realisation, realise
from rig.analysis.theory.loop import LinearLoop, Subject, linear_loop, resolve
from rig.analysis.theory.passivity import (
    Bound,
    Diolaiti,
    PassivityBound,
    beta,
    diolaiti,
    passivity_bound,
    rigid_b_max,
)
from rig.analysis.theory.summary import (
    AtDamping,
    InHand,
    NotLinear,
    SchemeTheory,
    Theory,
    default_schemes,
    theory_of,
)

__all__ = [
    "AtDamping",
    "Bound",
    "DampingLimit",
    "Diolaiti",
    "InHand",
    "Island",
    "Lifted",
    "Limit",
    "LimitCycle",
    "LinearLoop",
    "NotLinear",
    "NotLinearError",
    "PassivityBound",
    "Realisation",
    "SchemeTheory",
    "StabilityMap",
    "Subject",
    "Theory",
    "as_lifted",
    "b_max",
    "beta",
    "default_schemes",
    "diolaiti",
    "k_max",
    "k_max_curve",
    "limit_cycle",
    "linear_loop",
    "passivity_bound",
    "realise",
    "resolve",
    "rigid_b_max",
    "spectral_radius",
    "stability_map",
    "theory_of",
]
