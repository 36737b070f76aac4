"""Define the plan of a run: its steps, its checks with their outcomes, and the run ready to start.

Hits, motions and excitations have such plans, and commands print them. This module must not open a device.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from rig.config import Experiment, device_law
from rig.config.prepared_run import PreparedRun
from rig.core.check import Check, Outcome, refused
from rig.core.errors import PlanError
from rig.core.present import Item, Row, reported, written
from rig.core.shown import Shown

ARITHMETIC_WORDS = {
    "fixed": "integers",
    "float32": "float32",
    "drive": "float32, except for the wall, which its drive renders",
}


@dataclass(frozen=True, slots=True)
class Step:
    """A step of a run: its name, a description, and its longest duration (s)."""

    name: str
    text: str
    duration_s: float


@dataclass(frozen=True, slots=True, repr=False)
class Plan(Shown):
    """A plan of a trial: its steps, its checks (passed, warning or refused), and how often the steps are repeated.

    `run` is the prepared run; None if the plan consists of several different runs, as in an identification.
    """

    rig: str
    repeats: int
    steps: tuple[Step, ...]
    checks: tuple[Check, ...]
    run: PreparedRun | None = field(default=None, repr=False)

    @reported
    def duration_s(self) -> float:
        """Return the longest duration of all steps and repeats together (s)."""
        return self.repeats * sum(step.duration_s for step in self.steps)

    @reported
    def ok(self) -> bool:
        """Return True if no check of the plan is refused, so that the run is permitted."""
        return not refused(self.checks)

    def brief(self) -> list[Item]:
        """Return the lines of a short report: the refused checks, then the steps."""
        refusals = [Row("refused", f"{check.name}: {check.text}") for check in refused(self.checks)]
        steps = [Row(step.name, step.text) for step in self.steps]
        return [f"plan of {self.rig}", *(refusals or [Row("refused", "nothing")]), *steps]

    def detailed(self) -> list[Item]:
        """Return the lines of a full report, as `rig experiment plan` prints it."""
        return [f"plan of {self.rig}", *self.items()]

    def items(self) -> list[Item]:
        """Return the lines to print: the steps, the longest duration of one repeat (s), and the checks."""
        longest = Row("", f"{self.repeats} × at most {written(self.duration_s / self.repeats)} s")
        return [*(Row(step.name, step.text) for step in self.steps), longest, *self.checks]


def limited(name: str, holds: bool, text: str, remedy: str, otherwise: Outcome = Outcome.REFUSED) -> Check:
    """Return a check called `name`: OK if the value is within its limit (`holds`), else with the outcome `otherwise`.

    `text` states the value and the limit; `remedy` is advice for the case that the limit is exceeded.
    """
    return Check(name, Outcome.OK if holds else otherwise, text, remedy)


def check_positive(named: Mapping[str, float | None]) -> None:
    """Raise `PlanError` if one of these arguments (values by name) is not a finite number above 0; skip None."""
    for name, value in named.items():
        if value is not None and not 0.0 < value < math.inf:
            raise PlanError(
                f"`{name}` = {value:g} is out of range: it must be finite and above 0",
                remedy="give a finite number above 0",
            )


def heat_check(experiment: Experiment, effort: float, seconds: float, remedy: str) -> Check:
    """Check that a cold motor does not overheat if it holds a constant `effort` (N·m or N) for `seconds`."""
    limits = experiment.rig.limits
    load = effort / limits.nominal_effort
    budget = load**2 * -math.expm1(-seconds / limits.thermal_time_constant_s)
    text = f"{100 * budget:.2g} % of the winding's budget, at {load:.2g} of the nominal effort"
    return limited("motor heat", budget <= 1.0, text, remedy)


def where_it_runs(experiment: Experiment) -> str:
    """Return a text on where the control law runs; if on the device, also its arithmetic and its data rate."""
    if experiment.controller.loop == "host":
        return "the law on this computer"
    arithmetic = ARITHMETIC_WORDS[device_law.arithmetic_of(experiment.controller)]
    return (
        f"the law on the device in {arithmetic}, which sends every tick, {device_law.batch_samples(experiment)} to a "
        f"frame ({device_law.bytes_per_second(experiment) / 1e3:.1f} kB/s)"
    )
