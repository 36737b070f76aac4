"""The wall of a running loop, changed while a hand feels it.

The change passes the same checks as an experiment before it starts, the arming gate's included, and reaches the loop
through its mailbox as one set, which it takes over while the handle is outside the wall, so that no effort jumps.

`rig set` and the console call it. It must not write a parameter into the loop's memory but through the mailbox, nor
post one that a check refused.
"""

from __future__ import annotations

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
PATIENCE_S = 10.0  # how long the handle may stay inside the wall before we stop watching
POLL_S = 0.01
REMEMBERED = 100  # changes that the info of a run lists
TRIES = 20  # against others who change the same wall


@dataclass(frozen=True, slots=True)
class LiveChange:
    """A change of a running wall.

    Attributes
    ----------
    pid
        Process of the loop.
    number
        Number of the parameter set, which the column ``parameter_set`` of the recording shows from then on.
    changes
        Requested changes, by dotted key.
    wall
        The whole section ``[wall]`` with it.
    active
        True if the loop used the set when it was last read.
    ended
        True if the loop had ended by then.
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
    """Change the wall of the loop that runs in real time on this computer.

    Parameters
    ----------
    changes
        New values by key, ``{"wall.stiffness": 400.0}`` or ``{"stiffness": 400.0}``.
    pid
        Process of the loop, when several run.
    patience_s
        How long to watch for the loop to take it over.
    posted
        Called with the number of the set as soon as it is on its way.

    Raises
    ------
    ConfigError
        No loop runs, a key that may not change, or a value out of its range.
    PlanError
        A wall that a plan would refuse, or the gate before arming (`rig.doctor.gate`), or a law on the device; or
        a bilateral wall.
    RunEndedError
        The loop ended before.
    RigError
        Another version started the loop, or it says too little about itself.
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
    """Return numbers of a set for the loop: the wall's position, then the parameters of its law.

    Raises
    ------
    ConfigError
        The law cannot be designed so.
    PlanError
        A plan of this experiment would be refused.
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
            f"{name} cannot change while a loop runs", remedy=f"parameters that may change: {_allowed()}"
        )
    return f"{SECTION}.{leaf}"


def _allowed() -> str:
    return ", ".join(f"{SECTION}.{leaf}" for leaf in CHANGEABLE)


def _post(ring: Ring, changes: Mapping[str, Any]) -> tuple[int, Experiment]:
    """Compute the set from what the loop runs now, and post it; retry if another program changed the loop meanwhile."""
    for _ in range(TRIES):
        info, word = ring.info_and_word()
        if "experiment" not in info or "current_quantum_a" not in info:
            raise RigError(
                "the loop does not report which experiment it runs", remedy="change it from its own program"
            )
        if info.get("law"):
            raise ConfigError(
                "the law of this loop is defined in its own program: its parameters are unknown here",
                remedy="change them in that program",
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
        if experiment.controller.loop == "device":  # refused here, where the caller receives the error
            armed = controller.for_experiment(running_now, **device)
            device_law.live_parameters(armed, device_law.arithmetic_of(experiment.controller), values)
        if ring.get(LOOP_DONE):
            raise RunEndedError("the loop has ended", remedy="start another one")
        number = ring.replace(values, partial(_info_with, info, experiment, changes), word)
        if number:
            return number, experiment
    raise RigError(
        "other programs keep changing the same wall", remedy="let only one program change the wall"
    )


def _check_sides(experiment: Experiment) -> None:
    """Refuse a wall whose spring acts on both sides: no place is free of it, and each change would be a jump."""
    if experiment.wall.law in BILATERAL:
        raise PlanError(
            f"the spring of a {experiment.wall.law} wall acts on both sides, so it cannot change "
            "while it runs",
            remedy="end the run and start it with the other wall",
        )


def _info_with(
    info: Mapping[str, Any], experiment: Experiment, changes: Mapping[str, Any], number: int
) -> dict[str, Any]:
    """Return the info of the run from now on: what it runs, and which changes came, the newest last."""
    sets = [*info.get("parameter_sets", ()), {"number": number, "changes": dict(changes)}]
    return {**info, "experiment": config.as_mapping(experiment), "parameter_sets": sets[-REMEMBERED:]}


def _watch(ring: Ring, number: int, patience_s: float) -> bool:
    """Return True if the loop uses this parameter set, or a newer one, before patience or the loop ends."""
    deadline = time.monotonic() + patience_s
    while True:
        ended = ring.get(LOOP_DONE) != 0  # before the number: what is not there now will never come
        if ring.get(PARAMETER_SET) >= number:
            return True
        if ended or time.monotonic() > deadline:
            return False
        time.sleep(POLL_S)
