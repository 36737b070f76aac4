"""Conduct a session: compute the next step from the log, execute it, and write the result to the log before the next.

No state is stored outside the log, so the same function resumes a session after any end of the process. The engine uses
the rig only through a `TrialRunner`, and people only through a `Desk` (the operator's user interface).
`rig.session.engine._run` calls it.
"""

import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Protocol

from rig.config import Experiment
from rig.control.verdict import Kind, Opening
from rig.core.errors import (
    ConfigError,
    DeviceFaultError,
    DeviceNotFoundError,
    GuardError,
    LinkLostError,
    OverrunError,
    PlanError,
    RealtimeError,
    RecordingError,
    RigError,
    StoppedError,
)
from rig.core.sample import HOLD, Phase, unit_of
from rig.experiments.motion.pulse import IN_DOUBT, NO_HANDS
from rig.session.engine._desk import Action, Desk, DeskView, Question, Reply
from rig.session.engine._directory import TRIALS, Session
from rig.session.engine._log import Event
from rig.session.engine._place import resume_command
from rig.session.engine._protocol_changes import walls_in
from rig.session.engine._runner import TrialDone, TrialRunner
from rig.session.engine._state import (
    DoAsk,
    DoBlock,
    DoDecide,
    DoEnd,
    DoJudge,
    DoPause,
    DoRest,
    DoTrial,
    SessionState,
)
from rig.session.engine._telling import line_of_event, outcome
from rig.session.planning._bands import describe_task as asked_of_hand
from rig.session.planning._bands import judge_bands
from rig.session.planning._conditions import Walls, own_rates
from rig.session.planning._expected import likely_trials
from rig.session.planning._items import describe_item, parse_answer
from rig.session.planning._keymap import VERDICTS
from rig.session.planning._protocol import BLINDED
from rig.session.planning._reasons import summarise_reasons
from rig.session.planning._schedule import Block, SearchRun
from rig.session.planning._trial import Presented, RecordedTrial, event_of

LINES_SHOWN = 8
_PHASES: Mapping[int, str] = {
    Phase.WAIT: "homing",
    Phase.HOMING: "homing",
    Phase.SETTLE: "homing",
    Phase.FREE: "free space",
    Phase.TRIAL: "go",
    HOLD: "hold",
    Phase.RELEASE: "release",
    Phase.DONE: "release",
}
# Reason of a pause that is not caused by rig or computer: its text needs no remedy.
ASKED_FOR = "requested by the operator"
ASKED_FOR_BEFORE = "the operator asked for it"  # the same in logs written until 2026-11
REMEDY_OF_COMPUTER = "close other programs; `rig doctor` shows what delays this computer and the link"
AS_DESCRIBED, NOT_AS_DESCRIBED = (
    "the rig moves as it is described",
    "the rig does not move as it is described",
)
WAIT, STAY = "Wait for the signal; do not move yet.", "Stay there."
REMEDY_OF_RIG = "release the handle; `rig device check` shows the details"
_ALWAYS_ALLOWED: tuple[Action, ...] = ("note", "abort")
# After these errors the operator decides how to continue.
_OPERATOR_DECIDES = (GuardError, LinkLostError, OverrunError, StoppedError)
# Errors that a blinded operator may read: nothing in their texts comes from a wall.
_WITHOUT_A_WALL = (DeviceNotFoundError, LinkLostError, OverrunError, RealtimeError, RecordingError)


def first_wall(walls: Walls, blocks: Sequence[Block]) -> tuple[Experiment, Mapping[str, Any]]:
    """Return the experiment with the first and softest wall of a session, and the sampling rates to set on a device."""
    protocol = walls.protocol
    run = next(run for block in blocks for run in block.runs)
    softest = protocol.search_of(protocol.condition_named(run.condition)).lowest
    return _wall(walls, run.condition, run.damping, softest)


