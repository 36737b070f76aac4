"""Change the wall of a running loop.

`rig set` and the console call this module. It must write parameters into the loop's memory only through the loop's
mailbox (shared memory for one parameter set), and must not post a parameter set that a check refused. A change must
pass the same checks as an experiment before its start, the arming gate included. The loop uses the new parameters as
soon as the handle is outside the wall, so that the effort does not jump.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from rig import config
from rig.config import Experiment, controller, device_law
from rig.control.on_device import BILATERAL
from rig.core.check import refuse
from rig.core.errors import ConfigError, PlanError, RigError, RunEndedError
from rig.doctor.gate import check_change
from rig.experiments.trials.plan import plan_of
from rig.realtime import running
from rig.realtime.control_words import LOOP_DONE, PARAMETER_SET
from rig.realtime.ring import Ring

SECTION = "wall"
CHANGEABLE = ("stiffness", "damping", "position", "pull", "damping_on")
# Default time to wait until the handle has left the wall, so that the loop uses the change (s).
PATIENCE_S = 10.0
POLL_S = 0.01
REMEMBERED = 100  # number of changes in the public description of a run
TRIES = 20  # attempts if other programs change the same wall


@dataclass(frozen=True, slots=True)
class LiveChange:
    """A change of the wall of a running loop.

    Attributes
    ----------
    pid
        Process identifier of the loop.
    number
        Number of the new parameter set; the recording's column ``parameter_set`` has this number while the set is used.
    changes
        Requested values by dotted key.
    wall
        Values of all keys of the section ``[wall]`` after the change.
    active
        True if the loop used the new parameter set, or a newer one, before `change_wall` returned.
    ended
        True if the loop had ended before `change_wall` returned.
    """

    pid: int
    number: int
    changes: dict[str, Any]
    wall: dict[str, Any]
    active: bool
    ended: bool


def change_wall(
    changes: Mapping[str, Any],
    pid: int | None = None,
    *,
    patience_s: float = PATIENCE_S,
    posted: Callable[[int], None] | None = None,
) -> LiveChange:
    """Change the wall of the loop that runs in real time on this computer, and wait until the loop uses the change.

    Parameters
    ----------
    changes
        New values by key, ``{"wall.stiffness": 400.0}`` or ``{"stiffness": 400.0}``.
    pid
        Process identifier of the loop; needed if several loops run.
    patience_s
        Longest time to wait until the loop uses the new wall (s).
    posted
        Called with the number of the parameter set as soon as the set is posted.

    Raises
    ------
    ConfigError
        No loop runs, a key may not change while a loop runs, or a value is out of its range.
    PlanError
        The plan's checks, the check of stability with the link's delay, or the law on the device refuse the wall; or
        the wall is bilateral (with a spring on both sides).
    RunEndedError
        The loop has ended.
    RigError
        Another version of this software started the loop, the loop does not report its experiment, or other programs
        change the wall at the same time.
    """
    meant = {_key(name): value for name, value in changes.items()}
    if not meant:
        raise ConfigError("no parameter to change is given", remedy=f"give one of {_allowed()}, as KEY=VALUE")
    loop = running.the_loop(pid)
    with running.open_loop(loop) as ring:
        number, experiment = _post(ring, meant)
        if posted is not None:
            posted(number)
        active = _watch(ring, number, patience_s)
        wall = config.as_mapping(experiment)[SECTION]
        return LiveChange(loop.pid, number, meant, wall, active, bool(ring.get(LOOP_DONE)))


def parameter_set(experiment: Experiment, *, current_quantum_a: float, reference_count: int) -> list[float]:
    """Return the numbers that set a wall in the loop: its position (rad or m), then the parameters of its law.

    Raises
    ------
    ConfigError
        The law cannot be computed with the experiment's values.
    PlanError
        A check of the experiment's plan refuses the experiment.
    """
    run = controller.prepare_controller(
        experiment, current_quantum_a=current_quantum_a, reference_count=reference_count
    )
    refuse(plan_of(run).checks)
    made = run.controller
    return [float(made.control[0]["wall_position"]), *made.law.parameters.tolist()]


def _key(name: str) -> str:
    section, _, leaf = name.strip().rpartition(".")
    if section not in ("", SECTION) or leaf not in CHANGEABLE:
        raise ConfigError(
            f"{name} cannot change while a loop runs", remedy=f"change one of these keys: {_allowed()}"
        )
    return f"{SECTION}.{leaf}"


def _allowed() -> str:
    return ", ".join(f"{SECTION}.{leaf}" for leaf in CHANGEABLE)


def _post(ring: Ring, changes: Mapping[str, Any]) -> tuple[int, Experiment]:
    """Write the changed wall's parameters to the loop; return their number and the changed experiment.

    Retry if another program changed the wall at the same time.
    """
    for _ in range(TRIES):
        info, word = ring.info_and_word()
        if "experiment" not in info or "current_quantum_a" not in info:
            raise RigError(
                "the loop does not report which experiment it runs",
                remedy="change the wall in the program that runs the loop",
            )
        if info.get("law"):
            raise ConfigError(
                "the law of this loop is defined in the program that runs it, so its parameters are unknown here",
                remedy="change the wall in the program that runs the loop",
            )
        running_now = config.experiment_from_mapping(info["experiment"], "the running experiment")
        _check_sides(running_now)
        experiment = config.override(running_now, changes, "the change")
        if info.get("gate"):
            check_change(experiment, info["gate"])
        device = {
            "current_quantum_a": info["current_quantum_a"],
            "reference_count": info.get("reference_count", 0),
        }
        values = parameter_set(experiment, **device)
        # Check the values for the device here, where the caller receives the error, and not in the loop.
        if experiment.controller.loop == "device":
            armed = controller.for_experiment(running_now, **device)
            device_law.live_parameters(armed, device_law.arithmetic_of(experiment.controller), values)
        if ring.get(LOOP_DONE):
            raise RunEndedError("the loop has ended", remedy="start another run")
        number = ring.replace(values, partial(_info_with, info, experiment, changes), word)
        if number:
            return number, experiment
    raise RigError(
        f"other programs changed the same wall during each of {TRIES} attempts",
        remedy="let only one program change the wall",
    )


def _check_sides(experiment: Experiment) -> None:
    """Raise `PlanError` for a wall with a spring on both sides: the handle is always inside, so effort would jump."""
    if experiment.wall.law in BILATERAL:
        raise PlanError(
            f"the spring of a {experiment.wall.law} wall acts on both sides: the effort would "
            "jump if the wall changed while the loop runs",
            remedy="end the run and start it with the other wall",
        )


def _info_with(
    info: Mapping[str, Any], experiment: Experiment, changes: Mapping[str, Any], number: int
) -> dict[str, Any]:
    """Return what a run publishes about itself, with the changed experiment and its changes, the newest last."""
    sets = [*info.get("parameter_sets", ()), {"number": number, "changes": dict(changes)}]
    return {**info, "experiment": config.as_mapping(experiment), "parameter_sets": sets[-REMEMBERED:]}


def _watch(ring: Ring, number: int, patience_s: float) -> bool:
    """Return True if the loop uses parameter set `number` or a newer one before it ends or `patience_s` has passed."""
    deadline = time.monotonic() + patience_s
    while True:
        # Read the end before the number: after the end no newer number can follow.
        ended = ring.get(LOOP_DONE) != 0
        if ring.get(PARAMETER_SET) >= number:
            return True
        if ended or time.monotonic() > deadline:
            return False
        time.sleep(POLL_S)
