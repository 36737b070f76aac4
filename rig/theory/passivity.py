"""Conditions from the literature, and the multi-rate one: up to which stiffness a wall is passive, or should be stable.

With b the viscous damping of the rig, T1 and T2 the periods, β a property of the estimator:

* *Multi-rate passivity*, b ≥ K·T1/2 + β·B. The wall is two samplers in parallel, a spring at T1 and a damper at T2;
  passive one-ports at one port add. Without lag and delay it is sufficient for passivity, hence for stability with
  any passive hand; on two masses with b as the motor side meets it (`Subject.port_damping`). Lag and delay of the
  effort take that away: b ≥ K·(T1/2 + lag + delay) + β·B is then necessary for passivity and no longer sufficient.
  Own derivation by lifting; for T1 = T2 it is Colgate and Schenkel's theorem.
* *Colgate and Schenkel* (1994; read as quoted, Weir and Colgate's equation 8.2): a uniform wall H is passive iff
  b > T/2 · Re{(1 − e^{−jωT})·H(e^{jωT})}/(1 − cos ωT) for all ω: b > K·T/2 + |B| for an unfiltered difference.
* *Abbott and Okamura* (2005; abstract and lecture notes): with a quantum Δ and Coulomb friction f_c, without damping of
  the wall, K ≤ min(2b/T, 2f_c/Δ).
* *Diolaiti et al.* (2006; normalisation read, thresholds from memory): b/(K·T) > ½ and f_c/(K·Δ) > ½ leave no limit
  cycle; a delay joins T/2. Without damping of the wall.
* *Gil et al.* (from memory of the literature, checked against exact eigenvalues): K < (b + B)/(T/2 + delay), a linear
  condition for stability that is good while the damping acts much faster than the mass moves. At B = 0 it is the rule
  for a rigid rig, K_max = b/(T1/2 + lag + delay).

All are about a bilateral wall. What they leave out is in `rig.theory.loop`; only Abbott and Okamura and Diolaiti know
quantum and friction. None has its hand in it: they ask for any.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rig.model import Operator
from rig.theory.lifted import Lifted
from rig.theory.limits import as_lifted
from rig.theory.loop import LinearLoop, RigLike, SchemeLike

Meaning = Literal["exact", "sufficient", "necessary", "approximate"]

FREQUENCIES = 4000  # of the scan for β, and of each refinement
REFINEMENTS = 3
SLOW = 1e-3  # of Nyquist: where the delay of an estimator is read off


@dataclass(frozen=True, slots=True)
class Bound:
    """One condition at one damping.

    Attributes
    ----------
    name, formula, source
        Which one it is; the source says how far it was read.
    stiffness
        Up to which K it holds; 0 if for none.
    meaning
        *exact*, *sufficient* and *necessary* for passivity of the linear loop; *approximate* rules are about stability.
    """

    name: str
    formula: str
    source: str
    stiffness: float
    meaning: Meaning


@dataclass(frozen=True, slots=True)
class PassivityBound:
    """Multi-rate passivity of a rig under a scheme at a damping of the wall.

    Attributes
    ----------
    beta
        Share of B that the rig's damping must make up for: b ≥ K·T1/2 + β·B.
    rig_damping
        b, all viscous damping of a rigid motion.
    stiffness
        Largest K of b ≥ K·T1/2 + β·B; sufficient (and for uniform rates exact) without lag and delay.
    stiffness_with_lag
        Largest K of b ≥ K·(T1/2 + lag + delay) + β·B; necessary.
    largest_damping
        B above which no K is passive, b/β (infinite where β ≤ 0).
    bounds
        Every condition that applies at this damping, passivity first.
    """

    damping: float
    beta: float
    rig_damping: float
    stiffness: float
    stiffness_with_lag: float
    largest_damping: float
    bounds: tuple[Bound, ...]

    @property
    def binding(self) -> Bound:
        """The condition with the smallest stiffness; of equals the first."""
        return min(self.bounds, key=lambda bound: bound.stiffness)


def passivity_bound(
    rig: RigLike | Lifted,
    scheme: SchemeLike | None = None,
    damping: float = 0.0,
    *,
    operator: str | Operator | None = None,
) -> PassivityBound:
    """Multi-rate passivity and the conditions of the literature, at a damping of the wall (N·m·s/rad or N·s/m).

    Raises `rig.errors.ConfigError` as `rig.theory.loop.linear_loop` does.
    """
    loop = as_lifted(rig, scheme, operator).loop
    share = beta(loop, negative=damping < 0.0)
    needed = share * abs(damping)
    b, port = loop.subject.damping, loop.subject.port_damping
    return PassivityBound(
        damping=damping,
        beta=share,
        rig_damping=b,
        stiffness=_positive((port - needed) / (0.5 * loop.tick_s)),
        stiffness_with_lag=_positive((b - needed) / (0.5 * loop.tick_s + loop.late_s)),
        largest_damping=port / share if share > 0.0 else math.inf,
        bounds=tuple(_bounds(loop, damping, share)),
    )


def beta(loop: LinearLoop, *, negative: bool = False) -> float:
    """Damping of the rig that each unit of the wall's asks for, because it acts through this estimator and its hold.

    For velocities held over T2 this is Colgate and Schenkel's expression for H, the estimator, maximised over ω. In
    general the effort of a period is the vector g·H·θ with g_i = 1, or 1 + i·(1 − z⁻¹)/N when extrapolated, and the rig
    must make up for the largest eigenvalue of minus its Hermitian part, from increments of position to efforts.

    `negative` asks for a wall of negative damping.
    """
    sign = -1.0 if negative else 1.0
    low, high = SLOW * math.pi, math.pi
    best = -sign  # of slow motion, whose velocity every estimator knows
    for _ in range(REFINEMENTS):
        omega = np.linspace(low, high, FREQUENCIES)
        values = _needed(loop, omega, sign)
        i = int(np.argmax(values))
        best = max(best, float(values[i]))
        low, high = float(omega[max(i - 1, 0)]), float(omega[min(i + 1, len(omega) - 1)])
    return best


def diolaiti(rig: RigLike | Lifted, scheme: SchemeLike | None, stiffness: float) -> Diolaiti:
    """Where an undamped wall of this stiffness lies in the plane of Diolaiti et al.; see `Diolaiti`."""
    loop = as_lifted(rig, scheme).loop
    mechanics, quantum = loop.subject.model.mechanics, loop.subject.model.encoder.resolution
    coulomb = mechanics.motor_coulomb + mechanics.link_coulomb
    period = 2.0 * (0.5 * loop.tick_s + loop.late_s)
    return Diolaiti(loop.subject.damping / (stiffness * period), coulomb / (stiffness * quantum))


@dataclass(frozen=True, slots=True)
class Diolaiti:
    """Normalised damping b/(K·T) and Coulomb friction f_c/(K·Δ) of an undamped wall; ½ is the threshold of both.

    T/2 has lag and delay added to it. Source: Diolaiti, Niemeyer, Barbagli and Salisbury 2006; the regions from memory.
    """

    damping: float
    friction: float

    @property
    def region(self) -> str:
        """What the wall does."""
        damped, rubbed = self.damping > 0.5, self.friction > 0.5
        if damped:
            return "no limit cycle" if rubbed else "bounded limit cycle of the quantiser"
        return "locally stable, unstable for large motion" if rubbed else "unstable"


def _needed(loop: LinearLoop, omega: NDArray[np.float64], sign: float) -> NDArray[np.float64]:
    """Damping needed per unit of B at ω·T2 = `omega`."""
    n = loop.divider
    z = np.exp(1j * omega)
    gain = sign * loop.estimator.response(omega / (2.0 * np.pi * loop.period_s)) / (z - 1.0)
    if not loop.extrapolate or n == 1:
        return np.asarray(-loop.period_s * gain.real)
    shape = 1.0 + np.arange(n) * ((1.0 - 1.0 / z) / n)[:, None]
    along = gain * shape.sum(axis=1)
    size = n * (np.abs(gain) ** 2) * (np.abs(shape) ** 2).sum(axis=1)
    return np.asarray(0.5 * loop.tick_s * (-along.real + np.sqrt(size - along.imag**2)))


def _bounds(loop: LinearLoop, damping: float, share: float) -> list[Bound]:
    subject, half, late = loop.subject, 0.5 * loop.tick_s, loop.late_s
    needed = share * abs(damping)
    one_rate, rigid = loop.divider == 1, subject.model.mechanics.structure == "rigid"
    ideal = Bound(
        "Colgate and Schenkel" if one_rate else "multi-rate passivity",
        "b ≥ K·T1/2 + β·B",
        "Colgate and Schenkel 1994, as quoted" if one_rate else "own derivation, by lifting",
        _positive(((subject.damping if late > 0.0 else subject.port_damping) - needed) / half),
        "necessary" if late > 0.0 else "exact" if one_rate and rigid else "sufficient",
    )
    if late == 0.0:
        return [ideal, *_rules(loop, damping)]
    real = Bound(
        f"{ideal.name}, lag and delay",
        "b ≥ K·(T1/2 + lag + delay) + β·B",
        "own derivation, by lifting",
        _positive((subject.damping - needed) / (half + late)),
        "necessary",
    )
    return [real, ideal, *_rules(loop, damping)]


def _rules(loop: LinearLoop, damping: float) -> list[Bound]:
    subject, half, late = loop.subject, 0.5 * loop.tick_s, loop.late_s
    mechanics, quantum = subject.model.mechanics, subject.model.encoder.resolution
    friction = 2.0 * (mechanics.motor_coulomb + mechanics.link_coulomb) / quantum
    gil = Bound(
        "Gil",
        "K < (b + B)/(T1/2 + lag + delay)",
        "Gil et al., from memory; at B = 0 the rule for a rigid rig",
        _positive((subject.damping + damping) / (half + late)),
        "approximate",
    )
    if damping != 0.0:
        return [gil]
    return [
        gil,
        Bound(
            "Abbott and Okamura",
            "K ≤ min(2b/T1, 2·f_c/Δ)",
            "Abbott and Okamura 2005, abstract and lecture notes",
            min(subject.damping / half, friction),
            "sufficient" if late == 0.0 else "approximate",
        ),
        Bound(
            "Diolaiti, no limit cycle",
            "b/(2·K·(T1/2 + lag + delay)) > ½ and f_c/(K·Δ) > ½",
            "Diolaiti et al. 2006, thresholds from memory",
            min(subject.damping / (half + late), friction),
            "approximate",
        ),
    ]


def rigid_b_max(loop: LinearLoop) -> float:
    """Rule for the largest damping of a rigid rig: b + (π/2)·J/τ, τ the delay of the velocity path.

    The loop of a damper is an integrator 1/(J·s) behind a delay: that of the estimator at zero frequency, half the
    hold, lag and computation. It takes them all for a pure delay without attenuation, so it is low: by 4 % where the
    filter of a dual-rate wall dominates, by 20 % where the lag does, or a difference without a filter.
    """
    hold = loop.tick_s if loop.extrapolate else loop.period_s
    tau = estimator_delay_s(loop) + 0.5 * hold + loop.late_s
    return loop.subject.damping + 0.5 * math.pi * loop.subject.inertia / tau


def estimator_delay_s(loop: LinearLoop) -> float:
    """Delay of the estimator for slow motions (s): of the difference and of its filter."""
    frequency = SLOW * 0.5 / loop.period_s
    value = complex(loop.estimator.response(frequency)[0]) / (2j * math.pi * frequency)
    return -math.atan2(value.imag, value.real) / (2.0 * math.pi * frequency)


def _positive(stiffness: float) -> float:
    return max(stiffness, 0.0)
