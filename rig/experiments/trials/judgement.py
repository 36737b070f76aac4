"""Judge a recording: the verdict by its recorded signals, and for a simulation also by its true signals.

Hits, replays, maps, estimator comparisons, sessions, `rig recording show` and `rig.testing` call this module. It must
not change a recording or its recorded verdict, and opens no device.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from firmware_protocol.faults import OUT_OF_TIME, Fault
from rig.config import BOARD_ARITHMETICS, Experiment, experiment_from_mapping, rig_model, verdict_thresholds
from rig.control import judging, verdict
from rig.control.verdict import Kind, Measured, Objection, Opening, Verdict, percent
from rig.core.deferred import pydantic
from rig.core.errors import ConfigError, RecordingError, UnexpectedVerdictError
from rig.core.present import Row, written
from rig.core.sample import Phase, unit_of
from rig.experiments.trials._motion_balance import FACTOR, WINDOW_S, MotionBalance, motion_balance
from rig.recording.data import Recording
from rig.recording.origin import cut_facts, refuse_counts

JUDGED = (  # columns that `judge` takes
    "phase",
    "elapsed_ticks",
    "flags",
    "position",
    "penetration",
    "effort_sent",
    "effort_applied",
    "limits",
    "command_age",
    "position_true",
    "handle_position_true",
    "handle_velocity_true",
    "effort_true",
)
# Longest lag of the motor as a fraction of a window of the motion balance.
LATE_SHARE = 0.2
# The motion balance uses this time before and after the contact (s): later the handle rests, and memory is limited.
BALANCED_S = 1.0
FINISHED = "finished"  # reason in the trailer of a complete run
THREW_OUT = {  # sentence on an unstable wall, by the reason in the trailer
    "out_of_window": "the wall threw the handle out of its window or beyond the speed limit",
    "energy": "the wall gave the hand more energy than rig.limits.energy",
    "violent": "the wall oscillated: the effort alternated between zero and its limit",
}
THROWN_OUT = {Fault.POSITION_WINDOW.name, Fault.OVER_SPEED.name, Fault.RUNAWAY.name}


def experiment_of(recording: Recording) -> Experiment:
    """Return the experiment as recorded, with all changes; raise `RecordingError` if this version cannot read it."""
    refuse_counts(recording)
    try:
        return experiment_from_mapping(recording.experiment, "the recording's header")
    except ConfigError as error:
        raise RecordingError(
            error.message, remedy="read the recording with the version of haptic-rig that wrote it"
        ) from error


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdicts:
    """The verdicts on the wall of a recorded trial, as stored at the end of the recording.

    Attributes
    ----------
    verdict, verdict_true
        Verdict by the recorded signals, and by the true signals of a simulation (None on a real rig). A verdict is
        invalid for a trial that ended early, or unstable if the wall drove the handle out of its window.
    began
        Position at the beginning of the push (rad or m); None if the run ended before it.
    motion
        Encoder's scale before and after the contact; None if effort or friction are unknown.
    """

    verdict: Verdict
    verdict_true: Verdict | None
    began: float | None
    motion: MotionBalance | None

    def rows(self, experiment: Experiment) -> list[Row]:
        """Return the verdict and its numbers as rows to print; in a simulation each row also has the true value."""
        verdict, true, motion = self.verdict, self.verdict_true, experiment.rig.motion
        thresholds, count = verdict_thresholds(experiment), experiment.rig.encoder.resolution
        position, velocity, effort = (unit_of(name, motion) for name in ("position", "velocity", "effort"))

        def beside(text: str, name: str, threshold: float = 0.0) -> str:
            value = None if true is None else getattr(true, name)
            shown = "" if value is None else f"true {written(_drop_rounding(value, threshold))}"
            return ", ".join(part for part in (text, shown) if part)

        def depth(label: str, name: str) -> Row:
            value = getattr(verdict, name)
            return Row(label, value, position, beside(f"{value / count:.1f} counts", name))

        def ripple(label: str, name: str, unit: str, threshold: float) -> Row:
            value = _drop_rounding(getattr(verdict, name), threshold)
            return Row(label, value, unit, beside(f"limit {threshold:.3g}", name, threshold), digits=3)

        rows = [Row("verdict", verdict.kind, note=beside("", "kind"))]
        rows += [Row("", reason) for reason in verdict.reasons]
        if true is not None and true.kind != verdict.kind:
            rows += [Row("", f"true: {reason}") for reason in true.reasons]
        rows += self._start(experiment, position)
        if verdict.contact_s is not None and verdict.impact_velocity is not None:
            at = f"at {verdict.impact_velocity:.3g} {velocity}"
            rows.append(Row("first contact", verdict.contact_s, "s", at))
        limit = f"limit {experiment.rig.limits.effort:g}"
        # The median of a handle that never settles is no rest: it may lie outside the wall.
        rest = "penetration (median, tail)" if verdict.settling_s is None else "resting penetration"
        return [
            *rows,
            depth("peak penetration", "peak_penetration"),
            depth(rest, "resting_penetration"),
            Row("settling time", verdict.settling_s, "s", digits=3)
            if verdict.settling_s is not None
            else Row("settling time", "never settled"),
            Row("peak effort", verdict.peak_effort, effort, limit, digits=3),
            self._felt(velocity, beside("", "felt", thresholds.felt_velocity), thresholds.felt_velocity),
            ripple("heard (effort ripple, rms)", "heard", effort, thresholds.heard_effort),
            ripple("moved (position ripple, p-p)", "moved", position, thresholds.moved),
            Row("motor current", _current_text(verdict.current_observed)),
            Row("encoder scale", _scale_text(self.motion)),
            Row("saturated", f"{percent(verdict.saturated_fraction)} of ticks"),
            Row(
                "late, lost",
                f"{verdict.late_ticks} late ticks, {verdict.lost_samples} samples lost in {verdict.gaps} gaps",
                note=f"from contact on {percent(verdict.late_fraction)} and {percent(verdict.lost_fraction)}, "
                f"{verdict.longest_gap} in a row at most",
            ),
        ]

    def _start(self, experiment: Experiment, unit: str) -> list[Row]:
        away = 0.0 if self.began is None else abs(self.began - experiment.trial.start)
        if away <= experiment.rig.encoder.resolution:
            return []
        what = "the person" if experiment.trial.kind == "human" else "friction"
        tolerance = f"homing.tolerance_counts = {experiment.homing.tolerance_counts:g}"
        return [
            Row(
                "start",
                self.began,
                unit,
                f"{what} held the handle {away:.2g} {unit} from trial.start ({tolerance})",
            )
        ]

    def _felt(self, unit: str, true: str, threshold: float) -> Row:
        """Return the row of the velocity ripple; "not measurable" if one toggling count exceeds the threshold."""
        felt, floor, label = self.verdict.felt, self.verdict.felt_floor, "felt (velocity ripple, rms)"
        notes = [f"limit {threshold:.3g}", f"encoder floor {floor:.2g}", true]
        if floor == 0.0 and not felt:
            return Row(label, "no count changed in the tail", note=true)
        value = "not measurable" if felt is None else _drop_rounding(felt, threshold)
        return Row(label, value, unit if felt is not None else "", ", ".join(filter(None, notes)), digits=3)


def _current_text(windows: int) -> str:
    if windows == 0:
        return "not checked: not measured, or too small compared with the sensor's noise"
    return f"followed the command, in {windows} windows of 10 ms"


def _scale_text(motion: MotionBalance | None) -> str:
    if motion is None:
        return "not checked: the effort that moves the handle is unknown"
    if motion.ratio is None:
        return "not checked: too little motion before or after the contact"
    return f"{motion.ratio:.2f} times that before the contact, by effort and motion"


def _drop_rounding(value: Any, threshold: float) -> Any:
    """Return 0 for a value so far below its threshold that it is a filter's rounding error; else the value."""
    return 0.0 if isinstance(value, float) and abs(value) < 1e-6 * threshold else value


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement(Verdicts):
    """The verdicts on the wall of a recorded trial, and the measurements from which they follow.

    Attributes
    ----------
    measured, measured_true
        Numbers and criteria behind the verdicts by recorded and by true signals.
    early
        Kind and reason of a verdict that follows from an early end or from a changed scale of the encoder; else None.
    """

    measured: Measured = field(repr=False)
    measured_true: Measured | None = field(repr=False)
    early: tuple[Kind, str] | None = field(repr=False)