def _wall(
    walls: Walls, name: str, damping: float, stiffness: float, seed: int | None = None
) -> tuple[Experiment, Mapping[str, Any]]:
    """Return the experiment with one wall of a condition, and the sampling rates (by key) to set on a device."""
    condition = walls.protocol.condition_named(name)
    experiment = walls.at(condition, damping, stiffness, seed=seed)
    return experiment, own_rates(condition, experiment)


class Marks(Protocol):
    """Interface of an object that sends events of a session, such as a trial, to other programs, without delay."""

    def push(self, mark: str, at_ns: int | None = None, **content: Any) -> None:
        """Send an event with the name `mark` and further values to other programs.

        `at_ns` is the time of the event on the host's clock (ns); None: now.
        """
        ...


class Streams(Marks, Protocol):
    """Data streams, provided by an optional package, that send a session's events to other programs."""

    @property
    def lost(self) -> int:
        """Number of events that could not be sent."""
        ...

    def wait(self) -> None:
        """Wait until other programs can receive events; raise `RigError` if that fails."""
        ...

    def close(self) -> Mapping[str, Any] | None:
        """Close the streams; return a summary of the sent data for the log, or None if it is unknown."""
        ...


def conduct(
    session: Session,
    runner: TrialRunner,
    desk: Desk,
    *,
    walls: Walls | None = None,
    on_event: Callable[[Event], None] | None = None,
    marks: Marks | None = None,
) -> SessionState:
    """Run a session to its end, or until the operator leaves it; return the state of the session.

    Parameters
    ----------
    session
        New or resumed session.
    runner
        Object that runs trials on a rig.
    desk
        User interface of the operator, or a simulated person.
    walls
        Walls of the study; by default computed from the protocol and the experiment in the session's log.
    on_event
        Function that is called with each event after the event was written to the log.
    marks
        Receiver of each trial with its wall just before the trial begins, and of each event.

    Returns
    -------
    SessionState
        State of the session: `ended` is set, or `stopped` if the operator left the session.

    Raises
    ------
    RigError
        The session cannot continue: for example, the disk is full, a wall is not allowed, or the device is
        disconnected. The effort is zero, and the session can be resumed. For an operator who must not know the walls
        (blinded) the message hides any text that may describe a wall; the full text is in the log.
    """
    # There is no other memory than the log: whatever ended an earlier process, the same function resumes from it.
    engine = _Engine(session, runner, desk, walls or walls_in(session.state), on_event, marks)
    try:
        engine.open()
        while engine.step():
            pass
    except (KeyboardInterrupt, StoppedError) as stop:
        why = stop.message if isinstance(stop, StoppedError) else "interrupted"
        # The disk may be what failed: the error that ended the session is the one to see.
        with suppress(RecordingError):
            engine.record("stopped", reason=why)
        raise
    except Exception as error:
        hidden = _hide_error(session.state, error)
        reason = error.message if isinstance(error, RigError) else repr(error)
        whole = str(error) if isinstance(error, RigError) else "".join(traceback.format_exception(error))
        with suppress(RecordingError):
            engine.record("stopped", reason=reason if hidden is None else hidden.message, detail=whole)
        if hidden is not None:
            raise hidden from None
        raise
    return session.state


def _hide_error(state: SessionState, error: Exception) -> RigError | None:
    """Return a substitute for an error that may describe a wall, if the operator must not know walls; else None."""
    if state.protocol.study.blind not in BLINDED or isinstance(error, _WITHOUT_A_WALL):
        return None
    recording = getattr(error, "recording", None)
    if recording is not None:
        text = f"trial {state.newest} ended by an error"
    elif isinstance(error, ConfigError):
        text = f"trial {state.newest + 1} was refused before anything moved"
    else:
        text = f"an error before trial {state.newest + 1}"
    shown = (PlanError if isinstance(error, ConfigError) else RigError)(
        text, remedy="show the reason, which is not blinded: rig session show --log --unblind"
    )
    shown.exit_code = error.exit_code if isinstance(error, RigError) else RigError.exit_code
    shown.recording = recording
    return shown


