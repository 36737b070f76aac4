"""The methods of a study as paragraphs that a paper can print: what was done, by the protocol and the logs.

Nothing is said here that the protocol, the experiment or the logs do not say. A reader who repeats the study needs the
protocol file and this.
"""

from __future__ import annotations

import math
import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from rig.config import Experiment, experiment_from_mapping
from rig.config.table import parameters
from rig.core.errors import RigError
from rig.core.oscillation import OSCILLATIONS
from rig.recording.header import checkout
from rig.session.analysis.agreement import LEAST_PEOPLE
from rig.session.analysis.analyse import Analysis
from rig.session.analysis.kmax import ENOUGH_REPEATS, LEAST_REPEATS, RESAMPLES
from rig.session.analysis.rows import Measure
from rig.session.conditions import Walls
from rig.session.protocol import Condition, Protocol, Search
from rig.session.schedule import levels_of, rows_of, rule
from rig.session.search.ascending import Ascending
from rig.session.search.grid import Grid
from rig.session.search.interleaved import Interleaved
from rig.session.search.psi import Psi
from rig.session.search.psychometric import SLIPS, of_levels
from rig.session.search.rule import Rule
from rig.session.search.staircase import EDGE_VERDICTS, Staircase

MEASURES: Mapping[Measure, str] = {
    "rule": "the limit that the search rule gives",
    "K50 person": "K50, the stiffness at which half of the person's verdicts are stable",
    "K50 automatic": "K50 of the automatic verdicts, the stiffness at which half of them are stable",
}
_CRITERIA = {
    "any": "felt, heard or moved",
    "felt": "felt",
    "heard": "heard",
}


@dataclass(frozen=True, slots=True)
class Paragraph:
    """A paragraph under a short heading."""

    heading: str
    text: str


def methods(found: Analysis) -> tuple[Paragraph, ...]:
    """All paragraphs, in the order of a paper."""
    told = _Told(found)
    paragraphs = (
        ("Participants", told.participants()),
        ("Apparatus", told.apparatus()),
        ("Conditions", told.conditions()),
        ("Task", told.task()),
        ("Automatic verdict", told.verdict()),
        ("Search", told.searches()),
        ("Order and blinding", told.order()),
        ("Safety and rests", told.safety()),
        ("Analysis", told.analysis()),
        ("Software", told.software()),
    )
    return tuple(Paragraph(heading, " ".join(sentences)) for heading, sentences in paragraphs)