def verdicts_of(recording: Recording, experiment: Experiment) -> Verdicts:
    """Return the verdicts stored in a recording; judge the recording now if it has none.

    A running or crashed trial, a cut, and a recording in the format of another version have none.
    """
    try:
        stored: Verdicts = pydantic.TypeAdapter(Verdicts).validate_python(recording.trailer)
    except pydantic.ValidationError:
        return judge(recording, experiment)
    return stored


def judge(recording: Recording, experiment: Experiment) -> Judgement:
    """Measure and judge a recording; `experiment` is the experiment as it ran, which `experiment_of` returns."""
    limits, wall, early = verdict_thresholds(experiment), experiment.wall, ended_early(recording)
    tick_s, thrown_out = 1.0 / experiment.controller.position_rate, early is not None
    elsewhere = recording.header["extra"].get("arithmetic") not in (None, *BOARD_ARITHMETICS)
    signals = judging.recorded_signals(
        recording.rows,
        tick_s,
        experiment.rig.encoder.resolution,
        effort="effort_applied" if elsewhere else "effort_sent",
    )
    measured, true = judging.measure_signals(signals, limits, thrown_out=thrown_out), None
    if recording.has_truth:
        signals = judging.true_signals(recording.rows, signals, wall.position, wall.side)
        true = judging.measure_signals(signals, limits, thrown_out=thrown_out)
    motion = None if early is not None else _motion(recording, experiment, elsewhere=elsewhere)
    if motion is not None and motion.changed:
        early = (
            Kind.INVALID,
            f"the encoder's scale changed in the trial: the same effort makes {motion.ratio:.2g} "
            f"times as much motion as before the contact, allowed are {1.0 / FACTOR:.2g} to "
            f"{FACTOR:g}; check encoder, coupling and cable",
        )
    overruling = early
    if early is None and experiment.trial.kind == "excitation":
        overruling = (
            Kind.INVALID,
            "the rig was excited about its wall, not driven into it: see rig impedance measure",
        )
    return Judgement(
        verdict=_apply_overruling(measured, overruling),
        verdict_true=None if true is None else _apply_overruling(true, overruling),
        measured=measured,
        measured_true=true,
        early=early,
        began=_first_position(recording),
        motion=motion,
    )


