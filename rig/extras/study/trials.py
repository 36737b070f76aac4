"""Compute the two basic tables of an analysis: all trials of a study, and its runs (searches) with their limits.

All other tables and the exports follow from these two. Verdicts come from the log alone; no recording is read.
"""

import math
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from typing import Any

from rig.config.schemes import Scheme
from rig.extras.study.rows import ENDED_BY_MOST, LimitInterval, Measure, RunRow, TrialRow
from rig.extras.study.study import Study, StudySession
from rig.session.finished import (
    WALKING,
    Condition,
    Protocol,
    RecordedTrial,
    SearchRun,
    SessionState,
    levels_of,
)
from rig.session.search import (
    Ascending,
    CatchTrials,
    Censored,
    Estimate,
    JudgedProbe,
    contradiction,
    locate,
    step_at,
    verdicts_of,
)

PEOPLE = ("person", "simulated")  # who may have judged, besides the automatic verdict
# Numbers of the automatic verdict in tables.
NUMBERS = (
    "felt",
    "heard",
    "moved",
    "peak_penetration",
    "peak_effort",
    "impact_velocity",
    "press",
    "saturated_fraction",
)

AMENDED = "trials were amended after the search rule had used them; it would have chosen other walls"

Watch = Callable[[int, int], None]


def trials_of(study: Study) -> tuple[TrialRow, ...]:
    """Return a row for each recorded wall hit, by participant, also for trials that do not count (`TrialRow.void`)."""
    schemes = schemes_of(study)
    rows: list[TrialRow] = []
    for session in study.sessions:
        places = {
            run.number: place for place, (_, _, run) in enumerate(_runs_in_order(session.state), start=1)
        }
        logged = {event.content["trial"]: event.at for event in session.of_kind("trial")}
        rows += [
            _trial_row(session, trial, schemes, places.get(trial.run, 0), logged[trial.trial])
            for trial in session.state.trials
        ]
    return tuple(rows)


def runs_of(study: Study, *, watch: Watch | None = None) -> tuple[RunRow, ...]:
    """Return a row for each run (search) with at least one trial, in the order of the sessions."""
    schemes = schemes_of(study)
    rows: list[RunRow] = []
    for number, session in enumerate(study.sessions):
        if watch is not None:
            watch(number, len(study.sessions))
        for place, (block, order, run) in enumerate(_runs_in_order(session.state), start=1):
            if any(trial.run == run.number for trial in session.state.trials):
                rows.append(_run_row(session, block, order, place, run, schemes))
    if watch is not None:
        watch(len(study.sessions), len(study.sessions))
    return tuple(rows)


def schemes_of(study: Study) -> dict[str, str]:
    """Return a description of each condition by its name: sampling, estimator and other changes."""
    base = study.sessions[0].state.experiment["controller"]
    prefix = "controller."

    def own(condition: Condition) -> dict[str, Any]:
        changes = {**study.protocol.study.changes, **condition.changes}
        given = {key.removeprefix(prefix): value for key, value in changes.items() if key.startswith(prefix)}
        return {**base, **given}

    return {
        condition.name: ", ".join(
            [
                _scheme_words(condition.scheme, own(condition)),
                *(f"{key} = {value}" for key, value in condition.changes.items()),
            ]
        )
        for condition in study.protocol.condition
    }


def _scheme_words(text: str | None, own: Mapping[str, Any]) -> str:
    """Return rates, estimator and settings as text, from a sampling scheme or from the controller's own settings."""
    if text is None:
        rates = own["position_rate"], own["velocity_rate"]
        settings, estimator = dict(own["parameters"]), own["estimator"]
    else:
        scheme = Scheme.parse(text)
        rates = scheme.position_rate, scheme.velocity_rate
        estimator = scheme.estimator or own["estimator"]
        settings = dict(own["parameters"]) if estimator == own["estimator"] else {}
        if isinstance(settings.get("cutoff_hz"), int | float) and own.get("scheme_cutoff") != "same":
            # The cut-off keeps its ratio to the velocity rate, as in `Scheme.applied`.
            settings["cutoff_hz"] *= scheme.velocity_rate / own["velocity_rate"]
        settings |= scheme.parameters
        extra = {
            "prediction": scheme.prediction,
            "slow_velocity_rate": scheme.slow_velocity_rate,
            "slow_below": scheme.slow_below,
        }
        settings |= {key: value for key, value in extra.items() if value is not None}
    fast, slow = (f"{rate / 1e3:g}" for rate in rates)
    parts = [f"uniform {fast} kHz" if fast == slow else f"dual {fast}/{slow} kHz", str(estimator)]
    if isinstance(settings.get("cutoff_hz"), int | float):
        parts[-1] += f" {settings.pop('cutoff_hz'):g} Hz"
    return ", ".join([*parts, *(f"{key} {value}" for key, value in settings.items())])


