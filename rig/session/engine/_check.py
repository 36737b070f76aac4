"""Plan a study and check it before a person touches the handle: trials, times, disk space, and every possible wall.

Numbers of trials and times are expected ranges (`rig.session.planning._expected`, `rig.session.planning._times`). Every
wall that a search rule may present is checked like a single hit (`rig.experiments.trials.plan`) and compared with
linear theory. `rig session check` and the start of each session use it. It writes nothing.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.check import Check, refuse
from rig.session.engine._protocol_changes import protocol_check
from rig.session.engine._taken import find_taken
from rig.session.planning._comparisons import (
    band_checks,
    cap_checks,
    energy_check,
    heat_check,
    level_checks,
    most_checks,
    order_checks,
    rest_checks,
    stop_checks,
    wall_checks,
)
from rig.session.planning._conditions import Walls, base_of
from rig.session.planning._disk import bytes_of_trial
from rig.session.planning._expected import (
    NO_TRIALS,
    NOTHING,
    ExpectedRange,
    ExpectedTrials,
    expected_limits,
    expected_trials,
)
from rig.session.planning._plan import CellPlan, StudyPlan
from rig.session.planning._protocol import Condition, Protocol
from rig.session.planning._schedule import Block, levels_of, rows_of, schedule
from rig.session.planning._simulated_hand import reach_for
from rig.session.planning._times import (
    BETWEEN_RUNS_S,
    QUESTION_S,
    REHEARSED_TICK_S,
    TrialTimes,
    heat_of,
    trial_times,
)


def check(
    protocol: Protocol,
    folder: Path,
    *,
    participants: int | None = None,
    of_device: Callable[[Walls], Iterable[Check]] | None = None,
    study: Path | None = None,
) -> StudyPlan:
    """Return the plan of a study with the results of all checks.

    Parameters
    ----------
    protocol
        Checked protocol.
    folder
        Directory of the protocol file, to which paths in the protocol are relative.
    participants
        Number of participants; by default the number in the protocol.
    of_device
        Function that checks the walls on a device (`rig.session.engine._device_checks`); by default no device is used.
    study
        Directory of the participants. Times measured in finished sessions replace the planned times of people, and the
        protocol is compared with the protocol of the earlier sessions.

    Raises
    ------
    ConfigError
        The rig does not allow one of the conditions.
    RigError
        The device cannot be opened.
    """
    if participants is not None:
        protocol = replace(protocol, study=replace(protocol.study, participants=participants))
    base = base_of(protocol, folder)
    walls = Walls(protocol, base, reach_for)
    by_condition = [_experiments(walls, condition) for condition in protocol.condition]
    cells = tuple(_plan_searches(protocol, by_condition))
    searches = sum((cell.trials for cell in cells), NO_TRIALS) * protocol.order.repeats
    practice = len(protocol.practice.stiffness)
    trials = searches.count + ExpectedRange(practice, practice, practice)
    stiffest = max(
        (one for experiments in by_condition for one in experiments), key=lambda one: one.wall.stiffness
    )
    asks, people = protocol.study.judge == "person", protocol.trial
    times = trial_times(
        by_condition[0][0], ready_s=people.ready_s, verdict_s=people.verdict_s if asks else 0.0
    )
    took = None if study is None else find_taken(protocol, study)
    times = times if took is None else took.of_people(times)
    heat = heat_of(stiffest, times, math.ceil(trials.most), protocol.rest.heat)
    blocks = schedule(protocol, 0)
    question_s = QUESTION_S if took is None else took.question
    duration = dict(_durations(protocol, blocks, trials, times, stiffest, question_s))
    rows = rows_of(protocol)
    checks = [
        *wall_checks([*_list_walls(protocol, by_condition), *_list_practice_walls(walls)]),
        *level_checks(cells, base.rig.motion),
        *most_checks(cells),
        *energy_check(protocol, by_condition),
        *band_checks(protocol.trial, [walls.softest(one) for one in protocol.condition]),
        *cap_checks(protocol, by_condition),
        heat_check(protocol, heat, trials.most),
        *order_checks(protocol, rows),
        *stop_checks(protocol, trials, sum(duration.values(), NOTHING)),
        *rest_checks(protocol, trials, times),
    ]
    if study is not None:
        checks += protocol_check(walls, study)
    if of_device is not None:
        checks += of_device(walls)
    return StudyPlan(
        title=protocol.study.title,
        rig=base.rig.name,
        motion=base.rig.motion,
        kind=protocol.trial.kind,
        participants=protocol.study.participants,
        rows=rows,
        blocks=sum(not block.practice for block in blocks),
        runs=sum(len(block.runs) for block in blocks if not block.practice),
        practice=practice,
        cells=cells,
        trials=trials,
        trial=times,
        taken=took,
        duration_s=duration,
        trial_bytes=max(bytes_of_trial(experiments[0]) for experiments in by_condition),
        disk_bytes=_disk_bytes(protocol, cells, by_condition),
        rehearsal_s=_rehearsal_s(protocol, cells, by_condition, times),
        heat=heat,
        orders=tuple(
            _name_searches(protocol, schedule(protocol, row)) for row in range(protocol.study.participants)
        ),
        hidden=tuple(_describe_hidden(protocol)),
        blinded=protocol.study.blind in ("both", "operator"),
        checks=tuple(checks),
    )


def refuse_walls(study: Walls) -> None:
    """Raise `PlanError` if the study may present a wall, also in practice, that is not allowed on this rig."""
    by_condition = [_experiments(study, condition) for condition in study.protocol.condition]
    walls = [*_list_walls(study.protocol, by_condition), *_list_practice_walls(study)]
    refuse(wall_checks(walls))


def _experiments(study: Walls, condition: Condition) -> list[Experiment]:
    levels = levels_of(study.protocol.search_of(condition))
    found = []
    for damping in condition.damping:
        stiffest = study.at(condition, damping, levels[-1])
        found += [replace(stiffest, wall=replace(stiffest.wall, stiffness=level)) for level in levels]
    return found


def _list_walls(
    protocol: Protocol, by_condition: Sequence[Sequence[Experiment]]
) -> Iterator[tuple[str, Experiment]]:
    for condition, experiments in zip(protocol.condition, by_condition, strict=True):
        for experiment in experiments:
            yield condition.name, experiment


def _list_practice_walls(study: Walls) -> Iterator[tuple[str, Experiment]]:
    protocol = study.protocol
    condition = protocol.condition_named(protocol.practice.condition or protocol.condition[0].name)
    for stiffness in protocol.practice.stiffness:
        yield "practice", study.at(condition, condition.damping[0], stiffness)


def _plan_searches(protocol: Protocol, by_condition: Sequence[Sequence[Experiment]]) -> Iterator[CellPlan]:
    known: dict[Any, ExpectedTrials] = {}
    for condition, experiments in zip(protocol.condition, by_condition, strict=True):
        wanted = protocol.search_of(condition)
        levels = levels_of(wanted)
        expected_by_damping = expected_limits(experiments[0], condition.damping, wanted)
        for damping in condition.damping:
            expected = expected_by_damping[damping]
            key = (repr(wanted), expected.limit)
            if key not in known:
                known[key] = expected_trials(wanted, expected.limit)
            free, held = expected.free, expected.in_hand
            yield CellPlan(
                condition=condition.name,
                damping=damping,
                scheme=Scheme.of(experiments[0]).label(experiments[0]),
                rule=wanted.rule,
                levels=levels,
                expected=expected,
                trials=known[key],
                unstable_free=None if free is None else tuple(k for k in levels if k > free),
                unstable_in_hand=None if held is None else tuple(k for k in levels if k > held[0]),
                fit=condition.fit,
            )


def _durations(
    protocol: Protocol,
    blocks: Sequence[Block],
    trials: ExpectedRange,
    times: TrialTimes,
    stiffest: Experiment,
    question_s: float,
) -> Iterator[tuple[str, ExpectedRange]]:
    """Yield name and expected duration (s) of each activity in a session, such as hits, rests and questions."""
    yield "homing and free space", trials * (times.homing + times.baseline)
    yield "hits", trials * (times.hit + times.release)
    yield "ready and verdict", trials * (times.ready + times.verdict)
    rest = protocol.rest
    if rest.every:
        taken = [math.floor(max(0.0, number - 1) / rest.every) for number in trials.values]
        yield "rests", ExpectedRange(*map(float, taken)) * rest.seconds
    counted = sum(not block.practice for block in blocks)
    yield (
        "between runs and blocks",
        _certain(
            BETWEEN_RUNS_S * sum(len(block.runs) for block in blocks) + rest.between_blocks_s * (counted - 1)
        ),
    )
    often = {"start": 1, "block": counted, "end": 1}
    questions = sum(often[item.when] for item in protocol.question)
    if questions:
        yield "questions", _certain(question_s * questions)
    cooling = [heat_of(stiffest, times, math.ceil(number), rest.heat).cooling_s for number in trials.values]
    if cooling[-1] > 0.0:
        yield "cooling of the motor", ExpectedRange(*cooling)


def _disk_bytes(
    protocol: Protocol, cells: Sequence[CellPlan], by_condition: Sequence[Sequence[Experiment]]
) -> ExpectedRange:
    of_a_trial = {
        condition.name: bytes_of_trial(experiments[0])
        for condition, experiments in zip(protocol.condition, by_condition, strict=True)
    }
    searches = [cell.trials.count * of_a_trial[cell.condition] for cell in cells]
    return sum(searches, NOTHING) * protocol.order.repeats


def _rehearsal_s(
    protocol: Protocol,
    cells: Sequence[CellPlan],
    by_condition: Sequence[Sequence[Experiment]],
    times: TrialTimes,
) -> ExpectedRange:
    rates = {
        condition.name: experiments[0].controller.position_rate
        for condition, experiments in zip(protocol.condition, by_condition, strict=True)
    }
    tick_s = times.recorded * REHEARSED_TICK_S
    searches = [cell.trials.count * (rates[cell.condition] * tick_s) for cell in cells]
    return sum(searches, NOTHING) * protocol.order.repeats


def _certain(value: float) -> ExpectedRange:
    return ExpectedRange(value, value, value)


def _name_searches(protocol: Protocol, blocks: Sequence[Block]) -> tuple[tuple[str, ...], ...]:
    several = {one.name for one in protocol.condition if len(one.damping) > 1}
    return tuple(
        tuple(
            f"{run.condition}, B = {run.damping:g}" if run.condition in several else run.condition
            for run in block.runs
        )
        for block in blocks
        if not block.practice
    )


def _describe_hidden(protocol: Protocol) -> Iterator[str]:
    blind = protocol.study.blind
    if blind in ("both", "operator"):
        yield "operator: the console shows no condition, stiffness or damping, and effort in words"
    if blind in ("both", "participant"):
        yield "participant: condition and wall are not disclosed"
    if blind == "none":
        yield "nothing is hidden: operator and participant know condition and wall"
