"""Compute up to which stiffness a wall is passive or stable, by a multi-rate condition and those of the literature.

With b the viscous damping of the rig, T1 and T2 the periods, β a property of the estimator:

* *Multi-rate passivity*, b ≥ K·T1/2 + β·B. The wall consists of two samplers in parallel, a spring at T1 and a damper
  at T2. Lifted over T2 the spring needs K·T1/2 at every frequency, so the needs of spring and damper add. Without lag
  and delay the condition is exact on a rigid rig; on two masses it is sufficient, with b the damping of the motor's
  side (`Subject.port_damping`). Own derivation by lifting; for T1 = T2 it is Colgate and Schenkel's theorem.
  *Passivity, lag and delay counted*: a late effort rotates the damper's part with frequency, so spring and damper have
  different worst frequencies. `rig.analysis.theory._dissipation` has the exact condition for a rigid rig; on two masses
  it is sufficient. At B = 0, b ≥ K·(T1/2 + lag + delay) is necessary (slow motion) and within 1 % of exact for lags
  above a tick. With β·B added it is an approximation, too high or too low by up to several times.
* *Colgate and Schenkel* (1994; as quoted in Weir and Colgate's equation 8.2): a uniform wall H is passive iff
  b > T/2 · Re{(1 − e^{−jωT})·H(e^{jωT})}/(1 − cos ωT) for all ω: b > K·T/2 + |B| for an unfiltered difference.
* *Abbott and Okamura* (2005; abstract and lecture notes): with a quantum Δ and Coulomb friction f_c, without damping of
  the wall, K ≤ min(2b/T, 2f_c/Δ).
* *Diolaiti et al.* (2006; normalisation read, thresholds from memory): b/(K·T) > ½ and f_c/(K·Δ) > ½ leave no limit
  cycle; a delay joins T/2. Without damping of the wall.
* *Gil et al.* (from memory of the literature, checked against exact eigenvalues): K < (b + B)/(T/2 + delay), a linear
  condition for stability that is valid if the damping acts much faster than the mass moves: too high by 2 to 35 % at
  B·τ/J = 0.01, τ the delay of the estimator, and by several times or more at 0.1. So it is reported at B = 0 only, as
  the rule for a rigid rig, K_max = b/(T1/2 + lag + delay).

Under voltage drive back-EMF is damping, too: without a lag at any speed, behind a lag in slow motion only. The exact
condition includes it with its lag.

All conditions are for a bilateral wall and any passive hand. The docstring of `rig.analysis.theory._loop` lists what
they leave out; only Abbott and Okamura and Diolaiti include quantum and friction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from rig.analysis.theory._dissipation import Damping, needed_per_damping, passive_stiffness
from rig.analysis.theory._lifted import Lifted
from rig.analysis.theory._limits import as_lifted
from rig.analysis.theory._loop import LinearLoop, RigLike, SchemeLike, Subject
from rig.core.model import Operator

Meaning = Literal["exact", "sufficient", "necessary", "approximate"]

# Frequency over Nyquist at which the delay of an estimator for slow motions is computed.
SLOW = 1e-3


@dataclass(frozen=True, slots=True)
class Bound:
    """The largest stiffness that one condition for passivity or stability allows, at one damping of the wall.

    Attributes
    ----------
    name, formula, source
        Name, formula and source of the condition; the source says how much of it was read.
    stiffness
        Largest K that fulfils the condition (N·m/rad or N/m); 0 if no K does.
    meaning
        *exact*, *sufficient* and *necessary* are proven, for passivity of the linear loop; *approximate* is a rule.
    """

    name: str
    formula: str
    source: str
    stiffness: float
    meaning: Meaning


@dataclass(frozen=True, slots=True)
class PassivityBound:
    """Conditions for the passivity of a rig under a scheme, at one damping of the wall.

    Attributes
    ----------
    beta
        Damping of the rig that each unit of B needs, without lag and delay: β in b ≥ K·T1/2 + β·B.
    rig_damping
        Damping b of the rig in the conditions, back-EMF included (N·m·s/rad or N·s/m): `Subject.port_damping`.
    largest_damping
        Largest B of a passive wall with K = 0, with lag and delay (N·m·s/rad or N·s/m); infinite if every B is passive.
    bounds
        All conditions that apply at this damping; the first is the condition for passivity.
    """

    damping: float
    beta: float
    rig_damping: float
    largest_damping: float
    bounds: tuple[Bound, ...]

    @property
    def stiffness(self) -> float:
        """Return the largest stiffness (N·m/rad or N/m) of a passive wall, with lag and delay.

        The value is exact on a rigid rig; on two masses it is a sufficient condition.
        """
        return self.bounds[0].stiffness

    @property
    def binding(self) -> Bound:
        """Return the passivity condition that allows the smallest stiffness; approximate rules are ignored."""
        proven = (bound for bound in self.bounds if bound.meaning != "approximate")
        return min(proven, key=lambda bound: bound.stiffness)


def passivity_bound(
    rig: RigLike | Lifted,
    scheme: SchemeLike | None = None,
    damping: float = 0.0,
    *,
    operator: str | Operator | None = None,
) -> PassivityBound:
    """Return all conditions for passivity or stability at a damping of the wall (N·m·s/rad or N·s/m).

    `operator` is the grip of a modelled hand. Raise `NotLinearError` if theory does not cover the loop.
    """
    loop = as_lifted(rig, scheme, operator).loop
    share = beta(loop, negative=damping < 0.0)
    return PassivityBound(
        damping=damping,
        beta=share,
        rig_damping=loop.subject.port_damping,
        largest_damping=_largest_damping(loop),
        bounds=tuple(_bounds(loop, damping, share)),
    )


def passive_curve(lifted: Lifted, dampings: Sequence[float]) -> list[float]:
    """Return for each damping (N·m·s/rad or N·s/m) the largest stiffness (N·m/rad or N/m) of a passive wall."""
    return passive_stiffness(lifted.loop, dampings, _port_damping(lifted.loop))


def _port_damping(loop: LinearLoop) -> Damping:
    back_emf = loop.subject.model.amplifier.back_emf
    return Damping(loop.subject.port_damping - back_emf, back_emf)


def _largest_damping(loop: LinearLoop) -> float:
    port = _port_damping(loop)
    if not port.passive(loop):
        return 0.0
    worst = needed_per_damping(loop, port)
    return 1.0 / worst if worst > 0.0 else math.inf


def beta(loop: LinearLoop, *, negative: bool = False) -> float:
    """Return β in b ≥ K·T1/2 + β·B: the damping of the rig that each unit of the wall's damping B needs for passivity.

    For velocities held over T2 this is Colgate and Schenkel's expression for the estimator, maximised over ω. In
    general it is the largest eigenvalue of minus the Hermitian part of the matrix from the position increments to the
    efforts of a velocity period. Lag and delay are not included; with `negative` the wall has a negative damping.
    """
    return needed_per_damping(loop, Damping(1.0), late=False, negative=negative)


def diolaiti(rig: RigLike | Lifted, scheme: SchemeLike | None, stiffness: float) -> Diolaiti:
    """Return damping and friction, normalised as by Diolaiti et al., for a wall of `stiffness` (SI) without damping."""
    loop = as_lifted(rig, scheme).loop
    mechanics, quantum = loop.subject.model.mechanics, loop.subject.model.encoder.resolution
    coulomb = mechanics.motor_coulomb + mechanics.link_coulomb
    period = 2.0 * (0.5 * loop.tick_s + loop.late_s)
    return Diolaiti(loop.subject.damping / (stiffness * period), coulomb / (stiffness * quantum))


@dataclass(frozen=True, slots=True)
class Diolaiti:
    """Normalised damping b/(K·T) and Coulomb friction f_c/(K·Δ) of an undamped wall; ½ is the threshold of both.

    T/2 includes lag and delay. Source: Diolaiti, Niemeyer, Barbagli and Salisbury 2006; the regions are from memory.
    """

    damping: float
    friction: float

    @property
    def region(self) -> str:
        """Return the behaviour of the wall that Diolaiti et al. predict, as a phrase such as ``no limit cycle``."""
        damped, rubbed = self.damping > 0.5, self.friction > 0.5
        if damped:
            return "no limit cycle" if rubbed else "bounded limit cycle of the quantiser"
        return "locally stable, unstable for large motion" if rubbed else "unstable"


def _bounds(loop: LinearLoop, damping: float, share: float) -> list[Bound]:
    subject, half, late = loop.subject, 0.5 * loop.tick_s, loop.late_s
    port, needed = subject.port_damping, share * abs(damping)
    proven: Meaning = "exact" if _rigid(subject) else "sufficient"
    one_rate = loop.divider == 1
    name = "Colgate and Schenkel" if one_rate else "multi-rate passivity"
    source = "Colgate and Schenkel 1994, as quoted" if one_rate else "own derivation, by lifting"
    formula = "b ≥ K·T1/2 + β·B"
    if late == 0.0:
        ideal = Bound(name, formula, source, _positive((port - needed) / half), proven)
        return [ideal, *_rules(loop, damping)]
    exact = Bound(
        "passivity, lag and delay counted",
        "no motion gets work out of rig and wall",
        "own derivation, by lifting",
        passive_stiffness(loop, [damping], _port_damping(loop))[0],
        proven,
    )
    # A damper is most critical in fast motion, and a closed form has a single b: behind a lag none holds for B > 0.
    # With the b of slow motion it would be twice too high for koul-rigid at B = 0.02, uniform at 20 kHz.
    if damping != 0.0 and _fast_damping(subject) < subject.damping:
        return [exact]
    # At B = 0 slow motion decides, which is rigid and meets all damping, back-EMF too (koul-rigid within 3 % of exact,
    # but twice too high with hardly any other damping and a lag of about a tick). Else b is that of the motor side.
    b = subject.damping if damping == 0.0 else port
    meaning: Meaning = "necessary" if damping == 0.0 else "approximate"
    return [
        exact,
        Bound(
            f"{name}, lag and delay",
            "b ≥ K·(T1/2 + lag + delay) + β·B",
            "own derivation, by lifting",
            _positive((b - needed) / (half + late)),
            meaning,
        ),
        Bound(name, formula, source, _positive((b - needed) / half), meaning),
        *_rules(loop, damping),
    ]


def _rules(loop: LinearLoop, damping: float) -> list[Bound]:
    subject, half, late = loop.subject, 0.5 * loop.tick_s, loop.late_s
    mechanics, quantum = subject.model.mechanics, subject.model.encoder.resolution
    friction = 2.0 * (mechanics.motor_coulomb + mechanics.link_coulomb) / quantum
    if damping != 0.0:
        return []
    return [
        Bound(
            "Gil",
            "K < b/(T1/2 + lag + delay)",
            "Gil et al., from memory; at B = 0 the rule for a rigid rig",
            _positive(subject.damping / (half + late)),
            "approximate",
        ),
        Bound(
            "Abbott and Okamura",
            "K ≤ min(2b/T1, 2·f_c/Δ)",
            "Abbott and Okamura 2005, abstract and lecture notes",
            min(subject.port_damping / half, friction),
            "sufficient" if late == 0.0 and _rigid(subject) else "approximate",
        ),
        Bound(
            "Diolaiti, no limit cycle",
            "b/(2·K·(T1/2 + lag + delay)) > ½ and f_c/(K·Δ) > ½",
            "Diolaiti et al. 2006, thresholds from memory",
            min(subject.damping / (half + late), friction),
            "approximate",
        ),
    ]


def _fast_damping(subject: Subject) -> float:
    """Return the damping of a fast rigid motion (N·m·s/rad or N·s/m): back-EMF that acts behind a lag is left out."""
    amplifier = subject.model.amplifier
    return subject.damping - (amplifier.back_emf if amplifier.lag_s > 0.0 else 0.0)


def _rigid(subject: Subject) -> bool:
    return subject.model.mechanics.structure == "rigid"


def rigid_b_max(loop: LinearLoop) -> float:
    """Return the approximate largest stable damping of a wall on a rigid rig, b + (π/2)·J/τ (N·m·s/rad or N·s/m).

    J is the rig's inertia and b its damping, without back-EMF behind a lag. The loop of a damper is an integrator
    1/(J·s) behind the delay τ: that of the estimator at zero frequency, half the hold, lag and computation.
    """
    # The b of fast motion: with that of slow motion the rule would be too high by up to 1.8 times.
    # τ counts as a pure delay without attenuation, so the rule is too low: by 4 % if the filter of a dual-rate wall
    # dominates, by 20 % if the lag or a difference without filter does.
    hold = loop.tick_s if loop.extrapolate else loop.period_s
    tau = estimator_delay_s(loop) + 0.5 * hold + loop.late_s
    return _fast_damping(loop.subject) + 0.5 * math.pi * loop.subject.inertia / tau


def estimator_delay_s(loop: LinearLoop) -> float:
    """Return the delay (s) of the velocity estimator (difference and filter together) for slow motions."""
    frequency = SLOW * 0.5 / loop.period_s
    value = complex(loop.estimator.response(frequency)[0]) / (2j * math.pi * frequency)
    return -math.atan2(value.imag, value.real) / (2.0 * math.pi * frequency)


def _positive(stiffness: float) -> float:
    return max(stiffness, 0.0)
