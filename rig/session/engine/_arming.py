"""List the walls of a study that a real rig refuses because of the measured delay of its link.

The check before a motor is armed (`rig.doctor.gate`) refuses walls that would be unstable with this delay. A session
begins only if the operator has consented to all of these walls, which are therefore listed before a person touches the
handle. The start of a session and the check of a device use it. It must not arm or move the motor.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from rig.config import Experiment
from rig.core.check import Check, Outcome
from rig.core.errors import ConfigError, PlanError
from rig.core.sample import Motion, unit_of
from rig.devices.framed import FramedDevice
from rig.doctor import gate as gates
from rig.session.engine._runner import RefusedWalls, SessionWall, TrialRunner
from rig.session.planning._conditions import Walls, own_rates
from rig.session.planning._protocol import BLINDED
from rig.session.planning._schedule import levels_of

CONSENT = (
    "a search for the limit needs unstable walls: consent to them once with `arm_anyway` (every hit is cut off as "
    "described in the guide), search softer walls, or use a faster link"
)


def walls_of(walls: Walls) -> Iterator[SessionWall]:
    """Yield every wall that a session may present, practice walls included, grouped by condition and damping."""
    protocol = walls.protocol
    practised = protocol.practice.condition or protocol.condition[0].name
    for condition in protocol.condition:
        for damping in condition.damping:
            stiffness = set(levels_of(protocol.search_of(condition)))
            if condition.name == practised and damping == condition.damping[0]:
                stiffness |= set(protocol.practice.stiffness)
            stiffest = walls.at(condition, damping, max(stiffness))
            # A search for the limit asks for walls that do not hold, so on a real rig the gate refuses some of nearly
            # every study.
            for level in sorted(stiffness):
                under = replace(stiffest, wall=replace(stiffest.wall, stiffness=level))
                yield SessionWall(
                    condition=condition.name, experiment=under, changes=own_rates(condition, stiffest)
                )


def refusals(
    device: FramedDevice, under: Mapping[tuple[str, float], Sequence[Experiment]]
) -> tuple[RefusedWalls, ...]:
    """Measure the delay of the device's link; return the walls that this delay makes unstable by linear theory.

    The rig refuses to run these walls without the operator's consent. Nothing moves. Return () in virtual time.

    Parameters
    ----------
    device
        Open device without a running trial.
    under
        Experiments in ascending order of stiffness, for each pair of condition and damping.
    """
    if device.link.clock.virtual:
        return ()
    found = []
    for (condition, damping), experiments in under.items():
        softest = experiments[0]
        measurement = gates.measured_once(device, softest.host, softest.controller.position_rate)
        levels = gates.refused_among(softest, measurement, [one.wall.stiffness for one in experiments])
        if levels:
            softest_refused = replace(softest, wall=replace(softest.wall, stiffness=levels[0]))
            text = gates.gate(softest_refused, measurement).text
            found.append(
                RefusedWalls(
                    condition=condition, damping=damping, stiffness=levels, walls=len(experiments), text=text
                )
            )
    return tuple(found)


def refuse_unarmable(walls: Walls, runner: TrialRunner) -> None:
    """Raise `PlanError` if the rig refuses a wall of the session, unless the operator has consented (`arm_anyway`).

    For an operator who must not know the presented walls (blinded), the error contains only the number of refused
    walls.
    """
    blinded = walls.protocol.study.blind in BLINDED
    # The arming gate never refuses a simulated rig.
    if runner.simulated:
        return
    try:
        found = runner.refusals(tuple(walls_of(walls)))
    except PlanError as error:
        if not blinded:
            raise
        raise PlanError(
            "this rig cannot run every wall that the session may present",
            remedy="list these walls with rig session check, for the same device",
        ) from error
    if found and not runner.arm_anyway:
        refused_walls = (
            _number(found) if blinded else f"{_number(found)}: {_list_walls(found, walls.base.rig.motion)}"
        )
        raise PlanError(
            f"with the measured delay of the link the rig refuses {refused_walls}, unstable by linear theory",
            remedy=f"{CONSENT}; list them with rig session check, for the same device",
        )


def arming_checks(walls: Walls, runner: TrialRunner) -> Iterator[Check]:
    """Measure the link's delay; yield a check that lists the walls that it makes unstable, which need consent."""
    if runner.simulated:
        return
    try:
        found = runner.refusals(tuple(walls_of(walls)))
    except ConfigError as error:
        yield Check("arming", Outcome.REFUSED, error.message, error.remedy)
        return
    text = "with the measured delay of the link every wall may be armed"
    if found:
        listed = _list_walls(found, walls.base.rig.motion)
        text = f"with the measured delay of the link the arming gate refuses {_number(found)}: {listed}"
    yield Check("arming", Outcome.WARNING if found else Outcome.OK, text, CONSENT if found else "")


def _number(found: Iterable[RefusedWalls]) -> str:
    found = tuple(found)
    conditions = "" if len(found) == 1 else f" of {len(found)} searches"
    return f"{sum(len(one.stiffness) for one in found)} walls{conditions}"


def _list_walls(found: Iterable[RefusedWalls], motion: Motion) -> str:
    unit = unit_of("stiffness", motion)
    return "; ".join(
        f"{one.condition}, B = {one.damping:g}: {len(one.stiffness)} of {one.walls} walls, from "
        f"K = {min(one.stiffness):g} to {max(one.stiffness):g} {unit} ({one.text})"
        for one in found
    )
