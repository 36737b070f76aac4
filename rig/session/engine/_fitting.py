"""Check that the device of a session can run every condition, before a session writes anything.

The start of a session and the check of a device use it. It must not move the motor.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from rig.config import Experiment
from rig.core.check import Check, refuse
from rig.session.engine._runner import TrialRunner
from rig.session.planning._comparisons import SEVERITY
from rig.session.planning._conditions import Walls, own_rates
from rig.session.planning._schedule import levels_of


def fit_checks(walls: Walls, runner: TrialRunner) -> list[Check]:
    """Check that device and link can run each condition at each damping; return the worst result of each check."""
    worst: dict[str, Check] = {}
    for experiment, changes in _stiffest(walls):
        for one in runner.fits(experiment, changes):
            known = worst.get(one.name)
            if known is None or SEVERITY.index(one.outcome) > SEVERITY.index(known.outcome):
                worst[one.name] = replace(one, remedy=_remedy(one, walls, runner))
    return list(worst.values())


def refuse_misfit(walls: Walls, runner: TrialRunner) -> None:
    """Raise `PlanError` if the device cannot run one of the conditions (settings) that the session compares."""
    refuse(fit_checks(walls, runner))


def _stiffest(walls: Walls) -> Iterator[tuple[Experiment, Mapping[str, Any]]]:
    for condition in walls.protocol.condition:
        stiffest = levels_of(walls.protocol.search_of(condition))[-1]
        for damping in condition.damping:
            experiment = walls.at(condition, damping, stiffest)
            yield experiment, own_rates(condition, experiment)


def _remedy(one: Check, walls: Walls, runner: TrialRunner) -> str:
    """Return a remedy for a failed check that names keys of the protocol instead of options for a single trial."""
    if one.name == "rig of the device" and any(condition.fit for condition in walls.protocol.condition):
        return (
            f"{one.remedy}; a board has one encoder: run conditions with another encoder as a separate study"
        )
    if one.name not in ("device rate", "link capacity"):
        return one.remedy
    slower = "give the conditions slower schemes, as in the template first-steps"
    return f"{slower}; or rehearse in virtual time" if runner.simulated else slower