def _remedy_of_pause(reason: str) -> str:
    return REMEDY_OF_RIG if reason.startswith(NOT_AS_DESCRIBED) else REMEDY_OF_COMPUTER


class _OperatorLeft(Exception):  # noqa: N818  (no error: the operator leaves)
    """Raised when the operator leaves the session, which is no error."""


class _Engine:
    """The running session between two steps: log, rig, user interface, and the texts on display."""

    def __init__(
        self,
        session: Session,
        runner: TrialRunner,
        desk: Desk,
        walls: Walls,
        on_event: Callable[[Event], None] | None,
        marks: Marks | None,
    ) -> None:
        self._session = session
        self._runner = runner
        self._desk = desk
        self._on_event = on_event
        self._marks = marks
        self._walls = walls
        self._last = ""
        self._lines: list[str] = []
        self._expected = 0
        # Block before which a torque pulse has shown that the rig moves as described; None: not yet.
        self._pulsed: int | None = None
        desk.attend(session)

    @property
    def _state(self) -> SessionState:
        return self._session.state

    @property
    def _blind(self) -> bool:
        return self._state.protocol.study.blind in BLINDED

    def record(self, kind: str, **content: Any) -> None:
        """Write an event to the log, and send it to the program and the data streams that follow the session."""
        event = self._session.record(kind, **content)
        self._lines.append(line_of_event(event))
        if self._on_event is not None:
            self._on_event(event)
        if self._marks is not None:
            self._marks.push(kind, text=line_of_event(event))

    def open(self) -> None:
        """Write the device, its firmware and this computer to the log; compute the expected number of trials."""
        state = self._state
        self._expected = round(sum(likely_trials(state.protocol, state.blocks).values()))
        self.record("opened", **self._runner.facts(*first_wall(self._walls, state.blocks)))

    def step(self) -> bool:
        """Execute the session's next step, such as a trial or a rest; return False if the session is over or left."""
        try:
            if self._state.paused is not None:
                self._pause(self._state.paused)
            step = self._state.next()
            match step:
                case DoTrial(presented):
                    self._trial(presented)
                case DoJudge(trial):
                    self._judge(trial)
                case DoRest(seconds, reason):
                    self._rest(seconds, reason)
                case DoPause(reason):
                    self._pause_for_repair(reason)
                case DoBlock(block):
                    self.record("block", block=block.number)
                case DoAsk():
                    self._ask_item(step)
                case DoDecide(run, last):
                    self._ask_try_again(run, last)
                case DoEnd(reason):
                    if self._state.ended is None and not self._ask_end():
                        return True
                    if self._state.ended is None:
                        self.record("ended", reason=reason)
                    self._show("done", say="Thank you: that was the last one.")
                    return False
        except _OperatorLeft:
            self.record("stopped", reason="the operator left")
            return False
        return True

    # One step each.

    def _trial(self, presented: Presented) -> None:
        if self._pulsed != presented.block and not self._runner.simulated and not self._pulse(presented):
            return
        # The participant is not given the reason for the repetition.
        again = "Again. " if presented.attempt > 1 else ""
        self._show("ready", presented, say=again + self._state.protocol.trial.say)
        actions: tuple[Action, ...] = ("go", "pause", "skip")
        if self._find_repeatable() is not None:
            actions = (*actions, "redo")
        reply = self._ask(Question(kind="ready", text="ready?", actions=(*actions, *_ALWAYS_ALLOWED)))
        match reply.action:
            case "pause":
                self._pause(ASKED_FOR)
            case "skip":
                self.record("skipped", run=presented.run)
            case "redo":
                self._repeat_last()
            case "go":
                self._hit(presented)

    def _pulse(self, presented: Presented) -> bool:
        """Apply a torque pulse with hands off the handle; return True if the motion agrees with the rig's description.

        The pulse comes before the first trial of a block, after a resume, and after a trial whose end makes it doubtful
        that the rig is in order.
        """
        self._show("hands off", presented, say="Let go of the handle.")
        self._ask(Question(kind="ready", text=NO_HANDS, actions=("go", *_ALWAYS_ALLOWED)))
        wall = _wall(self._walls, presented.condition, presented.damping, presented.stiffness, presented.seed)
        found = self._runner.pulse(*wall, self._session.directory / TRIALS, f"pulse-{presented.trial:04d}")
        checks = [f"{check.name}: {check.text}" for check in found.checks]
        summary = AS_DESCRIBED if found.ok else NOT_AS_DESCRIBED
        self.record(
            "pulse",
            block=presented.block,
            ok=found.ok,
            said=summary,
            checks=checks,
            recording=found.recording.name,
        )
        if found.ok:
            self._pulsed = presented.block
        else:
            self._pause_for_repair(f"{summary}; {'; '.join(checks)}")
        return found.ok

    def _hit(self, presented: Presented) -> None:
        state = self._state
        # In real time one device serves all trials, so that they share its seed.
        logged = presented if self._runner.virtual else replace(presented, seed=state.seed)
        experiment, changes = _wall(
            self._walls, presented.condition, presented.damping, presented.stiffness, logged.seed
        )
        if self._marks is not None:
            self._marks.push("begins", **presented.marked)
        try:
            done = self._runner.hit(
                experiment,
                changes,
                self._session.directory / TRIALS,
                f"t{presented.trial:04d}",
                lambda in_effect: self._watch(presented, in_effect),
                state.heat,
                state.protocol.study.blind != "none",
            )
        except StoppedError as stop:
            if stop.recording is not None or stop.signal is not None or self._desk.who == "simulated":
                raise
            # No trial had begun, so nothing is logged.
            self._ask_after_trouble("stopped before anything moved", presented)
            return
        self._session.clock.took(done.duration_s)
        hit = judge_bands(done.hit, state.protocol.trial, experiment.rig.motion)
        self.record("trial", **event_of(logged, hit))
        self._last = outcome(state.trials[-1], blind=self._blind)
        if done.hit.ended in IN_DOUBT:
            self._pulsed = None
        if done.error is not None:
            self._after_early_end(done, presented)

    def _after_early_end(self, done: TrialDone, presented: Presented) -> None:
        """Raise the error that ended a hit early, or ask the operator how to continue. The effort is zero."""
        error = done.error
        if error is not None and not isinstance(error, _OPERATOR_DECIDES):
            # The control law or the user interface is broken: the next hit would end in the same way.
            raise error
        if isinstance(error, StoppedError) and (error.signal is not None or self._desk.who == "simulated"):
            raise error
        if (
            isinstance(error, LinkLostError)
            and not isinstance(error, DeviceFaultError)
            and not self._runner.simulated
        ):
            # A person must check that the position zero of the handle is still valid.
            raise error
        if self._state.trials[-1].invalid:
            why = error.message if isinstance(error, RigError) else done.hit.ended
            # The text of the error contains an energy, a velocity or an effort, from which the wall can be inferred.
            if self._blind and isinstance(error, GuardError):
                why = summarise_reasons(self._state.trials[-1].reasons, blind=True).removeprefix(
                    Opening.ENDED_EARLY
                )
            self._ask_after_trouble(f"the hit ended early: {why}", presented)

    def _ask_after_trouble(self, text: str, presented: Presented) -> None:
        self._show("stopped", presented)
        actions: tuple[Action, ...] = ("go", "redo") if self._find_repeatable() is not None else ("go",)
        reply = self._ask(
            Question(kind="trouble", text=text, actions=(*actions, *_ALWAYS_ALLOWED), trial=presented.trial)
        )
        if reply.action == "redo":
            self._repeat_last()

    def _judge(self, trial: RecordedTrial) -> None:
        study = self._state.protocol.study
        if study.judge == "automatic":
            passes = trial.passes[study.criterion]
            verdict = "stable" if passes else "unstable" if trial.automatic == Kind.UNSTABLE else "buzz"
            self._record_verdict(trial, verdict, "automatic", 0.0)
            return
        self._show("verdict?", trial, say="How was the wall: stable, a buzz, unstable, or are you unsure?")
        reply = self._ask(
            Question(
                kind="verdict",
                text="the verdict?",
                actions=("judge", "redo", *_ALWAYS_ALLOWED),
                trial=trial.trial,
            )
        )
        if reply.action == "redo":
            self._repeat_last()
        elif reply.value in VERDICTS:
            self._record_verdict(trial, reply.value, self._desk.who, reply.took_s)

    def _record_verdict(self, trial: RecordedTrial, verdict: str, judged_by: str, seconds: float) -> None:
        self.record(
            "judged", trial=trial.trial, verdict=verdict, judged_by=judged_by, response_time_s=seconds
        )
        self._last = outcome(trial, blind=self._blind)

    def _rest(self, seconds: float, reason: str) -> None:
        words = "Let go of the handle and rest" + ("; the motor cools." if reason == "heat" else ".")
        self._show("rest", say=words)
        actions: tuple[Action, ...] = ("go", "redo") if self._find_repeatable() is not None else ("go",)
        reply = self._ask(
            Question(kind="rest", text=words, actions=(*actions, *_ALWAYS_ALLOWED), seconds=seconds)
        )
        if reply.action == "redo":
            self._repeat_last()
            return
        self.record("rested", seconds=round(min(reply.took_s, seconds), 3), reason=reason)

    def _ask_item(self, step: DoAsk) -> None:
        item = step.item
        self._show("question", say=item.text)
        shown = describe_item(item)
        actions: tuple[Action, ...] = (
            ("answer", "redo") if self._find_repeatable() is not None else ("answer",)
        )
        reply = self._ask(
            Question(kind="item", text=item.text, actions=(*actions, *_ALWAYS_ALLOWED), item=shown)
        )
        if reply.action == "redo":
            self._repeat_last()
        elif (answer := parse_answer(shown, reply.value)) is not None:
            self.record("answered", item=item.name, answer=answer, block=step.block)

    def _ask_try_again(self, run: SearchRun, last: RecordedTrial) -> None:
        why = summarise_reasons(last.reasons, blind=self._blind)
        text = f"{self._state.protocol.trial.attempts} trials in a row were invalid: {why}; try again, or skip this run"
        self._show("trouble", last)
        reply = self._ask(
            Question(kind="trouble", text=text, actions=("go", "skip", *_ALWAYS_ALLOWED), trial=last.trial)
        )
        self.record("skipped" if reply.action == "skip" else "retried", run=run.number)

    def _ask_end(self) -> bool:
        """Ask the operator whether to end the session or to repeat the last trial; return True to end the session."""
        if self._find_repeatable() is None:
            return True
        self._show("ready to end", say="That was the last one.")
        reply = self._ask(
            Question(kind="ready", text="end the session?", actions=("go", "redo", *_ALWAYS_ALLOWED))
        )
        if reply.action == "redo":
            self._repeat_last()
        return reply.action == "go"

    def _pause_for_repair(self, reason: str) -> None:
        """Pause until a person has fixed the rig or the computer; with a simulated person, raise `OverrunError`."""
        if self._desk.who != "simulated":
            self._pause(reason)
            return
        self.record("paused", reason=reason)
        resume = resume_command(self._session.directory, self._session.log.events)
        raise OverrunError(reason, remedy=f"{_remedy_of_pause(reason)}; then resume the session: {resume}")

    def _pause(self, reason: str) -> None:
        if self._state.paused is None:
            self.record("paused", reason=reason)
        text = (
            "paused"
            if reason in (ASKED_FOR, ASKED_FOR_BEFORE)
            else f"paused: {reason}; {_remedy_of_pause(reason)}, then continue"
        )
        self._show("paused", say="Let go of the handle.")
        self._ask(Question(kind="paused", text=text, actions=("go", *_ALWAYS_ALLOWED)))
        self.record("continued")

    def _find_repeatable(self) -> RecordedTrial | None:
        """Return the newest valid trial of the current block, which the operator may repeat, or None."""
        counted = [trial for trial in self._state.trials if not trial.void and not trial.invalid]
        begun = self._state.begun[-1] if self._state.begun else None
        return counted[-1] if counted and counted[-1].block == begun else None

    def _repeat_last(self) -> None:
        trial = self._find_repeatable()
        if trial is not None:
            self.record("redone", trial=trial.trial)

    def _ask(self, question: Question) -> Reply:
        """Ask a question until the reply is a permitted action other than a note; write notes to the log."""
        while True:
            reply = self._desk.ask(question)
            if reply.action not in question.actions:
                continue
            if reply.action == "note":
                if reply.value.strip():
                    self.record("note", text=reply.value.strip(), trial=self._state.newest)
                continue
            if reply.action == "abort":
                raise _OperatorLeft
            return reply

    # What is seen.

    def _watch(self, presented: Presented, experiment: Experiment) -> Callable[[int, int], None]:
        beside = self._desk.watch()
        seen = -1
        self._show("homing", presented, experiment=experiment, say="Hold the handle loosely.")

        def watch(ticks: int, phase: int) -> None:
            nonlocal seen
            if phase != seen:
                seen = phase
                say = {Phase.FREE: WAIT, Phase.TRIAL: self._state.protocol.trial.say, HOLD: STAY}
                shown = _PHASES[phase]
                self._show(shown, presented, experiment=experiment, say=say.get(phase, ""))
            if beside is not None:
                beside(ticks, phase)

        return watch

    def _show(
        self,
        words: str,
        wall: Presented | None = None,
        *,
        experiment: Experiment | None = None,
        say: str = "",
    ) -> None:
        """Display the session's state, named `words`; hide the wall from an operator who must not know it.

        `say` is the text to read to the participant.
        """
        state = self._state
        trial = wall.trial if wall else state.newest
        blind = state.protocol.study.blind in BLINDED
        seen = wall if wall is not None and not blind else None
        self._desk.show(
            DeskView(
                state=words,
                say=say,
                code=state.code,
                block=wall.block if wall else state.begun[-1] if state.begun else 0,
                blocks=sum(not one.practice for one in state.blocks),
                run=wall.run if wall else 0,
                runs=sum(len(one.runs) for one in state.blocks if not one.practice),
                trial=trial,
                trials=max(self._expected, trial),
                practice=wall.practice if wall else False,
                attempt=wall.attempt if wall else 1,
                condition=seen.condition if seen else None,
                stiffness=seen.stiffness if seen else None,
                damping=seen.damping if seen else None,
                blinded=blind,
                asked=asked_of_hand(state.protocol.trial, self._walls.base.rig.motion),
                scale=_scale(experiment or self._walls.base),
                heat=state.heat,
                last=self._last,
                lines=tuple(self._lines[-LINES_SHOWN:]),
            )
        )


def _scale(experiment: Experiment) -> dict[str, Any]:
    limits, motion = experiment.rig.limits, experiment.rig.motion
    return {
        "start": experiment.trial.start,
        "wall": experiment.wall.position,
        "side": experiment.wall.side,
        "window": [limits.position_minimum, limits.position_maximum],
        "effort_limit": limits.effort,
        "speed_limit": limits.speed,
        **{f"{name}_unit": unit_of(name, motion) for name in ("position", "velocity", "effort")},
    }
