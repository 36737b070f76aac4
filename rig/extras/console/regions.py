"""Which stiffnesses linear theory finds passive, stable and risky at a damping: what lies under a slider's thumb."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rig.analysis.theory import passive_curve
from rig.config import Experiment
from rig.core.errors import RigError
from rig.core.operators import hand_text
from rig.doctor.late_loops import LateLoops
from rig.extras.console.hits import apply_changes, experiment_of


@dataclass(frozen=True, slots=True)
class Regions:
    """Limits of stiffness at one damping, for the scheme and the delay in effect.

    Attributes
    ----------
    damping
        B (SI).
    passive
        Largest passive stiffness; None where no wall is passive or theory does not say.
    stable
        Largest stiffness that is stable in every hand, and the hand that binds; None where theory says nothing.
    stable_own
        Largest one that is stable in the experiment's own hand, or without one.
    hand
        In which `stable` binds.
    note
        What the numbers leave out, or why they are missing.
    """

    damping: float
    passive: float | None
    stable: float | None
    stable_own: float | None
    hand: str
    note: str


def find_regions(rig: str, changes: Mapping[str, Any], damping: float, delay_ticks: int) -> Regions:
    """Return limits for a rig with a page's changes, as `rig.extras.console.hits.apply_changes` has it."""
    return regions(apply_changes(experiment_of({"rig": rig}), changes), delay_ticks, damping)


def regions(experiment: Experiment, delay_ticks: int, damping: float) -> Regions:
    """Find the limits.

    Parameters
    ----------
    experiment
        In effect: rates, estimator and hand count, its wall does not.
    delay_ticks
        That the link was measured to have.
    damping
        Of the wall (SI).
    """
    try:
        late = LateLoops.of(experiment, delay_ticks)
        limits = late.k_max([damping])[0]
        least = min(limits, key=lambda hand: limits[hand])
        passive = min(_passive(late, [damping]))
    except RigError as error:
        return Regions(damping, None, None, None, "", error.message)
    own = experiment.operator.grip if experiment.trial.kind == "human" else "none"
    return Regions(
        damping=damping,
        passive=passive if passive > 0.0 else None,
        stable=limits[least],
        stable_own=limits.get("the experiment's own", limits.get(own)),
        hand=hand_text(least),
        note=late.stand_in,
    )


def _passive(late: LateLoops, dampings: Sequence[float]) -> list[float]:
    """Largest passive stiffness at each damping, the smaller of the velocity rates; no hand belongs to the bound."""
    return [
        min(curve)
        for curve in zip(*(passive_curve(loop, dampings) for loop in late.by_hand["none"]), strict=True)
    ]
