"""Whether this computer and the link keep up with a session: measured before it begins, told, and kept in its log.

Nearly every trial would be invalid where every quarter of the measurement loses as large a share of the samples as
`verdict.late_fraction` allows of late ticks: such a session is refused, unless somebody says ``--lossy-anyway``. What
is lost beside that is a warning: the trials that it spoils are repeated.
"""

from __future__ import annotations

from rig.bench.doctor.pace import Pace
from rig.core.errors import PlanError
from rig.session.conditions import Walls, own_rates
from rig.session.runner import TrialRunner
from rig.session.schedule import levels_of


def refuse_lossy(walls: Walls, runner: TrialRunner) -> None:
    """Measure at the fastest rate of the session; raise `PlanError` where nearly every trial would be invalid.

    A law on the device loses no sample to the host, and nothing is measured.
    """
    if runner.virtual:
        return
    under = [
        (walls.at(one, one.damping[0], levels_of(walls.protocol.search_of(one))[0]), one)
        for one in walls.protocol.condition
    ]
    by_host = [(x, condition) for x, condition in under if x.controller.loop != "device"]
    if not by_host:
        return
    x, condition = max(by_host, key=lambda one: one[0].controller.position_rate)
    found = runner.pace(x, own_rates(condition, x))
    if found is not None and found.refused and not runner.lossy_anyway:
        raise PlanError(
            f"{found.text}: nearly every trial would be invalid",
            remedy=f"{remedy(found, simulated=runner.simulated)}; or accept that: --lossy-anyway",
        )


def remedy(found: Pace, *, simulated: bool) -> str:
    """What helps against losses."""
    slower = "" if found.kept_hz is None else f"run at {found.kept_hz} Hz"
    ways = [slower, "rehearse (--rehearse)" if simulated else "", "close other programs and see `rig doctor`"]
    return ", or ".join(filter(None, ways))


def sentence(found: Pace, *, simulated: bool) -> str:
    """What was measured and what helps, in one sentence; empty where nothing was lost."""
    return found.text and f"{found.text}; {remedy(found, simulated=simulated)}"