@dataclass(frozen=True)
class _Told:
    """What is told, piece by piece; each method returns sentences."""

    found: Analysis

    @property
    def protocol(self) -> Protocol:
        return self.found.study.protocol

    @cached_property
    def experiment(self) -> Experiment:
        """That of the first condition; what others change is told with them."""
        state, protocol = self.found.study.sessions[0].state, self.protocol
        base = experiment_from_mapping(state.experiment, "the session's log")
        condition = protocol.condition[0]
        softest = levels_of(protocol.search_of(condition))[0]
        try:
            return Walls(protocol, base).at(condition, condition.damping[0], softest)
        except RigError:  # an estimator that is not installed here
            return base

    def unit(self, quantity: str) -> str:
        return self.found.study.unit(quantity)

    def participants(self) -> list[str]:
        sessions = self.found.study.sessions
        simulated = self.found.study.rehearsed
        whole = sum(session.complete for session in sessions)
        told = [
            f"{_count(len(sessions), 'simulated participant' if simulated else 'participant')} took part, of "
            f"{self.protocol.study.participants} planned; {whole} finished the whole session."
        ]
        if simulated:
            told.append(
                "This was a rehearsal: hands and verdicts were simulated, and the numbers say nothing about people."
            )
        return told

    def apparatus(self) -> list[str]:
        rig = self.experiment.rig
        counts = f"{rig.encoder.resolution:.4g} {self.unit('position')} a count"
        told = [
            f"Walls were rendered on {rig.name}"
            + (f" ({rig.description})" if rig.description else "")
            + f", a {rig.motion} rig with one degree of freedom, with an encoder of {counts} and efforts of up to "
            f"{rig.limits.effort:g} {self.unit('effort')}."
        ]
        devices = _facts(self.found, ("device", "firmware", "simulated"))
        for device, firmware, simulated in devices:
            told.append(
                f"The device {device} was simulated by software."
                if simulated and firmware in ("simulated", "unknown")
                else f"The device {device} ran firmware {firmware}"
                + (" and was simulated by software." if simulated else ".")
            )
        return told

    def conditions(self) -> list[str]:
        each = [self._condition(condition) for condition in self.protocol.condition]
        told = [
            f"{_count(len(each), 'condition')} {'was' if len(each) == 1 else 'were'} compared: {'; '.join(each)}."
        ]
        if self.protocol.study.changes:
            told.append(f"In all of them {self._settings(self.protocol.study.changes)}.")
        told.append(
            f"A wall was a spring K and a damper B ({self.experiment.wall.law}), in {self.unit('stiffness')} and "
            f"{self.unit('damping')}."
        )
        return told

    def _condition(self, condition: Condition) -> str:
        dampings = _list([f"{damping:g}" for damping in condition.damping])
        text = f"{condition.name} ({self.found.schemes[condition.name]}) at B = {dampings} {self.unit('damping')}"
        return text + (f", with {self._settings(condition.changes)}" if condition.changes else "")

    def _settings(self, changes: Mapping[str, Any]) -> str:
        """Changed keys of the experiment, with their units."""
        known = parameters()
        units = {key: known[key].unit_for(self.found.study.motion) if key in known else "" for key in changes}
        return _list([f"{key} = {value} {units[key]}".rstrip() for key, value in changes.items()])

    def task(self) -> list[str]:
        trial, homing = self.protocol.trial, self.experiment.homing
        told = [
            f"In each trial a servo brought the handle to its start at {homing.speed:g} "
            f"{self.unit('velocity')} with at "
            f"most {homing.effort:g} {self.unit('effort')}, where it rested for {homing.settle_s:g} s."
        ]
        length = f"{self.experiment.trial.duration_s:g} s"
        baseline = f", after {trial.baseline_s:g} s in free space," if trial.baseline_s > 0.0 else ""
        if trial.kind == "human":
            told.append(
                f"The participant held the handle and{baseline} hit the wall within {length}, told: “{trial.say}”"
            )
        else:
            told.append(
                f"The motor{baseline} pushed the handle into the wall with {self.experiment.trial.effort:g} "
                f"{self.unit('effort')} for {length}; nobody had to hold it."
            )
        if self.protocol.study.judge == "person":
            told.append(
                "Then the participant judged the wall to be stable, to buzz, or to be unstable, or was unsure; the "
                "search took buzz and unstable as not stable."
            )
            told.append(
                "After an unsure verdict the same wall came again; "
                f"{_count(trial.unsure, 'unsure verdict')} in a row counted as not stable."
            )
        else:
            told.append("The search followed the automatic verdict; nobody was asked.")
        practice = self.protocol.practice.stiffness
        if practice:
            walls = _list([f"{stiffness:g}" for stiffness in practice])
            told.append(
                f"{_count(len(practice), 'practice trial')} (K = {walls} {self.unit('stiffness')}) came first and "
                "counted for nothing."
            )
        if self.protocol.question:
            told.append(f"A questionnaire had {_count(len(self.protocol.question), 'item')}.")
        return told

    def verdict(self) -> list[str]:
        limits, criterion = self.experiment.verdict, self.protocol.study.criterion
        band = f"{limits.highpass_hz:g} and {limits.lowpass_hz:g} Hz"
        return [
            f"Each recording was judged by its last {limits.tail_s:g} s.",
            f"A wall was felt when the handle's rms velocity between {band} exceeded {limits.felt_velocity:g} m/s and "
            "the encoder's resolution allowed to tell; heard when the rms of the commanded effort above "
            f"{limits.highpass_hz:g} Hz exceeded {limits.heard_force:g} N at the handle; moved when the handle "
            f"travelled more than {limits.moved:g} m peak to peak above {limits.highpass_hz:g} Hz.",
            "It was unstable when the handle left it in that time, when one of these thresholds was exceeded "
            "by a ripple that grew "
            f"more than {limits.growth_ratio:g}-fold over the tail, or when the motor then saturated in more than "
            f"{100 * limits.saturated_fraction:g} % of it; a limit cycle when a threshold was exceeded without that; "
            "else stable.",
            f"The study's criterion is {_CRITERIA[criterion]}.",
            "A trial without contact, with a gap in its samples, with a share of late ticks of "
            f"{100 * limits.late_fraction:g} % or more, or in which the device overruled the law said nothing and was "
            f"repeated, up to {_count(self.protocol.trial.attempts, 'time')} before the operator was asked.",
        ]

    def searches(self) -> list[str]:
        own = [condition for condition in self.protocol.condition if condition.search is not None]
        told = []
        if len(own) < len(self.protocol.condition):
            told += self._search(self.protocol.search, "K_max was searched")
        for condition in own:
            assert condition.search is not None
            told += self._search(condition.search, f"In {condition.name}, K_max was searched")
        return told

    def _search(self, wanted: Search, begins: str) -> list[str]:
        levels = levels_of(wanted)
        apart = (
            f"{wanted.step:g} {self.unit('stiffness')} apart"
            if wanted.step is not None
            else f"each {wanted.ratio:g} times the one before"
        )
        caught = (
            f"{100 * wanted.catch_share:g} % of the trials were catch trials of the softest or the stiffest wall, "
            "which count for no limit."
        )
        return [
            f"{begins} among {len(levels)} stiffnesses from {levels[0]:g} to {levels[-1]:g} {self.unit('stiffness')}, "
            f"{apart}.",
            _rule_text(rule(wanted, 0)),
            *([caught] if wanted.catch_share else []),
        ]

    def order(self) -> list[str]:
        order, study = self.protocol.order, self.protocol.study
        runs = len([1 for condition in self.protocol.condition for _ in condition.damping])
        held = {
            "repeat": "A block held one repeat of every condition and damping",
            "condition": "A block held all repeats of one condition",
            "one": "The whole session was one block",
        }[order.blocks]
        how = {
            "fixed": "came as written, the same for everybody",
            "randomised": f"was drawn anew for each block and participant (seed {study.seed})",
            "latin-square": "followed Williams' design, in which each comes in each place and after each other one "
            f"equally often over {rows_of(self.protocol)} rows (seed {study.seed})",
        }[order.kind]
        told = [
            f"Each of the {runs} pairs of condition and damping was searched {_count(order.repeats, 'time')} by each "
            f"participant. {held}; the order {how}."
        ]
        if order.kind == "latin-square":
            told.append(self._rows())
        if order.interleave:
            told.append("The searches of a block took turns, trial by trial, in a drawn order.")
        told.append(
            {
                "both": "Neither participant nor operator was shown condition, stiffness or damping.",
                "operator": "The operator was shown no condition, stiffness or damping.",
                "participant": "The participant was told no condition, stiffness or damping; the operator saw them.",
                "none": "Conditions, stiffnesses and dampings were open to participant and operator.",
            }[study.blind]
        )
        return told

    def _rows(self) -> str:
        """Which rows of the square are there, and whether they are all there equally often."""
        whole = rows_of(self.protocol)
        times = Counter(session.state.row % whole for session in self.found.study.sessions)
        if len(times) == whole and len(set(times.values())) == 1:
            return f"Each row was that of {_count(times[0], 'participant')}, so the order was balanced over them."
        there = (
            f"All {whole} rows were there, but not equally often"
            if len(times) == whole
            else f"{len(times)} of the {whole} rows {'was' if len(times) == 1 else 'were'} there"
        )
        each = ", ".join(
            f"row {row}: {_count(number, 'participant')}" for row, number in sorted(times.items())
        )
        return f"{there} ({each}), so the order was not balanced over participants."

    def safety(self) -> list[str]:
        caps, rest, stop = self.protocol.caps, self.protocol.rest, self.protocol.stop
        limits = self.experiment.rig.limits
        told = [
            f"The effort went to zero at once when the handle left its window, went faster than {limits.speed:g} "
            f"{self.unit('velocity')}, or when the operator stopped it."
        ]
        oscillations = limits.oscillations
        if oscillations is None and limits.human and self.protocol.trial.kind == "human":
            oscillations = OSCILLATIONS
        if oscillations:
            told.append(
                f"It also did so after {oscillations} oscillations of the effort in a row between zero and its limit, "
                f"each within {1000 * limits.oscillation_s:g} ms of the one before."
            )
        if limits.energy is not None:
            told.append(f"A motor that had given the hand more than {limits.energy:g} J in a trial ended it.")
        capped = [
            f"{name} {value:g} {self.unit(quantity)}"
            for name, quantity, value in (
                ("stiffness", "stiffness", caps.stiffness),
                ("effort", "effort", caps.effort),
                ("speed", "velocity", caps.speed),
                ("energy given to the hand in a hit", "J", caps.energy),
            )
            if value is not None
        ]
        if capped:
            told.append(f"The protocol's caps were: {', '.join(capped)}.")
        rests = [
            f"the motor cooled whenever more than {100 * rest.heat:g} % of its winding's heat budget was used"
        ]
        if rest.every:
            rests.insert(0, f"a rest of {rest.seconds:g} s came after every {rest.every} trials")
        if rest.between_blocks_s > 0.0:
            rests.insert(0, f"a rest of {rest.between_blocks_s:g} s came between blocks")
        told.append(_sentence(_list(rests)))
        ends = [
            text
            for text, value in (
                (f"{stop.trials} trials", stop.trials),
                (f"{stop.minutes} min", stop.minutes),
                (f"{stop.invalid} trials in a row that said nothing", stop.invalid),
                (f"{stop.aborts} hits in a row that were cut off", stop.aborts),
            )
            if value is not None
        ]
        if ends:
            told.append(f"A session was to end early after {_list(ends, 'or')}.")
        return told

    def analysis(self) -> list[str]:
        found, measure = self.found, self.found.options.measure
        told = [self._counts(), f"K_max is {MEASURES[measure]}.", "Intervals are of 95 %."]
        if measure == "rule":
            told.append(
                "That of a participant is the mean over repeats. Where there are "
                f"{LEAST_REPEATS} or more that differ its interval is Student's, from {ENOUGH_REPEATS} on a BCa "
                f"bootstrap over them ({RESAMPLES} resamples, seed {found.options.seed}), else that of the run or of "
                "all verdicts together, which is not told from the mean and need not hold it."
            )
        else:
            told.append(
                "That of a participant is told from all verdicts together, with the interval of its posterior."
            )
        told += [
            "The interval of a participant's K50 takes it to be one K50 in all repeats: where the limit wanders from "
            "repeat to repeat it is too narrow.",
            "Intervals over participants are Student's.",
            "Differences between conditions are paired within participants (Student's t), with Holm's correction for "
            "all differences between pairs of conditions by the same measure, at each damping and over all of them.",
            *self._mixed(),
            *self._censored(),
            *self._psychometric(),
            *self._agreement(),
            "Effects of order and fatigue are exploratory: slopes by least squares, one for each participant with "
            "conditions taken out, and Student's interval of their mean over participants, with Holm's correction for "
            "the slopes of the same quantity.",
        ]
        return told

    def _counts(self) -> str:
        """How many trials told limits, and what the others are."""
        counts = self.found.counts()
        words = {"invalid": "said nothing"}
        left = ", ".join(
            f"{count} {words.get(name, name)}"
            for name, count in counts.items()
            if name not in ("recorded", "counted") and count
        )
        told = f"Of {counts['recorded']} recorded trials {counts.get('counted', 0)} told limits"
        return told + (f"; the others: {left}." if left else ".")

    def _censored(self) -> list[str]:
        """What becomes of limits beyond the levels, and how many there are."""
        of = [one for one in self.found.over_participants if one.measure == self.found.options.measure]
        censored, limits = sum(one.above + one.below for one in of), sum(one.limits for one in of)
        told = [
            "A limit beyond the levels is taken to be their end, with an interval that is open on that side. K50 lies "
            "above them when the median of its posterior exceeds the stiffest of them or all verdicts are stable, and "
            "below them likewise; what the search takes for beyond is told with it."
        ]
        if not censored:
            return [*told, "No limit lies beyond the levels that were searched."]
        return [
            *told,
            f"{censored} of {_count(limits, 'limit')} {'lies' if censored == 1 else 'lie'} beyond the levels that were "
            "searched: means with them are bounds, and differences are biased, usually towards zero; unequal spread "
            "can make a difference out of nothing.",
            "Where most limits of a condition at a damping lie beyond the levels, no interval is given and nothing is "
            "tested. No model for censored values (Tobit) was used.",
        ]

    def _psychometric(self) -> list[str]:
        if not self.found.psychometrics:
            return []
        return [
            "Psychometric functions (share of stable verdicts over stiffness, P = λ + (1 − 2 λ) / (1 + exp((K − K50) / "
            "s))) are posteriors on a grid.",
            *self._prior(),
            "That of all participants has the mean of their own K50, with Student's interval where there are three or "
            "more.",
        ]

    def _prior(self) -> list[str]:
        """What was supposed of K50, s and slips before any verdict."""
        slips = ", ".join(f"{100 * value:g}" for value in SLIPS)
        searches = dict.fromkeys(
            tuple(levels_of(self.protocol.search_of(condition))) for condition in self.protocol.condition
        )
        told = []
        for levels in searches:
            grid = of_levels(levels)
            among = f" of levels from {levels[0]:g} to {levels[-1]:g}" if len(searches) > 1 else ""
            told.append(
                f"The prior{among}: K50 on {len(grid.thresholds)} values from {grid.thresholds[0]:.3g} to "
                f"{grid.thresholds[-1]:.4g} {self.unit('stiffness')}, flat over K50 where levels are evenly spaced and "
                f"over its logarithm where they are spaced by a ratio; s on {len(grid.spreads)} values from "
                f"{grid.spreads[0]:.3g} to {grid.spreads[-1]:.3g}, flat over its logarithm; slips λ of {slips} %, "
                "equally likely."
            )
        return told

    def _agreement(self) -> list[str]:
        if not self.found.agreements:
            return []
        return [
            "Agreement of the person's verdicts and the automatic ones is Cohen's κ: of two classes (stable or not, "
            "under the study's criterion) and of four (unsure is one) without weights, of three (stable, buzz, "
            "unstable) with linear and with quadratic weights; an automatic limit cycle is a buzz.",
            f"Its interval is Student's by the jackknife over people where there are {LEAST_PEOPLE} or more, of one "
            "person that of Fleiss, Cohen and Everitt for independent trials, else none; and none where one of the two "
            "gave a single class or nothing was confused.",
        ]

    def _mixed(self) -> list[str]:
        model = next((one for one in self.found.mixed if one.measure == self.found.options.measure), None)
        if model is None:
            return []
        if model.problem:
            return [_sentence(f"there is no mixed model: {model.problem}")]
        random = _list([name for name, _ in model.deviations[:-1]])
        lines = _list([slope.name for slope in model.slopes])
        told = (
            f"A linear mixed model of the limits of {_count(model.runs, 'run')}, averaged over the repeats of each "
            "participant in each condition at each damping, has condition and damping as fixed factors"
            + (
                f", {'a straight line' if len(model.slopes) == 1 else 'straight lines'} over {lines} that only "
                f"{'takes' if len(model.slopes) == 1 else 'take'} out what they do,"
                if lines
                else ""
            )
            + f" and random effects of {random} (REML; Student's intervals with "
            f"{_count(model.degrees, 'degree')} of freedom"
            + (
                "; factors tested by likelihood ratios of ML fits, which with few participants come out below 0.05 "
                "more often than in 5 %)."
                if model.tests
                else ")."
            )
        )
        return [told, *(_sentence(note) for note in model.notes)]

    def software(self) -> list[str]:
        ran = []
        for versions in _versions(self.found):
            named = [
                f"{name} {version}"
                for name, version in versions.items()
                if name not in ("sources", "protocol")
            ]
            sources = versions.get("sources")
            ran.append(", ".join(named) + (f" (sources {str(sources)[:12]})" if sources else ""))
        here = analysed_with()
        return [
            f"Sessions ran with {'; or with '.join(ran)}." if ran else "The logs name no versions.",
            f"They were analysed with {', '.join(f'{name} {version}' for name, version in here.items())}.",
        ]