def levels(protocol: Protocol, condition: str) -> tuple[float, ...]:
    """Return the stiffnesses (levels) that a condition's search may use, in ascending order."""
    return tuple(levels_of(protocol.search_of(protocol.condition_named(condition))))


def levels_by_participant(study: Study) -> dict[tuple[str, str], tuple[float, ...]]:
    """Return the stiffnesses that each participant's own protocol may use, by (participant's code, condition)."""
    return {
        (session.code, condition.name): levels(session.state.protocol, condition.name)
        for session in study.sessions
        for condition in session.state.protocol.condition
    }


def half_way(
    grid: Sequence[float], verdicts: Sequence[tuple[float, bool]], share: float | None = None
) -> LimitInterval:
    """Estimate the stiffness with this share of stable verdicts (None: 0.5), as the median of its posterior.

    `grid` are the levels (stiffnesses) of the search; `verdicts` are a stiffness, and True if it was judged stable.
    Verdicts of several searches are treated as if the limit were the same in all of them; if it drifts, the interval is
    too narrow. If the stiffness lies beyond the levels, the result is the nearest level.
    """
    share = share or 0.5
    found = locate(tuple(grid), verdicts, share)
    return LimitInterval(
        value=found.value,
        low=found.low,
        high=found.high,
        censored=found.censored,
        share=share,
        step=step_at(grid, found.value),
        mark="" if found.censored else contradiction(found.value, found.low, found.high, verdicts),
    )


def answers(state: SessionState, run: SearchRun, judge: str) -> list[JudgedProbe]:
    """Return the verdicts on the trials of one search (run), from one source.

    `judge` is "followed": the verdicts that the search rule received; "person": the same verdicts, or an empty list if
    no person judged a trial; or "automatic": whether each wall is stable under the study's criterion.
    """
    if judge == "followed":
        return state.judged_probes(run)
    counted = [t for t in state.trials_of(run) if t.judged]
    if judge == "automatic":
        criterion = state.protocol.study.criterion
        return [JudgedProbe(trial.probe, trial.passes[criterion]) for trial in counted]
    return state.judged_probes(run) if any(trial.judged_by in PEOPLE for trial in counted) else []


def _runs_in_order(state: SessionState) -> Iterable[tuple[int, int, SearchRun]]:
    for block in state.blocks:
        if not block.practice:
            for order, run in enumerate(block.runs, start=1):
                yield block.number, order, run


def _trial_row(
    session: StudySession, trial: RecordedTrial, schemes: dict[str, str], place: int, logged_at: float
) -> TrialRow:
    numbers, baseline = trial.numbers, trial.baseline or {}
    undecided = "invalid" if trial.invalid else "" if trial.verdict else "not judged"
    logged: dict[str, Any] = {**vars(trial), "void": trial.void or undecided}
    return TrialRow(
        **logged,
        **dict[str, Any]({name: numbers.get(name) for name in NUMBERS}),
        participant=session.code,
        row=session.state.row,
        place=place,
        scheme=schemes.get(trial.condition, ""),
        automatic_stable=trial.passes[session.state.protocol.study.criterion],
        amended=trial.trial in session.amended,
        since_begin_s=logged_at - session.began_at,
        baseline_velocity=baseline.get("velocity_rms"),
        baseline_effort=baseline.get("effort_rms"),
        recorded=session.recordings.get(trial.trial, "none"),
    )


