"""Check the plan of a study: expected limits, theory, motor heat, energy, order of conditions, rests, stop rules.

`rig.session.engine._check` calls it. It must not open a device.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from rig.config import Experiment
from rig.core.check import Check, Outcome
from rig.core.errors import RigError
from rig.core.sample import Motion, unit_of
from rig.experiments.trials.plan import CUTOFFS, make_plan
from rig.session.planning._bands import BANDS
from rig.session.planning._expected import ExpectedRange
from rig.session.planning._plan import CellPlan
from rig.session.planning._protocol import Protocol, Trial
from rig.session.planning._schedule import schedule
from rig.session.planning._simulated_hand import simulate_hits
from rig.session.planning._times import Heat, TrialTimes

TIRES_S = 1200.0  # chosen: a hand tires after this time without a rest
# Step between levels, relative to the expected limit, above which a search resolves too little.
COARSE = 0.25
# Chosen: fewer trials than this between two cooling pauses make people impatient.
SLOW = 4
FAR = 10.0  # times the stiffest wall: a larger cap is probably a typing error
SEVERITY = (Outcome.OK, Outcome.WARNING, Outcome.REFUSED)

Walls = Sequence[tuple[str, Experiment]]  # each with its condition


def wall_checks(walls: Walls) -> list[Check]:
    """Check every wall of a study as for a single hit; return the worst result of each check.

    The text of a result contains the number of walls that share it. Each of `walls` is a condition's name and an
    experiment with the wall.
    """
    worst: dict[str, tuple[Check, str]] = {}
    number: dict[tuple[str, Outcome], int] = {}
    for condition, experiment in walls:
        wall, unit = experiment.wall, unit_of("stiffness", experiment.rig.motion)
        where = f"{condition}, K = {wall.stiffness:g} {unit}, B = {wall.damping:g}"
        for one in _checks_of(experiment):
            number[one.name, one.outcome] = number.get((one.name, one.outcome), 0) + 1
            if one.name not in worst or _severity(one) > _severity(worst[one.name][0]):
                worst[one.name] = (one, where)
    return [
        Check(one.name, one.outcome, f"all {len(walls)} walls", "")
        if one.outcome is Outcome.OK
        else replace(
            one,
            text=f"{number[one.name, one.outcome]} of {len(walls)} walls, for example {where}: {one.text}",
        )
        for one, where in worst.values()
    ]


def _checks_of(experiment: Experiment) -> Sequence[Check]:
    try:
        # The check of cut-off frequencies helps to compare single experiments; a protocol states its conditions itself.
        return [check for check in make_plan(experiment).checks if check.name != CUTOFFS]
    except RigError as error:
        return (Check("law", Outcome.REFUSED, error.message, error.remedy),)


def _severity(check: Check) -> int:
    return SEVERITY.index(check.outcome)


def level_checks(cells: Sequence[CellPlan], motion: Motion) -> Iterator[Check]:
    """Check that theory expects each stiffness limit to lie within the levels that its search tests.

    A limit beyond the levels would be censored (only a bound is known), and no mean over participants could be
    computed.
    """
    unit = unit_of("stiffness", motion)
    beyond = []
    for cell in cells:
        limit, levels = cell.expected.limit, cell.levels
        if cell.expected.by_hand and limit.likely > levels[-1]:
            beyond.append(
                f"{_describe_search(cell)}: expected {limit.likely:.3g}, highest level {levels[-1]:g} {unit}"
            )
        elif cell.expected.by_hand and limit.likely < levels[0]:
            where = f"expected {limit.likely:.3g}" if limit.most else "no stable wall expected"
            beyond.append(f"{_describe_search(cell)}: {where}, lowest level {levels[0]:g} {unit}")
    yield Check(
        "expected limits",
        Outcome.WARNING if beyond else Outcome.OK,
        "some lie beyond the searched levels and would be censored: " + "; ".join(beyond)
        if beyond
        else "all lie within the searched levels",
        "change search.lowest or search.highest",
    )
    without_theory = [cell for cell in cells if not cell.expected.by_hand]
    if without_theory:
        note = without_theory[0].expected.note
        yield Check(
            "linear theory",
            Outcome.WARNING,
            f"gives no limit for {'; '.join(map(_describe_search, without_theory))}: {note}",
            "numbers of trials and times are then estimated from the levels; set search.lowest to a wall that is "
            "certainly stable",
        )
    coarse = [cell for cell in cells if _relative_step_at(cell.levels, cell.expected.limit.likely) > COARSE]
    if coarse:
        yield Check(
            "steps",
            Outcome.WARNING,
            f"levels are more than a quarter of the expected limit apart: {'; '.join(map(_describe_search, coarse))}",
            "choose a smaller search.step or search.ratio",
        )


def most_checks(cells: Sequence[CellPlan]) -> Iterator[Check]:
    """Check that each staircase has enough reversals before its largest number of verdicts (setting ``most``).

    The analysis excludes the limit of a search that ends with too few reversals.
    """
    short = [cell for cell in cells if cell.trials.ended_by_most]
    if short:
        each = "; ".join(
            f"{_describe_search(cell)}: {cell.trials.ended_by_most} of {cell.trials.simulated}"
            for cell in short
        )
        yield Check(
            "search.settings.most",
            Outcome.WARNING,
            "ends simulated searches before they have enough reversals, and the analysis excludes their limits: "
            + each,
            "raise search.settings.most, or lower search.settings.turns",
        )


def _relative_step_at(levels: Sequence[float], stiffness: float) -> float:
    around = (above - below for below, above in pairwise(levels) if below <= stiffness <= above)
    return max(around, default=0.0) / max(stiffness, levels[0])


def _describe_search(cell: CellPlan) -> str:
    return f"{cell.condition} at B = {cell.damping:g}"


def heat_check(protocol: Protocol, heat: Heat, trials: float) -> Check:
    """Check that the motor stays below its heat limit in a session of `trials` trials, and how often it must cool."""
    share = protocol.rest.heat
    text = (
        f"{100 * heat.after_one:.2g} % of the winding's heat budget per hit at {heat.load:.2g} of the nominal effort, "
        f"{100 * heat.peak:.2g} % at most"
    )
    if heat.after_one > 1.0:
        remedy = "use less effort, or shorten trial.duration_s"
        return Check("motor heat over a session", Outcome.REFUSED, text, remedy)
    if heat.first_pause:
        text += (
            f"; above {100 * share:g} % the motor cools: {heat.pauses} pauses of {heat.pause_s:.0f} s, the first "
            f"before trial {heat.first_pause}"
        )
        slow = heat.pauses * SLOW > trials
        remedy = "use less effort, shorten trial.duration_s, or raise rest.heat"
        return Check("motor heat over a session", Outcome.WARNING if slow else Outcome.OK, text, remedy)
    return Check("motor heat over a session", Outcome.OK, f"{text}; no pause is needed")


def energy_check(protocol: Protocol, by_condition: Sequence[Sequence[Experiment]]) -> Iterator[Check]:
    """Check that the energy (J) is limited that the motor of an unstable wall may give to a hand in one hit."""
    if protocol.trial.kind != "human":
        return
    limits = [one.rig.limits.energy for experiments in by_condition for one in experiments]
    free = any(limit is None for limit in limits)
    most = max((limit for limit in limits if limit is not None), default=0.0)
    yield Check(
        "energy cap",
        Outcome.WARNING if free else Outcome.OK,
        "the energy that the motor may give to a hand in a hit is not limited"
        if free
        else f"a hit ends when the motor has given {most:g} J",
        "set caps.energy to a few times the energy of stable practice hits (see watched in a recording's trailer)",
    )


def band_checks(trial: Trial, walls: Sequence[Experiment]) -> Iterator[Check]:
    """Check that the simulated hand, on these walls, keeps the required ranges of impact speed and press."""
    bands = {name: band for name in BANDS if (band := getattr(trial, name))}
    simulated = [simulate_hits(experiment) for experiment in walls] if bands else []
    for name, band in bands.items():
        quantity, _, words = BANDS[name]
        values = [one for hits in simulated for one in hits[name]]
        unit = unit_of(quantity, walls[0].rig.motion)
        key = "operator.press" if name == "press" else "operator.reach_s"
        yield Check(
            f"trial.{name}",
            Outcome.OK if band[0] <= min(values) and max(values) <= band[-1] else Outcome.WARNING,
            f"{words} of the simulated hand {min(values):.3g} to {max(values):.3g} {unit}, required {band[0]:g} to "
            f"{band[-1]:g} {unit}",
            f"widen this band, or change {key} of the simulated hand; a person may stay within it",
        )


def cap_checks(protocol: Protocol, by_condition: Sequence[Sequence[Experiment]]) -> Iterator[Check]:
    """Check that each limit in ``[caps]`` can act: one far above all possible values is probably a typing error."""
    caps = protocol.caps
    experiments = [one for of_condition in by_condition for one in of_condition]
    stiffest = max(
        [experiment.wall.stiffness for experiment in experiments] + list(protocol.practice.stiffness)
    )
    most = max(
        experiment.rig.limits.effort * experiment.rig.limits.speed * experiment.trial.duration_s
        for experiment in experiments
    )
    unit = unit_of("stiffness", experiments[0].rig.motion)
    remedy = "check the value for a wrong unit or power of ten, or omit the cap"
    if caps.stiffness is not None and caps.stiffness > FAR * stiffest:
        text = f"{caps.stiffness:g} {unit} has no effect: the stiffest wall is {stiffest:g} {unit}"
        yield Check("caps.stiffness", Outcome.WARNING, text, remedy)
    if caps.energy is not None and caps.energy > most:
        text = f"{caps.energy:g} J has no effect: at full effort and speed a hit gives {most:.2g} J"
        yield Check("caps.energy", Outcome.WARNING, text, remedy)


def order_checks(protocol: Protocol, rows: int) -> Iterator[Check]:
    """Check that the order of conditions is balanced over participants: their number must be a multiple of `rows`.

    Warn if all participants have the same order.
    """
    number = protocol.study.participants
    if protocol.order.kind == "latin-square":
        runs = sum(len(one.damping) for one in protocol.condition)
        whole = number % rows == 0
        nearest = list(dict.fromkeys([max(1, number // rows) * rows, (number // rows + 1) * rows]))
        yield Check(
            "order",
            Outcome.OK if whole else Outcome.WARNING,
            f"{number} participants; a Latin square of {runs} searches is balanced with multiples of {rows}",
            f"plan {' or '.join(map(str, nearest))} participants",
        )
    elif protocol.order.kind == "fixed" and len(protocol.condition) > 1:
        yield Check(
            "order",
            Outcome.WARNING,
            "the order is the same for all participants: practice and fatigue cannot be separated from conditions",
            'set order.kind = "latin-square" or "randomised"',
        )


def stop_checks(protocol: Protocol, trials: ExpectedRange, session_s: ExpectedRange) -> Iterator[Check]:
    """Check if a stop rule is likely to end a session before its expected number of trials and duration (s)."""
    stop = protocol.stop
    for name, limit, expected, unit in (
        ("trials", stop.trials, trials, "trials"),
        ("minutes", stop.minutes, session_s * (1.0 / 60.0), "min"),
    ):
        if limit is None:
            continue
        outcome = Outcome.REFUSED if expected.least > limit else Outcome.OK
        if outcome is Outcome.OK and expected.most > limit:
            outcome = Outcome.WARNING
        text = f"ends a session after {limit:g} {unit}; expected are {_range(expected)}"
        yield Check(f"stop.{name}", outcome, text, f"raise stop.{name}, or reduce the number of searches")


def rest_checks(protocol: Protocol, trials: ExpectedRange, times: TrialTimes) -> Iterator[Check]:
    """Check that a session with the expected number of trials gives the hand enough rest."""
    rest = protocol.rest
    if protocol.trial.kind != "human":
        return
    stretch = trials.most if not rest.every else min(float(rest.every), trials.most)
    blocks = len([block for block in schedule(protocol, 0) if not block.practice])
    if rest.between_blocks_s > 0.0:
        stretch = min(stretch, trials.most / blocks)
    tires = stretch * times.total > TIRES_S
    yield Check(
        "rest",
        Outcome.WARNING if tires else Outcome.OK,
        f"{stretch * times.total / 60.0:.2g} min at most without a rest",
        "set rest.every, or rest.between_blocks_s",
    )


def _range(expected: ExpectedRange) -> str:
    if round(expected.least) == round(expected.most):
        return f"{expected.likely:.0f}"
    return f"{expected.least:.0f} to {expected.most:.0f}, likely {expected.likely:.0f}"
