"""Functions to measure a rig: its impedance, walls of a grid, recordings of it, and identification of its parameters.

As `rig.experiments.lab`: arguments are adapted and handed to the functions that commands call, too.
"""

from __future__ import annotations

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
    """Measure the impedance that a rig renders: excite it about each wall under each scheme (`rig impedance measure`).

    Parameters
    ----------
    experiment
        As in `load`.
    walls
        Stiffness and damping of each (N·m/rad and N·m·s/rad, or N/m and N·s/m); the experiment's own if None, and
        ``(0.0, 0.0)`` for the bare rig.
    schemes
        Rates and estimators, as ``"uniform:1k,estimator=kalman"``; the experiment's own if empty.
    excitation
        Keys of ``[excitation]``: ``{"rms": 5.0, "realisations": 4}`` (N·m or N). With a `url` its ``channel`` is
        ``"motor"`` unless given.
    method
        ``"periodic"``: the ratio of the excited lines. ``"welch"``: as tfestimate does.
    signal
        ``"count"``: what the encoder shows. ``"truth"``: the simulated handle; without a `url` only.
    judging
        Band and thresholds of verdict and fidelity, as ``rig.Judging(band_hz=(2.0, 50.0))``.
    url, realtime, verified, arm_anyway, hands_off, output
        A device, as in `hit`: its own motor excites it, and each realisation is recorded in `output`. None: simulated
        without bytes, nothing is recorded.
    agrees
        Called before each wall on a device with the experiment; False ends the measurement.
    watch
        Called with the runs done and all runs.
    **settings
        As in `load`.

    Returns
    -------
    tuple of ImpedanceResult
        Wall after wall, scheme after scheme: the impedance at each line, whether it is passive, its fidelity.

    Raises
    ------
    ConfigError, PlanError
        An invalid request, or an excitation beyond the limits: nothing has moved.
    RigError
        Cause of a run's early end on a device, other than the guard; the effort is zero.
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
            remedy='say signal="count"',
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
    """Estimate and judge the impedance of one wall from the recordings of its realisations.

    Parameters
    ----------
    recordings
        Recordings of one wall under one scheme, or their files: `ImpedanceResult.recordings`.
    method, judging
        As in `impedance`.

    Returns
    -------
    ImpedanceResult
        As `impedance` gives it on the device.

    Raises
    ------
    RecordingError
        Not an excited trial, or not a whole one.
    ConfigError
        No recording, or recordings of several walls.
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
    """Map where the impedance of a simulated rig is passive, and how faithful it is (`rig impedance map`).

    Every wall of a grid is excited.

    Parameters
    ----------
    experiment, excitation, judging
        As in `impedance`.
    schemes
        One map each; those of Chawda et al. if empty: their four estimators.
    stiffnesses, dampings
        Values of the grid, ascending (N·m/rad and N·m·s/rad, or N/m and N·s/m); None: chosen by linear theory.
    signal
        As in `impedance`; if None ``"count"`` on a rigid rig, ``"truth"`` on one of two masses.
    directory, workers, scheduler, watch
        As in `zwidth`.
    **settings
        As in `load`.

    Returns
    -------
    FrequencyMap
        ``passive`` and ``fidelity`` by scheme, realisation, damping and stiffness; `table_one` makes widths of it.

    Raises
    ------
    ConfigError, PlanError
        A scheme or a grid that cannot be, or an excitation beyond the limits.
    StoppedError
        Ctrl-C; what is done stays in the directory.
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
    """Keywords of `identify`: fields of an `IdentifyRequest`, with their types there."""

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
    """Identify a rig whose handle is free: signs, friction, inertia, damping, delay, first mode (`rig identify`).

    Parameters
    ----------
    experiment
        The rig as far as it is known, as in `load`; its limits are kept.
    tell
        Called with a line about what happens next.
    ask
        Called with what a person has to do; returns when it is done. Needed for a mass on a real rig.
    **options
        `changes` are other keys of the experiment, by dotted name; `rate_hz` is that of the loop while it moves (None:
        the experiment's, or in real time what the measured link carries); with `cogging`, `mass_kg` and `arm_m` are a
        mass to hang on the rig for the sweeps once more, and its lever arm.

    Returns
    -------
    Identification
        The fits with their 95 % intervals, the recordings, and ``experiment`` with the identified values;
        `format_identification` is its file.

    Raises
    ------
    ConfigError, PlanError
        Something that cannot or must not run: nothing has moved.
    IdentificationError
        Wrong signs, or data that show nothing; the message says why.
    RigError
        Cause of a trial's early end; the effort is zero.
    """
    request = IdentifyRequest(experiment=load(experiment), **options)
    return identifying.identify(request, tell, ask)


def _schemes(schemes: Sequence[str | Scheme]) -> tuple[Scheme, ...]:
    return tuple(Scheme.parse(one) if isinstance(one, str) else one for one in schemes)