def _run_row(
    session: StudySession, block: int, order: int, place: int, run: SearchRun, schemes: dict[str, str]
) -> RunRow:
    state = session.state
    search = state.protocol.search_of(state.protocol.condition_named(run.condition))
    trials = [trial for trial in state.trials if trial.run == run.number]
    counted = [trial for trial in trials if not trial.void]
    judged = [trial for trial in counted if trial.judged]
    limits, note = _limits(state, run, search.rule)
    followed = f"K50 {state.protocol.study.judge}"
    sides = {limit.censored for measure, limit in limits.items() if measure in ("rule", followed)}
    return RunRow(
        participant=session.code,
        row=state.row,
        block=block,
        order=order,
        run=run.number,
        place=place,
        condition=run.condition,
        scheme=schemes[run.condition],
        damping=run.damping,
        repeat=run.repeat,
        rule=search.rule,
        followed=state.protocol.study.judge,
        limits=limits,
        state=_state(state, run),
        trials=len(judged),
        invalid=sum(trial.invalid for trial in counted),
        voided=len(trials) - len(counted),
        hits=len(state.judged_probes(run)),
        caught=_caught(judged, levels(state.protocol, run.condition), sides),
        middle_trial=sum(t.trial for t in judged) / len(judged) if judged else math.nan,
        note=note,
    )


def _state(state: SessionState, run: SearchRun) -> str:
    if run.number in state.skipped:
        return "skipped"
    # What was found complete stays so when a correction afterwards would have the rule ask once more.
    done = state.asks(run) is None or (run.number in state.corrected and state.ended == "complete")
    if not done:
        return "unfinished"
    return ENDED_BY_MOST if state.rule(run).estimate(state.answers(run)).ended_by_most else "complete"


def _caught(
    judged: Sequence[RecordedTrial], levels: Sequence[float], sides: Container[Censored]
) -> CatchTrials:
    answers = [
        JudgedProbe(trial.probe, None if trial.verdict == "unsure" else trial.verdict == "stable")
        for trial in judged
    ]
    return CatchTrials.of(answers, levels, sides)


def _limits(state: SessionState, run: SearchRun, rule: str) -> tuple[dict[Measure, LimitInterval], str]:
    found: dict[Measure, LimitInterval] = {}
    grid = levels(state.protocol, run.condition)
    probes, note = answers(state, run, "followed"), ""
    if _follows(state, run, rule, probes, grid):
        asked = state.rule(run)
        estimate = asked.estimate(probes)
        _add(found, "rule", estimate)
        series = _describe_series(asked, probes) if isinstance(asked, Ascending) else ""
        note = "; ".join(filter(None, (estimate.distrust_reason, series)))
    else:
        note = AMENDED
    for measure, judge in (("K50 person", "person"), ("K50 automatic", "automatic")):
        verdicts = verdicts_of(answers(state, run, judge))
        if verdicts:
            found[measure] = half_way(grid, verdicts)  # type: ignore[index]
    return found, note


def _describe_series(rule: Ascending, probes: Sequence[JudgedProbe]) -> str:
    """Return a note if some, but not all, series of an ascending search failed at the softest wall; else ""."""
    series = rule.series(probes)
    failed = sum(one.censored == "below" for one in series)
    if failed in (0, len(series)):
        return ""
    return f"{failed} of {len(series)} series failed at the softest wall, which is used as their limit"


def _add(found: dict[Measure, LimitInterval], measure: Measure, estimate: Estimate) -> None:
    if math.isfinite(estimate.value):
        found[measure] = LimitInterval(
            value=estimate.value,
            low=estimate.low,
            high=estimate.high,
            censored=estimate.censored,
            share=estimate.share if math.isfinite(estimate.share) else None,
            step=estimate.step,
            mark=estimate.distrust_reason,
        )


def _follows(
    state: SessionState, run: SearchRun, name: str, probes: Sequence[JudgedProbe], grid: Sequence[float]
) -> bool:
    """Return True if the search rule would have chosen each wall of `probes` after the verdicts on walls before it."""
    if name not in WALKING:
        return all(answer.probe.level in grid for answer in probes)
    rule = state.rule(run)
    return all(
        answer.probe.catch or rule.next(probes[:place]) == answer.probe for place, answer in enumerate(probes)
    )