def _motion(recording: Recording, experiment: Experiment, *, elsewhere: bool) -> MotionBalance | None:
    """Compare the motion of an automated trial with its effort; None if effort or rig are not known well enough.

    The result is None with a person or an excitation at the handle, with a wall that a drive renders (`elsewhere`),
    with cogging, with lost samples, without a contact, and if the motor lags too far behind its commands.
    """
    rig, rows = experiment.rig, recording.rows
    late_s = rig.amplifier.lag_s + rig.amplifier.set_point_delay_s
    if experiment.trial.kind != "constant-effort" or elsewhere:
        return None
    if rig.cogging.orders or late_s > LATE_SHARE * WINDOW_S:
        return None
    proper = rows["phase"] == Phase.TRIAL
    hits = np.flatnonzero(proper & (rows["penetration"] > 0.0))
    if not len(hits):
        return None
    first, behind = proper.argmax(), len(proper) - proper[::-1].argmax()
    rows, hits = rows[first:behind], hits - first  # a view: a copy of long trials would need gigabytes
    contact, tick_s = int(hits[0]), 1.0 / experiment.controller.position_rate
    some = round(BALANCED_S / tick_s)
    rows = rows[max(0, contact - some) : contact + some]
    contact = min(contact, some)
    if (rows["elapsed_ticks"][1:] != 1).any():
        return None
    mechanics = rig_model(experiment).mechanics
    return motion_balance(
        rows["position"],
        rows["effort_applied"],
        contact,
        tick_s=tick_s,
        resolution=rig.encoder.resolution,
        inertia=mechanics.inertia,
        coulomb=mechanics.motor_coulomb + mechanics.link_coulomb,
        damping=mechanics.motor_damping + mechanics.link_damping + rig.amplifier.back_emf,
    )


