"""Compute the stiffness limits of linear theory at one damping, which a page shows beside its slider.

`errand_worker` calls it, so that the server's process is not blocked.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rig.analysis.theory import NotLinearError, passive_curve
from rig.config import Experiment
from rig.core.errors import RigError
from rig.core.operators import hand_text
from rig.doctor.late_loops import LateLoops
from rig.extras.console.hits import apply_changes, experiment_of


@dataclass(frozen=True, slots=True)
class Regions:
    """Stiffness limits of linear theory (SI) at one damping, for the rates, estimator and delay of an experiment.

    Attributes
    ----------
    damping
        Damping of the wall (SI).
    passive
        Largest passive stiffness; 0 if no wall is passive, None if theory does not compute it.
    stable
        Largest stiffness that is stable with every model of the hand; None if theory gives no limit.
    stable_own
        Largest stiffness that is stable with the experiment's own hand, or without a hand.
    hand
        Hand that limits `stable`, as text.
    note
        What the limits do not include, or why they are missing.
    """

    damping: float
    passive: float | None
    stable: float | None
    stable_own: float | None
    hand: str
    note: str


def find_regions(rig: str, changes: Mapping[str, Any], damping: float, delay_ticks: int) -> Regions:
    """Compute the largest passive and stable stiffness by linear theory, with the settings that a page has changed.

    `damping` is the wall's (SI), `delay_ticks` the measured delay of the link.
    """
    return regions(apply_changes(experiment_of({"rig": rig}), changes), delay_ticks, damping)


def regions(experiment: Experiment, delay_ticks: int, damping: float) -> Regions:
    """Compute the stiffness limits at one damping (SI); those that theory does not give are None, and `note` says why.

    Rates, estimator and hand of the experiment are used, its wall is not; `delay_ticks` is the measured delay of the
    link.
    """
    try:
        late = LateLoops.of(experiment, delay_ticks)
        limits = late.k_max([damping])[0]
        least = min(limits, key=lambda hand: limits[hand])
        passive, note = None, late.stand_in
        try:
            passive = min(_passive(late, [damping]))
        except NotLinearError as error:
            note = error.message
    except RigError as error:
        return Regions(damping, None, None, None, "", error.message)
    own = experiment.operator.grip if experiment.trial.kind == "human" else "none"
    return Regions(
        damping=damping,
        passive=passive,
        stable=limits[least],
        stable_own=limits.get("the experiment's own", limits.get(own)),
        hand=hand_text(least),
        note=note,
    )


def _passive(late: LateLoops, dampings: Sequence[float]) -> list[float]:
    """Return the largest passive stiffness (SI) at each damping without a hand, valid at all velocity rates."""
    return [
        min(curve)
        for curve in zip(*(passive_curve(loop, dampings) for loop in late.by_hand["none"]), strict=True)
    ]
