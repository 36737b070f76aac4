"""Measure the impedance that a rig renders: at any walls, under any schemes, without bytes or on a device.

    results = measure_impedance(experiment, walls=[(0.0, 0.0), (20e3, 60.0)])
    results[1].judgement.passive, results[1].fidelity.rms

`rig impedance measure`, maps of impedances, `rig.experiments.measure`, papers and pictures call it. It must not fit
anything itself (`rig.analysis.impedance`), nor load the other kinds of map.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from rig import config
from rig.analysis.impedance import (
    EFFECTIVE_HZ,
    RESIDUAL,
    Z_SCORE,
    Complexes,
    Fidelity,
    Fit,
    Floats,
    Impedance,
    PassivityJudgement,
    RigidRig,
    estimate_welch,
    fidelity,
    fit,
    judge,
    periodic,
    rendered_impedance,
)
from rig.config import Excitation, Experiment
from rig.config.schemes import Scheme
from rig.core.check import refuse
from rig.core.errors import ConfigError, PlanError, RecordingError, UnexpectedVerdictError
from rig.core.keyword import Keyword
from rig.core.present import Item, Row, plain, reported
from rig.core.sample import Motion, Phase, unit_of
from rig.core.shown import Drawn, Shown
from rig.experiments.hits._on_device import Ended, OnDevice, Trials, kept_open
from rig.experiments.mapping._searches import numbers_of
from rig.experiments.trials._excitation_plan import excitation_checks
from rig.experiments.trials.excitation_run import (
    ExcitedRig,
    RealisationRun,
    Signal,
    bound_share,
    excited_law,
    record_of,
)
from rig.experiments.trials.judgement import THREW_OUT, experiment_of, thrown_out
from rig.experiments.trials.plan import STANDS_FOR_DEVICE
from rig.experiments.trials.results import make_directory, write_document, write_table
from rig.recording.data import Recording

__all__ = [
    "ATTEMPTS",
    "SUMMARY",
    "TABLE",
    "ImpedanceResult",
    "Judging",
    "Method",
    "OnDevice",
    "Wall",
    "Watch",
    "conclude",
    "expected",
    "known_device",
    "measure_impedance",
    "measure_on_device",
    "numbers_of",
    "prepared",
    "recorded_impedance",
    "refuse_excitations",
    "unexpected",
    "write_results",
]

Method = Literal["periodic", "welch"]
Wall = tuple[float, float]  # stiffness, damping
Watch = Callable[[int, int], None]  # runs done, runs in all

SEEN: dict[Signal, Literal["sensed", "handle"]] = {"count": "sensed", "truth": "handle"}
ATTEMPTS = 3  # at a realisation whose samples were lost
TABLE, SUMMARY = "impedance.parquet", "impedance.json"

_JUDGEMENT: Final = "Excitation and judgement"  # group of options


@dataclass(frozen=True, slots=True, kw_only=True)
class Judging:
    """Settings of a verdict beside the measurement (`rig.analysis.impedance._verdict.judge`)."""

    band_hz: Annotated[
        tuple[float, float] | None,
        Keyword(
            "Band of the lines used for verdict and fidelity (Hz). [all]",
            "",
            ("--judged-band",),
            _JUDGEMENT,
            "band",
            "LOW:HIGH",
        ),
    ] = None
    z_score: Annotated[
        float,
        Ge(0.0),
        Le(10.0),
        Keyword(
            "Number of standard deviations by which Re Z of a line must be below zero to fail.",
            group=_JUDGEMENT,
        ),
    ] = Z_SCORE
    residual_threshold: Annotated[
        float,
        Ge(0.0),
        Le(1.0),
        Keyword("Share of the motion's power off the lines from which a wall fails.", group=_JUDGEMENT),
    ] = RESIDUAL
    effective_hz: Annotated[
        float,
        Gt(0.0),
        Keyword("Average effective stiffness and damping up to this line (Hz).", group=_JUDGEMENT),
    ] = EFFECTIVE_HZ


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ImpedanceResult(Shown, Drawn):
    """One wall under one scheme.

    Attributes
    ----------
    experiment
        As it ran: scheme, wall and excitation are in it.
    impedance, judgement, fidelity
        None when the guard ended a run.
    fitted
        Mass and viscous damping of a bare rig (no wall), its described back-EMF taken away, else None: K and B are in
        `fidelity`.
    method, signal
        How it was estimated, and from which position.
    ended, ended_s
        Why the guard ended a run, and how long after its beginning (s); None for a whole measurement.
    saturated
        Share of ticks in which the effort was clipped: above zero the rig was not linear.
    recordings
        Recordings of a device; empty for a simulation.
    """

    experiment: Experiment = field(repr=False)
    impedance: Impedance | None
    judgement: PassivityJudgement | None
    fidelity: Fidelity | None
    fitted: Fit | None
    method: Method
    signal: Signal
    ended: str | None = None
    ended_s: float | None = None
    saturated: float = 0.0
    recordings: tuple[Path, ...] = ()

    @property
    def wall(self) -> Wall:
        """Return the wall (stiffness and damping) that was rendered."""
        return self.stiffness, self.damping

    @reported
    def stiffness(self) -> float:
        """Return the stiffness of the wall (N·m/rad or N/m)."""
        return self.experiment.wall.stiffness

    @reported
    def damping(self) -> float:
        """Return the damping of the wall (N·m·s/rad or N·s/m)."""
        return self.experiment.wall.damping

    @property
    def bare(self) -> bool:
        """Return True if the rig was measured without a wall."""
        return self.wall == (0.0, 0.0)

    @reported
    def rig(self) -> str:
        """Return the name of the measured rig."""
        return self.experiment.rig.name

    @reported
    def motion(self) -> Motion:
        """Return its kind of motion, which decides the units."""
        return self.experiment.rig.motion

    @reported
    def scheme(self) -> str:
        """Return the sampling scheme in its text form."""
        return Scheme.of(self.experiment).text

    @reported
    def label(self) -> str:
        """Return the text for legends: wall and scheme."""
        scheme = Scheme.of(self.experiment).label(self.experiment)
        if self.bare:
            return f"bare rig, {scheme}"
        stiffness, damping = unit_of("stiffness", self.motion), unit_of("damping", self.motion)
        return f"K = {self.stiffness:g} {stiffness}, B = {self.damping:g} {damping}, {scheme}"

    @reported
    def loop(self) -> str:
        """Return where the law ran: ``host`` or ``device``."""
        return self.experiment.controller.loop

    @reported
    def note(self) -> str | None:
        """Return how the simulation represents a law on the device; None where it does not."""
        return STANDS_FOR_DEVICE if self.loop == "device" and not self.recordings else None

    @reported
    def excitation(self) -> dict[str, Any]:
        """Return the keys of the excitation, with its size in effect."""
        x = self.experiment
        return {
            **config.as_mapping(x)["excitation"],
            **config.excitation_size(x),
            "channel": x.excitation.channel,
        }

    def brief(self) -> list[Item]:
        """Verdict and fidelity, or what ended it."""
        if self.judgement is None or self.fidelity is None:
            return [self.label, Row("ended", self.ended, note=f"after {self.ended_s:.3g} s")]
        unit, tested = unit_of("damping", self.motion), self.judgement.passivity
        verdict = "passive" if self.judgement.passive else "; ".join(self.judgement.reasons)
        low, high = tested.band_hz
        return [
            self.label,
            Row("passivity", verdict, note=f"{tested.tested} lines, {low:g} to {high:g} Hz"),
            Row("fidelity", self.fidelity.rms, unit, note="rms off the ideal wall"),
        ]

    def expected(self, lines_hz: Floats) -> Complexes | None:
        """Closed form of rig and wall without friction and quantum; None for an estimator that is not linear."""
        return expected(self.experiment, lines_hz, self.signal)


def measure_impedance(
    experiment: Experiment,
    *,
    walls: Sequence[Wall] | None = None,
    schemes: Sequence[Scheme] = (),
    excitation: Excitation | None = None,
    method: Method = "periodic",
    signal: Signal = "count",
    judging: Judging | None = None,
    watch: Watch | None = None,
) -> tuple[ImpedanceResult, ...]:
    """Measure a simulated rig without bytes: every wall under every scheme.

    Parameters
    ----------
    experiment
        The rig, and whatever the other parameters leave out.
    walls
        Stiffness and damping of each; the experiment's own if None. Both zero: the bare rig.
    schemes
        Rates and estimators; the experiment's own if empty.
    excitation
        In place of the experiment's ``[excitation]``.
    method
        ``"periodic"``: the ratio of lines. ``"welch"``: as tfestimate does.
    signal
        Encoder counts, or the simulation's true position of the handle (see `ExcitedRig`).
    judging
        Band and thresholds of the verdict.
    watch
        Called after each run with the number of runs done and their total.

    Raises
    ------
    ConfigError
        Something that cannot be.
    PlanError
        An excitation beyond the limits of effort, position or speed: nothing was run.
    LawError
        Estimator or law give something that is not finite.
    """
    asked = prepared(experiment, walls, schemes, excitation)
    refuse_excitations([one for group in asked for one in group])
    total = sum(len(group) for group in asked) * asked[0][0].excitation.realisations
    done, results = 0, []
    for group in asked:
        bench = ExcitedRig(group[0], signal=signal)
        for one in group:
            runs: list[RealisationRun] = []
            for realisation in range(one.excitation.realisations):
                runs.append(bench.excite(one.wall.stiffness, one.wall.damping, realisation))
                done += 1
                if watch is not None:
                    watch(done, total)
                # A wall that threw the handle out once is not passive: further realisations would not change that.
                if runs[-1].record is None:
                    break
            results.append(conclude(one, runs, method=method, signal=signal, judging=judging))
    return tuple(results)


def unexpected(
    results: Sequence[ImpedanceResult], expected: Collection[str]
) -> UnexpectedVerdictError | None:
    """Return the error for the first wall that is not as expected, ``passive`` or ``not-passive``; None if all are.

    Without expectations everything is expected.
    """
    for result in results:
        word = "not measured"
        if result.judgement is not None:
            word = "passive" if result.judgement.passive else "not-passive"
        if expected and word not in expected:
            return UnexpectedVerdictError(
                f"{result.label} is {word}, expected {' or '.join(expected)}",
                remedy="see its lines in the table, or change what `expect` allows",
            )
    return None


def measure_on_device(
    experiment: Experiment,
    device: OnDevice,
    *,
    walls: Sequence[Wall] | None = None,
    schemes: Sequence[Scheme] = (),
    excitation: Excitation | None = None,
    method: Method = "periodic",
    judging: Judging | None = None,
    watch: Watch | None = None,
    agrees: Callable[[Experiment], bool] | None = None,
) -> Iterator[ImpedanceResult]:
    """Measure a device by its own motor, or a simulated one over its link: one recorded trial for each realisation.

    Parameters are those of `measure_impedance`; `agrees` is asked before each wall, and False ends the session. Yields
    each result as it comes; a guard that trips ends that wall only.

    Raises
    ------
    PlanError
        An excitation beyond the limits, or by a second actuator, which no device has; nothing has moved.
    RigError
        Whatever ended a trial early but for the guard; the effort is zero.
    """
    asked = [one for group in prepared(experiment, walls, schemes, excitation) for one in group]
    if any(one.excitation.channel != "motor" for one in asked):
        raise PlanError(
            'excitation.channel is not "motor": this program cannot drive a second actuator of a device',
            remedy='set excitation.channel = "motor"',
        )
    refuse_excitations(asked)
    total, done = sum(one.excitation.realisations for one in asked), 0
    with kept_open(device, experiment) as trials:
        for one in asked:
            if agrees is not None and not agrees(one):
                return
            runs: list[RealisationRun] = []
            recordings: list[Path] = []
            for realisation in range(one.excitation.realisations):
                run, paths = _record_whole(trials, one, realisation)
                runs.append(run)
                recordings += paths
                done += 1
                if watch is not None:
                    watch(done, total)
                if run.record is None:
                    break
            yield conclude(
                one, runs, method=method, signal="count", judging=judging, recordings=tuple(recordings)
            )


def prepared(
    experiment: Experiment,
    walls: Sequence[Wall] | None,
    schemes: Sequence[Scheme],
    excitation: Excitation | None,
) -> list[list[Experiment]]:
    """Return ExcitedRun experiments to run, checked: the walls of each scheme."""
    if excitation is not None:
        experiment = replace(experiment, excitation=excitation)
    base = config.excited(experiment)
    groups = []
    for scheme in schemes or (Scheme.of(base),):
        ruled = scheme.applied(base)
        groups.append(
            [
                replace(ruled, wall=replace(ruled.wall, stiffness=stiffness, damping=damping))
                for stiffness, damping in walls or ((base.wall.stiffness, base.wall.damping),)
            ]
        )
    for stiffness, damping in walls or ():
        if not (np.isfinite(stiffness) and np.isfinite(damping) and stiffness >= 0.0 and damping >= 0.0):
            raise ConfigError(
                f"the wall has K = {stiffness:g} and B = {damping:g}, which must be finite and not negative",
                remedy="give finite numbers that are not negative",
            )
    return groups


def refuse_excitations(asked: Sequence[Experiment]) -> None:
    """Raise `PlanError` for the first experiment whose excitation exceeds a limit."""
    for one in asked:
        refuse(excitation_checks(one))


def conclude(
    experiment: Experiment,
    runs: Sequence[RealisationRun],
    *,
    method: Method = "periodic",
    signal: Signal = "count",
    judging: Judging | None = None,
    recordings: tuple[Path, ...] = (),
) -> ImpedanceResult:
    """Estimate and judge what was recorded of one wall."""
    judging = judging or Judging()
    saturated = float(np.mean([run.saturated for run in runs]))
    records = [run.record for run in runs if run.record is not None]
    wall = experiment.wall
    if len(records) < len(runs):
        stopped = next(run for run in runs if run.record is None)
        return ImpedanceResult(
            experiment=experiment, impedance=None, judgement=None, fidelity=None, fitted=None,
            method=method, signal=signal, ended=stopped.ended, ended_s=stopped.ended_s, saturated=saturated,
            recordings=recordings,
        )  # fmt: skip
    impedance = (periodic if method == "periodic" else estimate_welch)(records)
    bare = (wall.stiffness, wall.damping) == (0.0, 0.0)
    device = known_device(experiment)
    back_emf = replace(device, inertia=0.0, damping=0.0)
    return ImpedanceResult(
        experiment=experiment,
        impedance=impedance,
        judgement=judge(
            impedance,
            judging.band_hz,
            z_score=judging.z_score,
            residual_threshold=judging.residual_threshold,
        ),
        fidelity=fidelity(
            impedance,
            wall.stiffness,
            wall.damping,
            judging.band_hz,
            device=device,
            effective_hz=judging.effective_hz,
        ),
        fitted=fit(impedance, ("inertia", "damping"), band=judging.band_hz, subtract=back_emf)
        if bare
        else None,
        method=method,
        signal=signal,
        saturated=saturated,
        recordings=recordings,
    )


def recorded_impedance(
    recordings: Sequence[Recording], *, method: Method = "periodic", judging: Judging | None = None
) -> ImpedanceResult:
    """Estimate and judge one wall from the recordings of its realisations; of several attempts at one the last counts.

    Raises
    ------
    RecordingError
        Not an excited trial, or not a whole one.
    ConfigError
        No recording, or recordings of several walls or schemes.
    """
    attempts = {str(one.header["initial_state"]["law"]["parameters"]): one for one in recordings}
    experiments = [experiment_of(one) for one in attempts.values()]
    walls = {(Scheme.of(one).text, one.wall.stiffness, one.wall.damping) for one in experiments}
    if len(walls) != 1:
        raise ConfigError(
            f"the recordings are of {len(walls)} walls; recordings of a single wall are needed",
            remedy="give the recordings of one result of rig.impedance",
        )
    runs = [
        RealisationRun(record_of(one, experiment), saturated=bound_share(one))
        for one, experiment in zip(attempts.values(), experiments, strict=True)
    ]
    paths = tuple(one.path for one in recordings if one.path is not None)
    return conclude(experiments[0], runs, method=method, signal="count", judging=judging, recordings=paths)


def known_device(experiment: Experiment) -> RigidRig:
    """Return the mass, damping and back-EMF of the rig, as its file says."""
    mechanics, amplifier = experiment.rig.mechanics, experiment.rig.amplifier
    return RigidRig(
        inertia=mechanics.motor_inertia + mechanics.loaded_link_inertia,
        damping=mechanics.motor_damping + mechanics.link_damping,
        back_emf=amplifier.back_emf,
        lag_s=amplifier.lag_s,
    )


def expected(experiment: Experiment, lines_hz: Floats, signal: Signal = "count") -> Complexes | None:
    """Return the closed form of rig and wall without friction and quantum, at the measured position, if it exists."""
    wall, seen = experiment.wall, SEEN[signal]
    try:
        return rendered_impedance(experiment, wall.stiffness, wall.damping, lines_hz, seen=seen)
    except ConfigError:
        return None


def _record_whole(
    trials: Trials, experiment: Experiment, realisation: int
) -> tuple[RealisationRun, list[Path]]:
    """Record one realisation; repeat it if samples were lost, because a period with a gap cannot be used."""
    paths: list[Path] = []
    while True:
        try:
            run, path = _record_realisation(trials, experiment, realisation)
            return run, [*paths, path]
        except RecordingError as error:
            if error.recording is None or len(paths) + 1 == ATTEMPTS:
                raise
            paths.append(error.recording)


def _record_realisation(
    trials: Trials, experiment: Experiment, realisation: int
) -> tuple[RealisationRun, Path]:
    """Return one realisation as a recorded trial."""
    trial = config.as_mapping(experiment)["trial"]
    done = trials.run(
        experiment,
        {f"trial.{key}": trial[key] for key in ("kind", "effort", "start", "duration_s")},
        partial(excited_law, experiment, realisation),
    )
    if isinstance(done, Ended):
        recording = done.recorded.recording
        rows = recording.rows[recording.rows["phase"] == Phase.TRIAL]
        if not (len(rows) and thrown_out(recording) == THREW_OUT["out_of_window"]):
            raise done.error
        ended_s = len(rows) / experiment.controller.position_rate
        return RealisationRun(None, done.error.message, ended_s, bound_share(recording)), done.recorded.path
    try:
        record = record_of(done.recording, done.experiment)
    except RecordingError as error:
        error.recording = done.path
        raise
    return RealisationRun(record, saturated=bound_share(done.recording)), done.path


def write_results(results: Sequence[ImpedanceResult], directory: Path) -> tuple[Path, Path]:
    """Write every line of every result as a table, and everything as JSON; returns both paths.

    Raises `rig.core.errors.RecordingError` when the disk refuses.
    """
    make_directory(directory)
    table, summary = directory / TABLE, directory / SUMMARY
    documents = plain(results)
    heads = [{key: value for key, value in one.items() if key != "impedance"} for one in documents]
    write_table(table, _rows(results), _units(results), {"results": heads})
    write_document(summary, {"results": documents})
    return table, summary


def _rows(results: Sequence[ImpedanceResult]) -> Iterator[dict[str, Any]]:
    for number, result in enumerate(results):
        measured = result.impedance
        if measured is None:
            continue
        for i, line in enumerate(measured.lines_hz):
            yield {
                "result": number,
                "scheme": result.scheme,
                "stiffness": result.stiffness,
                "damping": result.damping,
                "frequency": float(line),
                **plain(measured.z[i]),
                "deviation": plain(measured.deviation[i]),
                "coherence_effort": plain(measured.coherence_effort[i]),
                "coherence_motion": plain(measured.coherence_motion[i]),
            }


def _units(results: Sequence[ImpedanceResult]) -> dict[str, str]:
    motion = results[0].experiment.rig.motion if results else "linear"
    damping = unit_of("damping", motion)
    return {
        "stiffness": unit_of("stiffness", motion),
        "damping": damping,
        "frequency": "Hz",
        "real": damping,
        "imaginary": damping,
        "deviation": damping,
    }