def unexpected(verdicts: Sequence[Verdict], expected: Collection[str]) -> UnexpectedVerdictError | None:
    """Return an error for the first verdict, like "unstable", that is not in `expected` (empty: all are), else None."""
    words = [str(one.kind).replace(" ", "-") for one in verdicts]
    wrong = [(number, word) for number, word in enumerate(words) if expected and word not in expected]
    if not wrong:
        return None
    number, word = wrong[0]
    which = f"hit {number + 1} of {len(words)}" if len(words) > 1 else "the hit"
    because = "".join(f": {reason}" for reason in verdicts[number].reasons[:1])
    return UnexpectedVerdictError(
        f"{which} is {word}, expected {' or '.join(expected)}{because}",
        remedy="look at the recording, or add this verdict to `expect`",
    )


def _first_position(recording: Recording) -> float | None:
    proper = recording.rows["phase"] == Phase.TRIAL
    return float(recording.rows["position"][proper.argmax()]) if proper.any() else None


def _apply_overruling(measured: Measured, overruling: tuple[Kind, str] | None) -> Verdict:
    if overruling == FALSE_START:  # a trial that never began has no other reasons
        return verdict.overrule(replace(measured.verdict, reasons=()), *overruling)
    # A wrong current makes the trial invalid, also if the handle left its window: the wall was not rendered.
    if measured.found & Objection.CURRENT:
        return measured.verdict
    return measured.verdict if overruling is None else verdict.overrule(measured.verdict, *overruling)


FALSE_START = (Kind.INVALID, f"{Opening.FALSE_START}the handle moved before the cue")


def thrown_out(recording: Recording) -> str:
    """Return a sentence on how an unstable wall drove the handle out of its limits; empty if it did not."""
    trailer = recording.trailer or {}
    if (trailer.get("fault") or {}).get("name") in THROWN_OUT:
        return THREW_OUT["out_of_window"]
    return THREW_OUT.get(trailer.get("reason", ""), "")


def out_of_time(recording: Recording) -> bool:
    """Return True if a lack of processor or link time ended the run; a repeat of the trial may succeed."""
    return ((recording.trailer or {}).get("fault") or {}).get("name") in OUT_OF_TIME


def ended_early(recording: Recording) -> tuple[Kind, str] | None:
    """Return kind and reason of the verdict if the run ended before the push into the wall did; else None.

    The kind is unstable if the wall drove the handle out of its limits, and invalid after any other early end, and for
    a cut.
    """
    if (facts := cut_facts(recording)) is not None:
        return Kind.INVALID, f"a part of a trial: its verdict is that of {facts['recording']}"
    reason = (recording.trailer or {}).get("reason", "the recording is incomplete: it ends without a reason")
    phases = recording.rows["phase"]
    if reason == FINISHED and (phases == Phase.FREE).any() and not (phases == Phase.TRIAL).any():
        return FALSE_START
    if reason == FINISHED or (phases == Phase.RELEASE).any():
        return None
    thrown = thrown_out(recording)
    touched = bool((recording.rows["penetration"][phases == Phase.TRIAL] > 0.0).any())
    if thrown and touched:
        return Kind.UNSTABLE, thrown
    return Kind.INVALID, f"{Opening.ENDED_EARLY}{reason.replace('_', ' ')}"
