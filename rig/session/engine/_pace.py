"""Measure, before a session begins, how many samples this computer and the link lose; report the result and log it.

A session is refused if a hit in each quarter of the measurement would have been invalid by the limits of `[verdict]` on
lost samples, because nearly every trial would then be invalid. The operator can accept that (`lossy_anyway`). Smaller
losses give a warning; trials that become invalid by these losses are repeated.
"""

from collections.abc import Iterator

from rig.core.check import Check, Outcome, refuse
from rig.doctor.gate import LOST_SHARE
from rig.doctor.pace import Pace
from rig.session.engine._runner import TrialRunner
from rig.session.planning._conditions import Walls, own_rates


def refuse_lossy(walls: Walls, runner: TrialRunner) -> None:
    """Raise `PlanError` if nearly every trial would be invalid by lost samples, unless the operator accepts that.

    The losses are measured at the fastest rate of the session; `lossy_anyway` of `runner` accepts them.
    """
    found = list(pace_checks(walls, runner))
    if not runner.lossy_anyway:
        refuse(found)


def pace_checks(walls: Walls, runner: TrialRunner) -> Iterator[Check]:
    """Yield a check of how many samples are lost at the fastest rate that a session uses; nothing moves.

    Yield nothing in virtual time, and for control laws that run on the device, because the host causes no losses then.
    """
    if runner.virtual:
        return
    under = [(walls.softest(one), one) for one in walls.protocol.condition]
    by_host = [
        (experiment, condition) for experiment, condition in under if experiment.controller.loop != "device"
    ]
    if not by_host:
        return
    experiment, condition = max(by_host, key=lambda one: one[0].controller.position_rate)
    found = runner.pace(experiment, own_rates(condition, experiment))
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
    """Return a text about how to avoid the measured losses of samples, e.g. a lower rate."""
    slower = "" if found.kept_hz is None else f"run at {found.kept_hz} Hz"
    ways = [slower, "rehearse" if simulated else "", "close other programs and run `rig doctor`"]
    return ", or ".join(filter(None, ways))


def sentence(found: Pace, *, simulated: bool) -> str:
    """Return a sentence about lost samples and how to avoid them; "" if no sample was lost."""
    return found.text and f"{found.text}; {remedy(found, simulated=simulated)}"
