"""Define the functions of the Python interface that measure impedances and identify a rig's parameters.

Each function adapts its arguments and calls the same function as the command of the same name.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict, Unpack

from rig import config
from rig.config import DEFAULT_PRESET
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.experiments import sweep
from rig.experiments.hits._on_device import OnDevice
from rig.experiments.identification import identify as identifying
from rig.experiments.identification.identify import Identification, IdentifyRequest
from rig.experiments.lab import ExperimentLike, load
from rig.experiments.mapping import _maps as maps
from rig.experiments.mapping import impedance as measuring
from rig.experiments.mapping._ranges import frequency_plan
from rig.experiments.mapping.impedance import ImpedanceResult, Judging, Method, Wall
from rig.experiments.mapping.zwidth_frequency import FrequencyMap
from rig.experiments.trials.excitation_run import Signal
from rig.experiments.trials.settings import Settings, takes
from rig.recording.data import Recording
from rig.recording.reader import open_recording

EXCITED_PRESET = "chawda-linear"


@takes(Settings)
def impedance(
    experiment: ExperimentLike = EXCITED_PRESET,
    walls: Sequence[Wall] | None = None,
    schemes: Sequence[str | Scheme] = (),
    *,
    excitation: Mapping[str, Any] | None = None,
    method: Method = "periodic",
    signal: Signal = "count",
    judging: Judging | None = None,
    url: str | None = None,
    realtime: bool = False,
    verified: bool = False,
    arm_anyway: bool = False,
    hands_off: Callable[[str], None] | None = None,
    output: str | Path = "impedances",
    agrees: Callable[[config.Experiment], bool] | None = None,
    watch: Callable[[int, int], None] | None = None,
    **settings: Unpack[Settings],
) -> tuple[ImpedanceResult, ...]:
    """Measure the impedance that a rig renders at each wall with each sampling scheme (`rig impedance measure`).

    Parameters
    ----------
    experiment
        Preset's name, path of a TOML file, or experiment.
    walls
        Stiffness and damping of each wall (N·m/rad and N·m·s/rad, or N/m and N·s/m); ``(0.0, 0.0)`` is the rig without
        a wall. None: the experiment's wall.
    schemes
        Rates and estimators, like ``"uniform:1k,estimator=kalman"``. If empty: the experiment's scheme.
    excitation
        Keys of ``[excitation]``: ``{"rms": 5.0, "realisations": 4}`` (N·m or N). With a `url` its ``channel`` is
        ``"motor"`` unless given.
    method
        ``"periodic"``: ratio of effort to velocity at the excited frequencies. ``"welch"``: the method of MATLAB's
        tfestimate.
    signal
        Measured position. ``"count"``: of the encoder. ``"truth"``: of the simulated handle, only without a `url`.
    judging
        Band and thresholds of verdict and fidelity, like ``rig.Judging(band_hz=(2.0, 50.0))``.
    url, realtime, verified, arm_anyway, hands_off, output
        Device and permissions: its motor excites the rig, and each realisation (draw of the phases) is recorded in
        `output`. Without a `url` the rig is simulated without the byte link, and nothing is recorded.
    agrees
        On a device, called with the experiment before each wall; the measurement ends if it returns False.
    watch
        Called after each run with the number of finished runs and the number of all runs.
    **settings
        Values of keys to change, in SI units, like ``effort=2.0``.

    Returns
    -------
    tuple of ImpedanceResult
        One result for each scheme and wall: the impedance at each frequency, its passivity and its fidelity.

    Raises
    ------
    ConfigError, PlanError
        The request is invalid, or the excitation exceeds a limit; nothing has moved.
    RigError
        A run on a device ended early, but not by the safety guard (limits of motion); the effort is zero.
    """
    changes = {f"excitation.{key}": value for key, value in (excitation or {}).items()}
    if url is not None:
        changes = {"excitation.channel": "motor", **changes}
    loaded = config.override(load(experiment, **settings), changes, "the excitation")
    shared: dict[str, Any] = {
        "walls": walls,
        "schemes": _schemes(schemes),
        "method": method,
        "judging": judging,
        "watch": watch,
    }
    if url is None:
        return measuring.measure_impedance(loaded, signal=signal, **shared)
    if signal != "count":
        raise ConfigError(
            f"signal = {signal!r} cannot be used with a device, which records counts only",
            remedy='set signal="count"',
        )
    device = OnDevice(
        url=url,
        recordings=output,
        realtime=realtime,
        verified=verified,
        arm_anyway=arm_anyway,
        hands_off=hands_off,
    )
    return tuple(measuring.measure_on_device(loaded, device, agrees=agrees, **shared))


def read_impedance(
    recordings: Iterable[str | Path | Recording],
    *,
    method: Method = "periodic",
    judging: Judging | None = None,
) -> ImpedanceResult:
    """Estimate and judge the impedance of one wall from the recordings of its realisations (random phases).

    Parameters
    ----------
    recordings
        Recordings of one wall with one scheme, or the paths of their files (`ImpedanceResult.recordings`).
    method, judging
        ``"periodic"`` or ``"welch"`` (MATLAB's tfestimate), and thresholds of verdict and fidelity.

    Returns
    -------
    ImpedanceResult
        The same result as `impedance` returns for these recordings.

    Raises
    ------
    RecordingError
        A recording is not an excited trial, or is incomplete.
    ConfigError
        No recording is given, or recordings of several walls.
    """
    opened = [one if isinstance(one, Recording) else open_recording(one) for one in recordings]
    return measuring.recorded_impedance(opened, method=method, judging=judging)


@takes(Settings)
def impedance_map(
    experiment: ExperimentLike = EXCITED_PRESET,
    schemes: Sequence[str | Scheme] = (),
    *,
    stiffnesses: Sequence[float] | None = None,
    dampings: Sequence[float] | None = None,
    excitation: Mapping[str, Any] | None = None,
    signal: Signal | None = None,
    judging: Judging | None = None,
    directory: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    watch: Callable[[sweep.Progress], None] | None = None,
    **settings: Unpack[Settings],
) -> FrequencyMap:
    """Excite a simulated rig at every wall of a grid; map where it is passive and faithful (`rig impedance map`).

    Parameters
    ----------
    experiment, excitation, judging
        Rig, keys of ``[excitation]`` like ``{"rms": 5.0}``, and thresholds of verdict and fidelity.
    schemes
        Sampling schemes, one map each. If empty: those of Chawda et al., with their four estimators.
    stiffnesses, dampings
        Values of the grid, ascending (N·m/rad and N·m·s/rad, or N/m and N·s/m). None: chosen by linear theory.
    signal
        Measured position: encoder ``"count"`` (default of a rigid rig), or the handle's ``"truth"`` (of two masses).
    directory, workers, scheduler, watch
        Directory to store and resume the map, number of threads, Dask scheduler, function called with the progress.
    **settings
        Values of keys to change, in SI units, like ``effort=2.0``.

    Returns
    -------
    FrequencyMap
        ``passive`` and ``fidelity`` by scheme, realisation, damping and stiffness; `table_one` computes widths from the
        map.

    Raises
    ------
    ConfigError, PlanError
        A sampling scheme or a grid is invalid, or the excitation exceeds a limit.
    StoppedError
        Ctrl-C was pressed; the results of finished parts stay in the directory.
    """
    changes = {f"excitation.{key}": value for key, value in (excitation or {}).items()}
    plan = frequency_plan(
        config.override(load(experiment, **settings), changes, "the excitation"),
        _schemes(schemes),
        stiffnesses=stiffnesses,
        dampings=dampings,
        judging=judging,
        signal=signal,
    )
    if directory is None:
        return maps.zwidth(plan, scheduler=scheduler, workers=workers, watch=watch)
    place = maps.directory_for(plan, Path(directory), "impedance-map")
    return maps.map_into(plan, place, scheduler=scheduler, workers=workers, watch=watch)


class IdentifyOptions(TypedDict, total=False):
    """Keywords of `identify`: device, motions and recordings of an identification."""

    url: str | None
    changes: Mapping[str, Any]
    verified: bool
    output: str | Path
    realisations: int
    period_s: float
    seed: int
    cogging: int | None
    rate_hz: int | None
    mass_kg: float | None
    arm_m: float | None


@takes(IdentifyOptions, IdentifyRequest)
def identify(
    experiment: ExperimentLike = DEFAULT_PRESET,
    *,
    tell: Callable[[str], None] | None = None,
    ask: Callable[[str], None] | None = None,
    **options: Unpack[IdentifyOptions],
) -> Identification:
    """Identify signs, friction, inertia, damping, delay and first mode of a rig with a free handle (`rig identify`).

    Parameters
    ----------
    experiment
        Description of the rig as far as it is known: preset's name, path of a file, or experiment. Its limits apply.
    tell
        Called with a line of text about the next step.
    ask
        Called with an instruction to a person; must return when the person has followed it. Required to hang a mass on
        a real rig.
    **options
        `changes` has other keys of the experiment, by dotted name. `rate_hz` is the rate of the loop (Hz; None: the
        experiment's rate, in real time at most what the measured link permits). With `cogging`, `mass_kg` and `arm_m`
        are a mass (kg) and its lever arm (m) with which the sweeps are repeated.

    Returns
    -------
    Identification
        Fits with 95 % intervals, the recordings, and ``experiment`` with the identified values; `format_identification`
        returns these values as the text of a file.

    Raises
    ------
    ConfigError, PlanError
        The request is invalid or not permitted; nothing has moved.
    IdentificationError
        The signs are wrong, or the data do not determine a value; the message states the reason.
    RigError
        A trial ended early; the effort is zero.
    """
    request = IdentifyRequest(experiment=load(experiment), **options)
    return identifying.identify(request, tell, ask)


def _schemes(schemes: Sequence[str | Scheme]) -> tuple[Scheme, ...]:
    return tuple(Scheme.parse(one) if isinstance(one, str) else one for one in schemes)
