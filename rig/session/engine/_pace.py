"""Whether this computer and the link keep up with a session: measured before it begins, reported, stored in its log.

Nearly every trial would be invalid where a hit in each quarter of the measurement would have been, by the limits of
`[verdict]` on lost samples: such a session is refused, unless the operator accepts that (`lossy_anyway`).
Smaller losses give a warning: the trials that they spoil are repeated.
"""

from __future__ import annotations

from collections.abc import Iterator

from rig.core.check import Check, Outcome, refuse
from rig.doctor.gate import LOST_SHARE
from rig.doctor.pace import Pace
from rig.session.engine._runner import TrialRunner
from rig.session.planning._conditions import Walls, own_rates


def refuse_lossy(walls: Walls, runner: TrialRunner) -> None:
    """Measure at the fastest rate of a session; raise `PlanError` where nearly every trial would be invalid."""
    found = list(pace_checks(walls, runner))
    if not runner.lossy_anyway:
        refuse(found)


def pace_checks(walls: Walls, runner: TrialRunner) -> Iterator[Check]:
    """Say what is lost at the fastest rate of a session; nothing moves.

    Nothing is measured in virtual time, nor of a law on the device, which loses no sample to the host.
    """
    if runner.virtual:
        return
    under = [(walls.softest(one), one) for one in walls.protocol.condition]
    by_host = [(x, condition) for x, condition in under if x.controller.loop != "device"]
    if not by_host:
        return
    x, condition = max(by_host, key=lambda one: one[0].controller.position_rate)
    found = runner.pace(x, own_rates(condition, x))
    if found is None:
        return
    helps = remedy(found, simulated=runner.simulated)
    if found.hopeless:
        text = f"{found.text}: nearly every trial would be invalid"
        yield Check("samples", Outcome.REFUSED, text, f"{helps}; or accept the losses: `lossy_anyway`")
    elif found.lost_share > LOST_SHARE:
        yield Check("samples", Outcome.WARNING, found.text, helps)
    else:
        yield Check("samples", Outcome.OK, found.text or f"no sample is lost or late at {found.rate_hz} Hz")


def remedy(found: Pace, *, simulated: bool) -> str:
    """Return how to avoid the losses, for a real rig or a simulated one."""
    slower = "" if found.kept_hz is None else f"run at {found.kept_hz} Hz"
    ways = [slower, "rehearse" if simulated else "", "close other programs and run `rig doctor`"]
    return ", or ".join(filter(None, ways))


def sentence(found: Pace, *, simulated: bool) -> str:
    """Return a sentence with the losses and the remedy; empty if nothing was lost."""
    return found.text and f"{found.text}; {remedy(found, simulated=simulated)}"