def analysed_with() -> dict[str, str]:
    """Versions of what this analysis was computed with."""
    found = {}
    for name in ("haptic-rig", "numpy", "scipy", "statsmodels", "matplotlib"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return {**found, **checkout(), "Python": platform.python_version()}


def _rule_text(chosen: Rule) -> str:
    """What a rule does, with the settings active."""
    match chosen:
        case Ascending():
            return (
                f"The rule climbs from the softest of them until a verdict is not stable, "
                f"{_count(chosen.repeats, 'time')}; "
                "the limit is the mean of the last stable ones. It lies above the levels when any climb found no other "
                "wall than stable, and below them only if every climb failed on the softest wall."
            )
        case Staircase():
            begins = "in the middle" if chosen.start is None else f"at {chosen.start:g}"
            return f"The rule is a staircase that begins {begins}: {_staircase(chosen)}"
        case Interleaved():
            return (
                "The rule is two staircases in drawn turns, one from the softest and one from the stiffest: "
                f"{_staircase(chosen)} The limit is the mean of both."
            )
        case Psi():
            early = f", or until K50 was known within {100 * chosen.enough:g} %" if chosen.enough else ""
            return (
                "The rule is the Psi method: each trial asks for the wall whose verdict is expected to tell most about "
                f"K50, for {_count(chosen.hits, 'verdict')}{early}; the limit is the median of the posterior of K50, "
                "whose prior is told under Analysis."
            )
        case Grid():
            return (
                f"The rule asks for every one of them {_count(chosen.repeats, 'time')}, each time in another "
                "drawn order; "
                "the limit is K50 of the psychometric function, as the median of its posterior."
            )
    return ""


def _staircase(chosen: Staircase | Interleaved) -> str:
    stable = chosen.stable_to_rise
    rises = "a stable verdict" if stable == 1 else f"{stable} stable verdicts in a row"
    steps = _list([str(step) for step in chosen.steps])
    share = 0.5 ** (1.0 / stable)
    return (
        f"{rises} made the wall stiffer, any other softer, by {steps} levels, smaller after each turn, until "
        f"{chosen.turns} turns at the smallest step or {chosen.most} verdicts; the limit is the mean of those "
        "turns, where "
        f"{100 * share:.0f} % of the verdicts are stable. {EDGE_VERDICTS} verdicts in a row at an end of the levels "
        "that ask for walls beyond it end the search there: the limit lies beyond that end."
    )


def _facts(found: Analysis, names: Sequence[str]) -> list[tuple[Any, ...]]:
    """Values of these entries each time that a device was opened, each combination once."""
    told = [
        tuple(event.content.get(name, "unknown") for name in names)
        for session in found.study.sessions
        for event in session.of_kind("opened")
    ]
    return list(dict.fromkeys(told))


def _versions(found: Analysis) -> list[Mapping[str, Any]]:
    """Versions that sessions ran with, each set once."""
    sets: dict[str, Mapping[str, Any]] = {}
    for session in found.study.sessions:
        versions = session.began.get("versions") or {}
        if versions:
            sets.setdefault(repr(sorted(versions.items())), versions)
    return list(sets.values())


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _list(words: Sequence[str], last: str = "and") -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else ""


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:].rstrip('.')}." if text else ""


def finite(value: Any) -> Any:
    """Plain values for JSON: what is not finite is None."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value
