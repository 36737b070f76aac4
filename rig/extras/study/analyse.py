"""Compute all results of a study from the logs of its sessions.

Command, report and tables read the results (`StudyAnalysis`). This file must not format or write anything.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rig.extras.study.agreement import Agreement, agreements
from rig.extras.study.effects import BlockRow, Slope, blocks, slopes
from rig.extras.study.kmax import (
    LEAST_VALUES,
    Beyond,
    Cell,
    OfParticipant,
    OverParticipants,
    Paired,
    collect_limits,
    compare_pairs,
    estimate_participants,
    over_participants,
)
from rig.extras.study.mixed import Mixed, fit_mixed
from rig.extras.study.people import answers_of, count_trial_uses, participants_of
from rig.extras.study.psychometric import PsychometricFit, complete_runs, gather_verdicts, psychometrics
from rig.extras.study.rows import (
    ENDED_BY_MOST,
    MEASURES,
    AnswerRow,
    LimitInterval,
    Measure,
    ParticipantRow,
    RunRow,
    TrialRow,
    runs_as_counted,
)
from rig.extras.study.study import Study, read_study
from rig.extras.study.trials import (
    AMENDED,
    half_way,
    levels,
    levels_by_participant,
    runs_of,
    schemes_of,
    trials_of,
)

Watch = Callable[[str, int, int], None]
_VAGUE = 0.4  # of the searched range: wider intervals are reported as imprecise
_NAMED = 5  # runs that a message names
_JUDGES: dict[Measure, str] = {"rule": "followed", "K50 person": "person", "K50 automatic": "automatic"}


@dataclass(frozen=True, slots=True, kw_only=True)
class AnalysisOptions:
    """Options of an analysis.

    Attributes
    ----------
    measure
        Definition of the stiffness limits that a report shows first; all three definitions are computed.
    hashes
        Compare recordings with the hashes in the logs.
    across
        Keys of the protocol in which sessions may differ although the keys can affect a result.
    seed
        Seed of all bootstraps; the same seed gives the same intervals.
    include_marked
        Also use *marked* limits, which the verdicts do not support: of searches that stopped at their trial limit
        before enough reversals, outside of their own interval, or not between a wall judged stable and a wall judged
        not stable.
    """

    measure: Measure = "rule"
    hashes: bool = True
    across: tuple[str, ...] = ()
    seed: int = 0
    include_marked: bool = False


@dataclass(frozen=True, kw_only=True)
class StudyAnalysis:
    """All results of a study.

    Attributes
    ----------
    study, options
        The sessions that were analysed, and the options.
    schemes
        Description of sampling and estimator of each condition, by the condition's name.
    trials, runs
        One row for each trial and for each run (search), from which all other results are computed.
    participants, answers
        One row for each participant, and for each answer to the questionnaire.
    of_participants, over_participants, paired
        K_max (stiffest stable wall) of each participant, its mean over participants, and paired differences of
        conditions, each by three definitions of the limit.
    mixed
        A mixed model for each definition of the limit that has values.
    agreements, psychometrics
        Confusion matrices of people's and automatic verdicts; fitted psychometric functions.
    slopes, blocks
        Changes along the session (order, fatigue); summaries of the trials of each block.
    """

    study: Study
    options: AnalysisOptions
    schemes: Mapping[str, str]
    trials: tuple[TrialRow, ...]
    runs: tuple[RunRow, ...]
    participants: tuple[ParticipantRow, ...]
    answers: tuple[AnswerRow, ...]
    of_participants: tuple[OfParticipant, ...]
    over_participants: tuple[OverParticipants, ...]
    paired: tuple[Paired, ...]
    mixed: tuple[Mixed, ...]
    agreements: tuple[Agreement, ...]
    psychometrics: tuple[PsychometricFit, ...]
    slopes: tuple[Slope, ...]
    blocks: tuple[BlockRow, ...]

    @property
    def messages(self) -> tuple[str, ...]:
        """Messages for the reader: about the sessions, and about trials and searches (runs) that were left out."""
        left = [run for run in self.runs if run.state != "complete"]
        found = []
        fast = sum(trial.too_fast and trial.counts for trial in self.trials)
        if fast:
            found.append(
                f"{_plural(fast, 'verdict')} {_was(fast)} given sooner than trial.fastest_verdict_s, "
                "as by a stuck key or a script: see column too_fast of the trials; they are counted"
            )
        for state in ("unfinished", "skipped"):
            count = sum(run.state == state for run in left)
            if count:
                found.append(
                    f"{_plural(count, 'run')} {_was(count)} {state}: listed in the table of runs, not used for K_max"
                )
        found += self._of_marked()
        noted = sum(run.note == AMENDED for run in self.runs)
        if noted:
            found.append(
                f"trials of {_plural(noted, 'run')} were amended after the search rule had used them, so it "
                "would have chosen other walls: these runs have no limit by the rule; their K50 is used"
            )
        vague = sum(
            one.measure != "rule"
            and not one.above
            and not one.below
            and one.high - one.low > _VAGUE * self._range(one.condition)
            for one in self.of_participants
        )
        if vague:
            found.append(
                f"{_plural(vague, 'K50')} {_is(vague)} imprecise for lack of verdicts: the interval is wider than "
                f"{100 * _VAGUE:.0f} % of the searched range"
            )
        unresolved = sum(bool(one.problem) and not one.withheld for one in self.paired)
        if unresolved and len(self.study.sessions) >= LEAST_VALUES:
            found.append(
                f"{_plural(unresolved, 'paired difference')} {_has(unresolved)} no interval and no p: too few people "
                "have both conditions, or their scatter is not larger than the rounding to levels"
            )
        mostly = [
            f"{one.condition} at B = {one.damping:g} ({one.above + one.below} of {one.limits})"
            for one in self.over_participants
            if one.measure == self.options.measure and Beyond(one.limits, one.above, one.below).mostly
        ]
        if mostly:
            found.append(
                "most limits lie beyond the searched levels, so their mean is only a bound and differences with it are "
                "not tested: " + ", ".join(mostly)
            )
        return (*self.study.messages, *found)

    def _range(self, condition: str) -> float:
        grid = levels(self.study.protocol, condition)
        return grid[-1] - grid[0]

    @property
    def runs_as_counted(self) -> tuple[RunRow, ...]:
        """Runs (searches) that K_max, models and slopes use: without doubtful limits, unless `include_marked`."""
        return runs_as_counted(self.runs, include_marked=self.options.include_marked)

    def counts(self) -> dict[str, int]:
        """Return the number of trials by use: "recorded" (all), "counted" (used for a limit), or the reason why not."""
        return {
            "recorded": len(self.trials),
            **dict(sorted(count_trial_uses(self.trials, self.runs_as_counted).items())),
        }

    def _of_marked(self) -> Iterator[str]:
        """Yield messages about searches that stopped at their trial limit, and limits that verdicts do not support."""
        taken = (
            "included"
            if self.options.include_marked
            else "excluded from K_max (`include_marked` includes them)"
        )
        short = [run for run in self.runs if run.state == ENDED_BY_MOST]
        if short:
            names = [f"{run.participant}, run {run.run}: {run.note}" for run in short]
            runs = f"{_plural(len(short), 'run')} {_was(len(short))}"
            yield f"{runs} stopped at the trial limit (search.settings.most), {taken}: {_list_names(names)}"
        names = [
            f"{run.participant}, run {run.run}: {limit.mark}"
            for run in self.runs
            if (limit := run.limits.get("rule")) and limit.mark and run.state == "complete"
        ]
        names += [
            f"{one.participant}, {one.condition} at B = {one.damping:g}, K50 {one.judge}: {one.mark}"
            for one in self.psychometrics
            if one.participant and one.mark
        ]
        if names:
            limits = f"{_plural(len(names), 'limit')} {_is(len(names))}"
            yield f"{limits} not supported by the verdicts, {taken}: {_list_names(names)}"

    def as_mapping(self) -> dict[str, Any]:
        """Return all results for JSON; single trials are only in their table."""
        study, protocol = self.study, self.study.protocol
        return {
            "title": protocol.study.title,
            "rehearsed": study.rehearsed,
            "messages": list(self.messages),
            "units": {name: study.unit(name) for name in ("stiffness", "damping")},
            "measure": self.options.measure,
            "seed": self.options.seed,
            "include_marked": self.options.include_marked,
            "conditions": [
                {"name": one.name, "scheme": self.schemes[one.name], "damping": list(one.damping)}
                for one in protocol.condition
            ],
            "participants": [
                {**asdict(one), "directory": str(session.directory)}
                for one, session in zip(self.participants, study.sessions, strict=True)
            ],
            "answers": [asdict(one) for one in self.answers],
            "trials": self.counts(),
            "runs": [asdict(run) for run in self.runs],
            "of_participants": [asdict(one) for one in self.of_participants],
            "over_participants": [asdict(one) for one in self.over_participants],
            "paired": [asdict(one) for one in self.paired],
            "mixed": [asdict(one) for one in self.mixed],
            "agreements": [asdict(one) for one in self.agreements],
            "psychometrics": [asdict(one) for one in self.psychometrics],
            "slopes": [asdict(one) for one in self.slopes],
            "blocks": [asdict(one) for one in self.blocks],
        }


def analyse(
    paths: str | Path | Iterable[str | Path],
    options: AnalysisOptions | None = None,
    *,
    watch: Watch | None = None,
) -> StudyAnalysis:
    """Analyse the sessions of a study in `paths`, directories of sessions or of studies.

    `options` choose what is shown and left out (None: the defaults); `watch` is called with the name of a step, the
    number of its finished parts, and their total. Raise `RecordingError` if a path contains no session or a log is
    damaged, `ConfigError` if the sessions are not of one study or this version cannot read them.
    """
    options = options or AnalysisOptions()
    report = watch or (lambda _what, _done, _total: None)
    study = read_study(
        paths,
        hashes=options.hashes,
        across=options.across,
        watch=lambda done, total: report("sessions read", done, total),
    )
    trials = trials_of(study)
    runs = runs_of(study, watch=lambda done, total: report("limits estimated", done, total))
    report("intervals", 0, 4)
    counted = runs_as_counted(runs, include_marked=options.include_marked)
    pooled = {
        key: limit for key, limit in _pool(study, counted).items() if options.include_marked or not limit.mark
    }
    each = estimate_participants(counted, pooled, options.seed)
    report("intervals", 1, 4)
    names = [condition.name for condition in study.protocol.condition]
    known = [measure for measure in MEASURES if any(measure in run.limits for run in runs)]
    models = tuple(fit_mixed(collect_limits(counted, measure, pooled), measure, names) for measure in known)
    report("intervals", 2, 4)
    functions = psychometrics(study, complete_runs(counted), include_marked=options.include_marked)
    report("intervals", 3, 4)
    found = StudyAnalysis(
        study=study,
        options=options,
        schemes=schemes_of(study),
        trials=trials,
        runs=runs,
        participants=participants_of(study, trials, counted),
        answers=answers_of(study),
        of_participants=each,
        over_participants=over_participants(each, names),
        paired=compare_pairs(each, names),
        mixed=models,
        agreements=agreements(trials),
        psychometrics=functions,
        slopes=slopes(counted, trials),
        blocks=blocks(trials),
    )
    report("intervals", 4, 4)
    return found


def analyse_study(
    places: str | Path | Iterable[str | Path],
    *,
    measure: Measure = "rule",
    hashes: bool = True,
    across: Sequence[str] = (),
    seed: int = 0,
    include_marked: bool = False,
    watch: Watch | None = None,
) -> StudyAnalysis:
    """Analyse the sessions of a study: limits with intervals, differences, agreement, order and fatigue.

    Parameters
    ----------
    places
        Directories of participants or of studies.
    measure
        Definition of the limits that are shown first: by the search's ``"rule"``, or where half of the verdicts are
        stable, ``"K50 person"`` or ``"K50 automatic"``. All three are computed.
    hashes
        Compare recordings with their hashes in the logs.
    across
        Keys of the protocol in which sessions may differ although the keys can affect a result.
    seed
        Seed of the bootstraps.
    include_marked
        Also use limits that the verdicts do not support, such as those of searches that stopped at their trial limit.
    watch
        Called with the name of a step, the number of its finished parts, and their total.

    Returns
    -------
    StudyAnalysis
        Rows of trials and runs, K_max by participant and over participants (N·m/rad or N/m), paired differences, mixed
        models, agreement of person and program, slopes; `write_study_tables` writes them.

    Raises
    ------
    RecordingError
        A path contains no session, or a log is damaged.
    ConfigError
        The sessions are not of one study, or this version cannot read them.
    """
    options = AnalysisOptions(
        measure=measure, hashes=hashes, across=tuple(across), seed=seed, include_marked=include_marked
    )
    return analyse(places, options, watch=watch)


def _pool(study: Study, runs: Sequence[RunRow]) -> dict[tuple[Measure, str, Cell], LimitInterval]:
    """Estimate the stiffness limit from all verdicts of a participant's complete searches at a condition and damping.

    The keys are (definition of the limit, participant, (condition, damping)).
    """
    complete = complete_runs(runs)
    shares = {(run.condition, m): limit.share for run in runs for m, limit in run.limits.items()}
    grids = levels_by_participant(study)
    return {
        (measure, code, cell): half_way(grids[code, cell[0]], verdicts, shares[cell[0], measure])
        for measure, judge in _JUDGES.items()
        for cell, each in gather_verdicts(study, judge, complete).items()
        for code, verdicts in each.items()
        if (cell[0], measure) in shares
    }


def _list_names(names: Sequence[str]) -> str:
    more = len(names) - _NAMED
    return "; ".join(names[:_NAMED]) + (f"; and {more} more" if more > 0 else "")


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")


def _is(count: int) -> str:
    return "is" if count == 1 else "are"


def _has(count: int) -> str:
    return "has" if count == 1 else "have"


def _was(count: int) -> str:
    return "was" if count == 1 else "were"
