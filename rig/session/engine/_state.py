"""Compute the state of a session and its next step, as a pure function of its log.

Nothing is stored outside the log, so a killed session can be resumed, and an analysis uses the same data as the session
itself. Kinds of events and their content:

=============  ====================================================================================================
``began``      protocol, protocol_sha256, experiment, code, row, seed, versions, rehearsal, differs (keys in which
               earlier sessions of the study have another value)
``opened``     device and its URL, its clock, this computer and versions; written each time that the device is opened
``resumed``    where (trial, block), abandoned: recordings of trials that were not logged
``block``      number of the block that begins
``trial``      one recorded hit: `rig.session.planning._trial.Presented` and `rig.session.planning._trial.HitOutcome`
``judged``     trial, verdict, judged_by, response_time_s
``redone``     number of the trial that does not count and is repeated
``retried``    number of the search (run) that the operator continued after too many invalid trials in a row
``skipped``    number of the search (run) that ends without a limit
``note``       text, trial
``paused``     reason
``continued``  end of a pause
``rested``     seconds, reason (every, block, heat)
``answered``   item, answer, block
``restarted``  number of the block that starts again; its trials so far do not count
``pulse``      block, result of the torque pulse before the block, recording
``amended``    number of the event that is corrected, field, value, why, trial; the field void of a ``trial`` states
               whether the trial is excluded
``stopped``    reason for which the session was left; it can be resumed
``ended``      reason: complete, or the stop rule that ended the session
``streamed``   summary of the data sent by Lab Streaming Layer, and number of lost markers
=============  ====================================================================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from rig.core.errors import RecordingError
from rig.session.engine._log import Event
from rig.session.planning._load import protocol_from_mapping
from rig.session.planning._names import normalise
from rig.session.planning._protocol import Item, Protocol, Search
from rig.session.planning._reasons import summarise_reasons
from rig.session.planning._schedule import Block, SearchRun, asking_of, rule_of, schedule
from rig.session.planning._times import cooling_s
from rig.session.planning._trial import REDONE, RESTARTED, Presented, RecordedTrial, trial_of
from rig.session.search import JudgedProbe, Probe, Rule

# Kinds of events outside the course of trials; the time before such an event is not active time of the session.
BOOKKEEPING = ("opened", "resumed", "stopped", "streamed", "amended", "pulse")
AMENDABLE = {"judged": ("verdict",), "trial": ("void",), "note": ("text",), "answered": ("answer",)}
# A longer gap between two events does not count as active time of the session.
_LONGEST_PAUSE_S = 3600.0
_TRUSTED_S = 30.0  # longest cooling assumed between two events: the computer's clock may have been changed


# What comes next.


@dataclass(frozen=True, slots=True)
class DoTrial:
    """Next step of a session: run a trial with the wall `presented`."""

    presented: Presented


@dataclass(frozen=True, slots=True)
class DoJudge:
    """Next step of a session: obtain the verdict on this trial."""

    trial: RecordedTrial


@dataclass(frozen=True, slots=True)
class DoAsk:
    """Next step of a session: ask a question of the questionnaire, or let a person fit a mechanical part to the rig.

    `block` is 0 before the first block, the number of the finished block after a block, and -1 at the end.
    """

    item: Item
    block: int


@dataclass(frozen=True, slots=True)
class DoBlock:
    """Next step of a session: begin this block, a group of searches between two breaks."""

    block: Block


@dataclass(frozen=True, slots=True)
class DoRest:
    """Next step of a session: rest for `seconds` (s).

    `reason` is "every" (a number of trials), "block" (between blocks) or "heat" (the motor cools).
    """

    seconds: float
    reason: str


@dataclass(frozen=True, slots=True)
class DoPause:
    """Next step of a session: pause, because computer or link made too many trials in a row invalid."""

    reason: str


@dataclass(frozen=True, slots=True)
class DoDecide:
    """Next step of a session: ask the operator what to do after too many invalid trials of the search `run`."""

    run: SearchRun
    last: RecordedTrial


@dataclass(frozen=True, slots=True)
class DoEnd:
    """Next step of a session: end the session for this reason."""

    reason: str


Step = DoTrial | DoJudge | DoAsk | DoBlock | DoRest | DoPause | DoDecide | DoEnd

WALKING = ("ascending", "staircase", "interleaved")  # rules whose next wall follows from the walls before

# Streams of random numbers of a participant; other numbers would change the walls of a session that is resumed.
_SEARCH_STREAM, _TRIAL_STREAM = 1, 2
END = -1  # block of a question that is asked at the end
# Question about the part that the next block needs. A question of a protocol cannot have this name, with blanks.
FITTED = "fitted to the rig"
AS_IT_IS = "the rig as it is"


@dataclass
class SessionState:
    """State of a session after the events in its log so far; `apply` updates the state with a new event.

    Attributes
    ----------
    protocol, experiment, code, row, seed, rehearsal
        Contents of the first event of the log.
    blocks
        Groups of searches between two breaks, in the order of this participant.
    trials
        All trials so far, also those that do not count.
    begun
        Numbers of the blocks that were begun, in their order.
    skipped, corrected
        Numbers of the searches that were skipped, and of the searches with a corrected verdict or an excluded trial.
    answered
        Answers to the questionnaire, by question and block.
    fitted
        Part that is fitted to the rig, as the operator confirmed; None if unknown, for example after a resume.
    notes
        Notes of the operator: number of the newest trial, and text.
    stopped
        Reason for which the session was left; None after it was resumed.
    ended
        Reason for which the session ended; None before its end.
    paused
        Reason of the current pause; None after the operator continued.
    heat
        Heat of the motor's winding; 1 is the heat after hours at the nominal effort.
    active_s
        Duration of the session so far without interruptions (s).
    """

    protocol: Protocol
    experiment: Mapping[str, Any]
    code: str
    row: int
    seed: int
    rehearsal: Mapping[str, Any] | None
    blocks: tuple[Block, ...]
    trials: list[RecordedTrial] = field(default_factory=list)
    begun: list[int] = field(default_factory=list)
    skipped: set[int] = field(default_factory=set)
    corrected: set[int] = field(default_factory=set)
    answered: dict[tuple[str, int], Any] = field(default_factory=dict)
    fitted: str | None = ""
    notes: list[tuple[int, str]] = field(default_factory=list)
    stopped: str | None = None
    ended: str | None = None
    paused: str | None = None
    heat: float = 0.0
    active_s: float = 0.0
    _last_at: float = 0.0
    _rested: dict[str, int] = field(default_factory=dict)  # newest trial at the last rest, by reason
    _continued: int = 0  # newest trial when the operator continued after a pause
    # Newest trial when the operator continued a search after too many invalid trials.
    _retried: dict[int, int] = field(default_factory=dict)
    # Number of discarded trials of each search that have not been repeated yet.
    _owed: dict[int, int] = field(default_factory=dict)
    _asked: dict[int, tuple[tuple[JudgedProbe, ...], Probe | None]] = field(default_factory=dict)

    @classmethod
    def of(cls, events: Sequence[Event]) -> SessionState:
        """Return the state of a session after the events of its log.

        Raise `RecordingError` if the log does not begin with the event ``began``, and `ConfigError` if its protocol is
        invalid.
        """
        if not events or events[0].kind != "began":
            raise RecordingError(
                "the session's log does not begin with the event 'began', which contains the protocol",
                remedy="restore the log from a copy, or start a new session",
            )
        began = events[0].content
        protocol = protocol_from_mapping(began["protocol"], "the protocol in the session's log")
        state = cls(
            protocol=protocol,
            experiment=began["experiment"],
            code=normalise(began["code"]),
            row=began["row"],
            seed=began["seed"],
            rehearsal=began["rehearsal"],
            blocks=schedule(protocol, began["row"]),
            _last_at=events[0].at,
        )
        numbers = {event.content["number"] for event in events if event.kind == "amended"}
        corrected = [
            event for event in events if event.kind in ("judged", "trial") and event.number in numbers
        ]
        state.corrected = {_run_of(events, event.content["trial"]) for event in corrected}
        for event in apply_corrections(events[1:]):
            state.apply(event)
        return state

    def apply(self, event: Event) -> None:
        """Update the state with the next event of the log."""
        # The computer's clock may have been set back.
        elapsed = max(0.0, event.at - self._last_at)
        self._last_at = event.at
        if event.kind not in BOOKKEEPING and elapsed < _LONGEST_PAUSE_S:
            self.active_s += elapsed
        rested = event.content["seconds"] if event.kind == "rested" else 0.0
        self._cool(max(min(elapsed, _TRUSTED_S), rested))
        change = self._changes.get(event.kind)
        if change is not None:
            change(self, event.content)

    def _cool(self, seconds: float) -> None:
        self.heat *= math.exp(-seconds / self.thermal_time_constant_s)

    @property
    def open_block(self) -> Block | None:
        """Group of searches between two breaks that was begun last; None if it is finished, or none was begun."""
        if not self.begun:
            return None
        block = next(one for one in self.blocks if one.number == self.begun[-1])
        return block if any(self.asks(run) is not None for run in block.runs) else None

    def _add_trial(self, content: Any) -> None:
        trial = trial_of(content)
        self.trials.append(trial)
        self.heat = trial.heat
        if not trial.invalid and self._owed.get(trial.run):
            self._owed[trial.run] -= 1

    def _set_verdict(self, content: Any) -> None:
        trial = self.trial_numbered(content["trial"])
        for name in ("verdict", "judged_by", "response_time_s"):
            setattr(trial, name, content[name])
        fastest_s = self.protocol.trial.fastest_verdict_s
        trial.too_fast = trial.judged_by == "person" and content["response_time_s"] < fastest_s

    def _redo(self, content: Any) -> None:
        trial = self.trial_numbered(content["trial"])
        trial.leave_out(REDONE)
        self._owed[trial.run] = self._owed.get(trial.run, 0) + 1

    def _restart_block(self, content: Any) -> None:
        number = content["block"]
        for trial in self.trials:
            if trial.block == number:
                trial.leave_out(RESTARTED)
        runs = {run.number for block in self.blocks if block.number == number for run in block.runs}
        self.skipped -= runs
        self._owed = {run: owed for run, owed in self._owed.items() if run not in runs}
        self.answered = {
            key: answer for key, answer in self.answered.items() if key[1] != number or number == 0
        }

    def _retry(self, content: Any) -> None:
        self._retried[content["run"]] = self.newest

    def _rest(self, content: Any) -> None:
        self._rested[content["reason"]] = self.newest

    def _add_answer(self, content: Any) -> None:
        if content["item"] == FITTED:
            self.fitted = self._fit_of(next(one for one in self.blocks if one.number == content["block"]))
        else:
            self.answered[content["item"], content["block"]] = content["answer"]

    def _add_note(self, content: Any) -> None:
        self.notes.append((content["trial"], content["text"]))

    def _pause(self, content: Any) -> None:
        self.paused = content["reason"]

    def _continue(self, content: Any) -> None:
        self.paused, self._continued = None, self.newest

    def _resume(self, content: Any) -> None:
        self.stopped = None
        if any(one.fit for one in self.protocol.condition):
            self.fitted = None

    def _stop(self, content: Any) -> None:
        self.stopped = content["reason"]

    def _end(self, content: Any) -> None:
        self.ended = content["reason"]

    def _begin_block(self, content: Any) -> None:
        self.begun.append(content["block"])

    def _skip(self, content: Any) -> None:
        self.skipped.add(content["run"])

    _changes: ClassVar[Mapping[str, Callable[[SessionState, Any], None]]] = {
        "block": _begin_block,
        "trial": _add_trial,
        "judged": _set_verdict,
        "redone": _redo,
        "retried": _retry,
        "restarted": _restart_block,
        "skipped": _skip,
        "rested": _rest,
        "answered": _add_answer,
        "note": _add_note,
        "paused": _pause,
        "continued": _continue,
        "resumed": _resume,
        "stopped": _stop,
        "ended": _end,
    }

    @property
    def newest(self) -> int:
        """Number of the newest trial; 0 before the first."""
        return self.trials[-1].trial if self.trials else 0

    @property
    def thermal_time_constant_s(self) -> float:
        """Thermal time constant of the motor's winding (s)."""
        return float(self.experiment["rig"]["limits"]["thermal_time_constant_s"])

    def trial_numbered(self, number: int) -> RecordedTrial:
        """Return the trial with this number; raise `RecordingError` if the log does not contain it."""
        if not 1 <= number <= len(self.trials) or self.trials[number - 1].trial != number:
            raise RecordingError(
                f"an event in the session's log refers to trial {number}, which the log does not contain",
                remedy="restore the log from a copy",
            )
        return self.trials[number - 1]

    def trials_of(self, run: SearchRun) -> list[RecordedTrial]:
        """Return all trials of a search for the stiffest stable wall that were not excluded, also invalid ones."""
        return [trial for trial in self.trials if trial.run == run.number and not trial.void]

    def rule(self, run: SearchRun) -> Rule:
        """Return the rule (e.g. a staircase) by which a search chooses its walls, without catch trials."""
        return rule_of(self.protocol, run)

    def answers(self, run: SearchRun) -> list[JudgedProbe]:
        """Return the judged walls of a search from which its rule (e.g. a staircase) chooses the next wall.

        Staircases and ascending series derive the next wall from the sequence of walls that they chose. After the
        correction of a verdict such a rule receives only the answers to walls that it would still have chosen, so that
        it never jumps to a distant wall. `judged_probes` also returns the other answers, for estimates that do not
        depend on the sequence.
        """
        probes = self.judged_probes(run)
        if run.number not in self.corrected or run.practice or self._search(run).rule not in WALKING:
            return probes
        rule = self.rule(run)
        led: list[JudgedProbe] = []
        for answer in probes:
            # A rule in `WALKING` derives its level from its own walls: an answer to another wall would let it jump.
            if answer.probe.catch or rule.next(led) == answer.probe:
                led.append(answer)
        return led

    def judged_probes(self, run: SearchRun) -> list[JudgedProbe]:
        """Return all judged walls of a search for the stiffest stable wall: one for each judged trial that counts.

        A wall without a clear verdict has `stable` None: it is presented again. After `trial.unsure` unsure verdicts in
        a row on the same wall, the last of them counts as not stable.
        """
        probes: list[JudgedProbe] = []
        unsure, about = 0, None
        for trial in self.trials_of(run):
            if not trial.judged:
                continue
            unsure = 0 if trial.verdict != "unsure" else unsure + 1 if trial.probe == about else 1
            about = trial.probe
            stable: bool | None = trial.verdict == "stable"
            if unsure:
                stable = None if unsure < self.protocol.trial.unsure else False
                unsure = 0 if stable is False else unsure
            probes.append(JudgedProbe(trial.probe, stable))
        return probes

    def _search(self, run: SearchRun) -> Search:
        return self.protocol.search_of(self.protocol.condition_named(run.condition))

    def asks(self, run: SearchRun) -> Probe | None:
        """Return the next wall that a search presents to the person; None if the search is finished or was skipped."""
        if run.number in self.skipped:
            return None
        answers = tuple(self.answers(run))
        answered, probe = self._asked.get(run.number, (None, None))
        if answered != answers:
            probe = asking_of(self.protocol, run).next(answers)
            self._asked[run.number] = answers, probe
        return probe

    def next(self) -> Step:
        """Return the next step of the session, e.g. run a trial (`DoTrial`) or rest (`DoRest`)."""
        if self.ended is not None:
            return DoEnd(self.ended)
        counted = [trial for trial in self.trials if not trial.void]
        if counted and not counted[-1].verdict and not counted[-1].invalid:
            return DoJudge(counted[-1])
        over = None if self._has_trial_to_repeat() else self._stop_rule()
        step = None if over else self._next_in_blocks()
        if step is not None:
            return step
        item = self._find_open_question("end", END)
        return item or DoEnd(over or "complete")

    def _next_in_blocks(self) -> Step | None:
        item = self._find_open_question("start", 0)
        if item is not None:
            return item
        for block in self.blocks:
            waiting = [run for run in block.runs if self.asks(run) is not None]
            if waiting:
                return self._next_in_block(block, waiting)
            item = None if block.practice else self._find_open_question("block", block.number)
            if item is not None:
                return item
        return None

    def _next_in_block(self, block: Block, waiting: list[SearchRun]) -> Step:
        first = self._precede_trial(block)
        if first is not None:
            return first
        spoiled = _count_trailing(trial.by_machine for trial in self.trials[self._continued :])
        if spoiled >= self.protocol.stop.machine:
            # A blinded operator may read the log.
            why = summarise_reasons(self.trials[-1].reasons, blind=True)
            return DoPause(f"this computer or the link made {spoiled} trials in a row invalid: {why}")
        last = next((t for t in reversed(self.trials) if t.block == block.number and not t.void), None)
        if last is not None and last.invalid and last.run in [run.number for run in waiting]:
            run = next(run for run in waiting if run.number == last.run)
            if self._invalid_in_a_row(run) >= self.protocol.trial.attempts:
                return DoDecide(run, last)
            attempt = last.attempt + 1
        else:
            run, attempt = waiting[self._choose_search(block, len(waiting))], 1
        due = self._find_due_rest()
        if due is not None:
            return due
        probe = self.asks(run)
        assert probe is not None
        return DoTrial(self._present(block, run, probe, attempt))

    def _precede_trial(self, block: Block) -> Step | None:
        """Return the step that must precede the next trial of a block (rest, fitting a part, begin); None for none."""
        begun = block.number in self.begun
        between = self.protocol.rest.between_blocks_s if self.trials and not begun else 0.0
        if between > 0.0 and self._rested.get("block") != self.newest:
            return DoRest(between, "block")
        return self._ask_fitting(block) or (None if begun else DoBlock(block))

    def _ask_fitting(self, block: Block) -> DoAsk | None:
        fit = self._fit_of(block)
        if fit == self.fitted:
            return None
        taken = f"Take off the rig: {self.fitted}. " if self.fitted else ""
        text = (
            f"{taken}Fit to the rig: {fit}."
            if fit
            else taken.strip() or "Take off what was fitted to the rig."
        )
        return DoAsk(Item(name=FITTED, text=text, kind="choice", choices=(fit or AS_IT_IS,)), block.number)

    def _fit_of(self, block: Block) -> str:
        return self.protocol.condition_named(block.runs[0].condition).fit

    def _present(self, block: Block, run: SearchRun, probe: Probe, attempt: int) -> Presented:
        number = self.newest + 1
        return Presented(
            block=block.number,
            run=run.number,
            trial=number,
            attempt=attempt,
            condition=run.condition,
            damping=run.damping,
            repeat=run.repeat,
            stiffness=probe.level,
            track=probe.track,
            catch=probe.catch,
            practice=run.practice,
            seed=self.seed_of(number),
        )

    def _choose_search(self, block: Block, waiting: int) -> int:
        """Return which of the `waiting` unfinished searches presents the next wall: the first, or a random one."""
        if not block.interleave:
            return 0
        done = sum(1 for t in self.trials if t.block == block.number and not t.void and not t.invalid)
        return int(
            np.random.default_rng([self.seed, self.row, _SEARCH_STREAM, block.number, done]).integers(waiting)
        )

    def seed_of(self, trial: int) -> int:
        """Return the random seed of a trial, for the simulation and the simulated person."""
        return int(np.random.SeedSequence([self.seed, self.row, _TRIAL_STREAM, trial]).generate_state(1)[0])

    def _invalid_in_a_row(self, run: SearchRun) -> int:
        """Return how many of a search's newest trials in a row are invalid, since the operator last continued.

        Trials that computer or link made invalid are not counted.
        """
        since = self._retried.get(run.number, 0)
        count = 0
        for trial in reversed(self.trials_of(run)):
            if not trial.invalid or trial.trial <= since:
                break
            count += not trial.by_machine
        return count

    def _find_due_rest(self) -> DoRest | None:
        rest = self.protocol.rest
        if self.heat > rest.heat:
            seconds = cooling_s(self.heat, rest.heat, self.thermal_time_constant_s)
            return DoRest(math.ceil(seconds), "heat")
        rested = max(self._rested.values(), default=0)
        if rest.every and self.newest - rested >= rest.every:
            return DoRest(rest.seconds, "every")
        return None

    def _find_open_question(self, when: str, block: int) -> DoAsk | None:
        for item in self.protocol.question:
            if item.when == when and (item.name, block) not in self.answered:
                return DoAsk(item, block)
        return None

    def _has_trial_to_repeat(self) -> bool:
        # A discarded trial has to be repeated before the session may end.
        return any(
            self._owed.get(run.number) and self.asks(run) is not None
            for block in self.blocks
            for run in block.runs
        )

    def _stop_rule(self) -> str | None:
        stop = self.protocol.stop
        counted = sum(not (trial.practice or trial.void) for trial in self.trials)
        if stop.trials is not None and counted >= stop.trials:
            return f"{stop.trials} trials"
        if stop.minutes is not None and self.active_s >= 60.0 * stop.minutes:
            return f"{stop.minutes:g} minutes"
        invalid = [one.invalid for one in self.trials if not one.by_machine]
        if stop.invalid is not None and _count_trailing(invalid) >= stop.invalid:
            return f"{stop.invalid} invalid trials in a row"
        aborted = [one.aborted != "" for one in self.trials if not one.invalid]
        if stop.aborts is not None and _count_trailing(aborted) >= stop.aborts:
            return f"{stop.aborts} hits in a row cut off for safety"
        return None


def _run_of(events: Sequence[Event], trial: int) -> int:
    return next(int(e.content["run"]) for e in events if e.kind == "trial" and e.content["trial"] == trial)


def _count_trailing(found: Iterable[bool]) -> int:
    count = 0
    for one in found:
        count = count + 1 if one else 0
    return count


def apply_corrections(events: Iterable[Event]) -> list[Event]:
    """Return the events of a log with corrected content; events that describe corrections remain in the list."""
    events = list(events)
    changes: dict[int, dict[str, Any]] = {}
    for event in events:
        if event.kind == "amended":
            changes.setdefault(event.content["number"], {})[event.content["field"]] = event.content["value"]
    return [
        Event(event.number, event.at, event.kind, {**event.content, **changes[event.number]})
        if event.number in changes
        else event
        for event in events
    ]
