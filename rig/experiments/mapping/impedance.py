"""Measure the impedance that a rig renders at given walls and schemes, in simulation or on a device.

    results = measure_impedance(experiment, walls=[(0.0, 0.0), (20e3, 60.0)])
    results[1].judgement.passive, results[1].fidelity.rms

`rig impedance measure`, maps of impedances, `rig.experiments.measure`, papers and plots call this module. Estimators
and fits are in `rig.analysis.impedance`. This module must not import the other kinds of map.
"""

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
    "refuse_other_excitation",
    "unexpected",
    "write_results",
]

Method = Literal["periodic", "welch"]
Wall = tuple[float, float]  # stiffness, damping
Watch = Callable[[int, int], None]  # runs done, runs in all

SEEN: dict[Signal, Literal["sensed", "handle"]] = {"count": "sensed", "truth": "handle"}
ATTEMPTS = 3  # runs of a realisation if samples are lost
TABLE, SUMMARY = "impedance.parquet", "impedance.json"

_JUDGEMENT: Final = "Excitation and judgement"  # group of options


@dataclass(frozen=True, slots=True, kw_only=True)
class Judging:
    """Thresholds with which a measured impedance is judged passive or not (`rig.analysis.impedance`)."""

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
    """A measured impedance of one wall with one sampling scheme.

    Attributes
    ----------
    experiment
        Experiment as it ran, with scheme, wall and excitation.
    impedance, judgement, fidelity
        Impedance at each frequency, verdict on its passivity, and deviation from the ideal wall; None if the safety
        guard (limits of motion and effort) ended a run.
    fitted
        Mass and viscous damping of the rig without a wall, without the described back-EMF. None for a wall, whose K and
        B are in `fidelity`.
    method, signal
        Method of the estimate, and the measured position (encoder counts or true position).
    ended, ended_s
        Reason why the guard ended a run, and the time since the run's beginning (s); None for a complete measurement.
    saturated
        Fraction of ticks in which the effort was clipped (0 to 1): above zero the rig was not linear.
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
        """Return stiffness and damping of the rendered wall (N·m/rad and N·m·s/rad, or N/m and N·s/m)."""
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
        """Return the rig's kind of motion, rotary or linear, which determines the units."""
        return self.experiment.rig.motion

    @reported
    def scheme(self) -> str:
        """Return the sampling scheme as text, like "uniform:1k,estimator=kalman"."""
        return Scheme.of(self.experiment).text

    @reported
    def label(self) -> str:
        """Return a label for a plot's legend: wall and sampling scheme."""
        scheme = Scheme.of(self.experiment).label(self.experiment)
        if self.bare:
            return f"bare rig, {scheme}"
        stiffness, damping = unit_of("stiffness", self.motion), unit_of("damping", self.motion)
        return f"K = {self.stiffness:g} {stiffness}, B = {self.damping:g} {damping}, {scheme}"

    @reported
    def loop(self) -> str:
        """Return where the control law ran: ``host`` (this computer) or ``device``."""
        return self.experiment.controller.loop

    @reported
    def note(self) -> str | None:
        """Return a sentence if a simulation with the host's control law stands for a law on the device; else None."""
        return STANDS_FOR_DEVICE if self.loop == "device" and not self.recordings else None

    @reported
    def excitation(self) -> dict[str, Any]:
        """Return the values of the section ``[excitation]`` by key, with the computed rms or peak effort (N·m or N)."""
        experiment = self.experiment
        return {
            **config.as_mapping(experiment)["excitation"],
            **config.excitation_size(experiment),
            "channel": experiment.excitation.channel,
        }

    def brief(self) -> list[Item]:
        """Return the lines of a short report: verdict and fidelity, or the reason for an early end."""
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
        """Return the impedance by linear theory at frequencies `lines_hz` (Hz); None for a nonlinear estimator."""
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
    """Measure the impedance of a simulated rig without the byte link, for every wall with every sampling scheme.

    Parameters
    ----------
    experiment
        Rig, and all settings that the other parameters do not replace.
    walls
        Stiffness and damping of each wall (N·m/rad and N·m·s/rad, or N/m and N·s/m); both zero: the rig without a wall.
        None: the experiment's wall.
    schemes
        Rates and estimators. If empty: the experiment's scheme.
    excitation
        Excitation that replaces the experiment's ``[excitation]``; None: no replacement.
    method
        ``"periodic"``: ratio of effort to velocity at the excited frequencies. ``"welch"``: the method of MATLAB's
        tfestimate.
    signal
        Measured position: encoder counts ("count"), or the true position of the simulated handle ("truth").
    judging
        Band and thresholds of the verdict.
    watch
        Called after each run with the number of finished runs and the number of all runs.

    Raises
    ------
    ConfigError
        A wall or a scheme is invalid.
    PlanError
        The excitation exceeds a limit of effort, position or speed; nothing was run.
    LawError
        The estimator or the law returned a value that is not finite.
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
                # A wall that drives the handle out of its window is not passive: further realisations change nothing.
                if runs[-1].record is None:
                    break
            results.append(conclude(one, runs, method=method, signal=signal, judging=judging))
    return tuple(results)


def unexpected(
    results: Sequence[ImpedanceResult], expected: Collection[str]
) -> UnexpectedVerdictError | None:
    """Return an error for the first result whose verdict is not in `expected` (empty: all are accepted); else None."""
    for result in results:
        word = "not measured"
        if result.judgement is not None:
            word = "passive" if result.judgement.passive else "not-passive"
        if expected and word not in expected:
            return UnexpectedVerdictError(
                f"{result.label} is {word}, expected {' or '.join(expected)}",
                remedy="look at the frequencies of this wall in the table, or add this verdict to `expect`",
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
    """Measure the impedance of a real or simulated device, excited by its motor; yield each wall's result in turn.

    Each realisation (run with other random phases) is a recorded trial. `walls`, `schemes`, `excitation`, `method`,
    `judging` and `watch` are those of `measure_impedance`; `agrees` is called with the experiment before each wall, and
    the measurement ends if it returns False. If the safety guard ends a trial, the next wall is measured.

    Raises
    ------
    PlanError
        The excitation exceeds a limit, or needs a second actuator, which no device has; nothing has moved.
    RigError
        A trial ended early, but not by the guard; the effort is zero.
    """
    asked = [one for group in prepared(experiment, walls, schemes, excitation) for one in group]
    if any(one.excitation.channel != "motor" for one in asked):
        raise PlanError(
            'excitation.channel is "external", but this program cannot drive a second actuator of a device',
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
    """Return for each sampling scheme a list of the experiments to run, one for each wall; None: the described ones.

    Raise `ConfigError` for an invalid wall or scheme.
    """
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
                f"the wall has K = {stiffness:g} and B = {damping:g}; both must be finite and not negative",
                remedy="give finite numbers of at least 0 for stiffness and damping",
            )
    return groups


def refuse_excitations(asked: Sequence[Experiment]) -> None:
    """Raise `PlanError` for the first experiment whose excitation exceeds a limit."""
    for one in asked:
        refuse(excitation_checks(one))


def refuse_other_excitation(experiments: Sequence[Experiment]) -> None:
    """Raise `ConfigError` if impedances that are compared differ in band or size of their excitation."""
    # Coulomb friction adds damping that depends on band and size of the motion, alike in all realisations, so that
    # their scatter does not show it.
    kinds = []
    for one in experiments:
        ((name, size),) = config.excitation_size(one).items()
        given, unit = one.excitation, unit_of("effort", one.rig.motion)
        kinds.append(f"{given.low_hz:g} to {given.high_hz:g} Hz with {size:.3g} {unit} {name}")
    if len(set(kinds)) > 1:
        raise ConfigError(
            f"the compared impedances were excited differently: {'; '.join(dict.fromkeys(kinds))}. Friction adds "
            "a different damping to each, which their standard deviations do not contain",
            remedy="measure all walls with the same band and size of the excitation, or show them one by one",
        )


def conclude(
    experiment: Experiment,
    runs: Sequence[RealisationRun],
    *,
    method: Method = "periodic",
    signal: Signal = "count",
    judging: Judging | None = None,
    recordings: tuple[Path, ...] = (),
) -> ImpedanceResult:
    """Estimate and judge the impedance of one wall from its runs, each a realisation with other random phases."""
    judging = judging or Judging()
    saturated = float(np.mean([run.saturated for run in runs]))
    records = [run.record for run in runs if run.record is not None]
    wall = experiment.wall
    if len(records) < len(runs):
        stopped = next(run for run in runs if run.record is None)
        return ImpedanceResult(
            experiment=experiment,
            impedance=None,
            judgement=None,
            fidelity=None,
            fitted=None,
            method=method,
            signal=signal,
            ended=stopped.ended,
            ended_s=stopped.ended_s,
            saturated=saturated,
            recordings=recordings,
        )
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
    """Estimate and judge the impedance of one wall from recordings; of trials with equal phases the last one counts.

    Raises
    ------
    RecordingError
        A recording is not an excited trial, or is incomplete.
    ConfigError
        No recording is given, or recordings of several walls, sampling schemes or excitations.
    """
    attempts = {str(one.header["initial_state"]["law"]["parameters"]): one for one in recordings}
    experiments = [experiment_of(one) for one in attempts.values()]
    refuse_other_excitation(experiments)
    walls = {(Scheme.of(one).text, one.wall.stiffness, one.wall.damping) for one in experiments}
    if len(walls) != 1:
        raise ConfigError(
            f"the recordings are of {len(walls)} walls or schemes; recordings of one wall with one scheme are needed",
            remedy="give the recordings of one result of rig.impedance",
        )
    runs = [
        RealisationRun(record_of(one, experiment), saturated=bound_share(one))
        for one, experiment in zip(attempts.values(), experiments, strict=True)
    ]
    paths = tuple(one.path for one in recordings if one.path is not None)
    return conclude(experiments[0], runs, method=method, signal="count", judging=judging, recordings=paths)


def known_device(experiment: Experiment) -> RigidRig:
    """Return the rig's description without a wall, as rigid body: mass, damping, back-EMF and amplifier lag."""
    mechanics, amplifier = experiment.rig.mechanics, experiment.rig.amplifier
    return RigidRig(
        inertia=mechanics.inertia,
        damping=mechanics.motor_damping + mechanics.link_damping,
        back_emf=amplifier.back_emf,
        lag_s=amplifier.lag_s,
    )


def expected(experiment: Experiment, lines_hz: Floats, signal: Signal = "count") -> Complexes | None:
    """Return the impedance that linear theory predicts at these frequencies (Hz); None for a nonlinear estimator.

    Friction and quantisation are neglected. `signal` is the measured position: "count" or "truth".
    """
    wall, seen = experiment.wall, SEEN[signal]
    try:
        return rendered_impedance(experiment, wall.stiffness, wall.damping, lines_hz, seen=seen)
    except ConfigError:
        return None


def _record_whole(
    trials: Trials, experiment: Experiment, realisation: int
) -> tuple[RealisationRun, list[Path]]:
    """Record one realisation (random phases) until no sample is lost; return its signals and all recordings' paths."""
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
    """Run one realisation (random phases) as a recorded trial; return its signals and the recording's path."""
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
    """Write a Parquet table with a row for each frequency of each result, and all results as JSON; return both paths.

    Raise `rig.core.errors.RecordingError` if a file cannot be written.
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
