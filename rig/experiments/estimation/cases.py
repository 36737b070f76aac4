"""Define test cases of velocity estimators: a count for each velocity sample, and the true velocity.

Comparison, tuning and export of estimators use this module. A case comes from a reference signal
(`rig.experiments.estimation._signals`) with an ideal encoder, from a simulated recording with its true velocity, or
from a real recording with a reference from a filter that uses future samples.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.config import settings_of_rig
from rig.config.controller import resolution as signed
from rig.control.estimators import Floats, Ints, checked_efforts, inputs, own_inputs, quantise, real_numbers
from rig.core.deferred import signal
from rig.core.errors import ConfigError
from rig.core.present import reported
from rig.core.sample import Motion, Phase
from rig.experiments.estimation._signals import Signal, edge_times
from rig.experiments.trials.judgement import experiment_of
from rig.recording.data import Recording
from rig.recording.origin import counts_facts

EARLIEST_S, LATEST_S, DELAY_STEP_S = -5e-3, 50e-3, 2.5e-4  # grid of tested delays
DELAY_SAMPLES = 8192  # number of samples that are enough to find a delay
REFERENCE_HZ = 200.0  # cut-off of the zero-phase reference of a real recording
REFERENCE_END_S = 5.0 / REFERENCE_HZ
FEWEST_SAMPLES = 16  # smallest number of samples for the filter of the reference


@dataclass(frozen=True)
class Case:
    """A test case of velocity estimators: a count for each velocity sample, and the true velocity.

    Attributes
    ----------
    name
        Name of the signal or recording.
    motion
        Rotary or linear, which determines the units.
    dt
        Velocity period (s).
    resolution
        Travel for one count (rad or m), signed.
    time_s
        Time of each sample (s), shape (n,).
    counts, edge_time, elapsed
        Encoder count, time of the last encoder edge (s), and velocity periods (times between two velocity samples)
        since the sample before, each of shape (n,).
    judged
        True for the samples from which the score is computed, shape (n,).
    truth
        Function that returns the true velocity (rad/s or m/s) at given times (s).
    reference
        Text on the source of the true velocity.
    effort
        Mean effort of the motor since the sample before (N·m or N), shape (n,); None if unknown.
    rig
        Settings that an estimator reads from the rig, for example ``inertia``.
    """

    name: str
    motion: Motion
    dt: float
    resolution: float
    time_s: Floats = field(repr=False)
    counts: Ints = field(repr=False)
    edge_time: Floats = field(repr=False)
    elapsed: Ints = field(repr=False)
    judged: NDArray[np.bool_] = field(repr=False)
    truth: Callable[[Floats], Floats] = field(repr=False)
    reference: str
    effort: Floats | None = field(default=None, repr=False)
    rig: Mapping[str, float] = field(default_factory=dict, repr=False)

    @reported
    def rate_hz(self) -> float:
        """Return the number of velocity samples per second (Hz)."""
        return round(1.0 / self.dt, 6)

    @cached_property
    def judged_time_s(self) -> Floats:
        """Return the times of the samples from which an estimator's score is computed (s)."""
        return self.time_s[self.judged]

    @cached_property
    def true_velocity(self) -> Floats:
        """Return the true velocity at the samples from which the score is computed (rad/s or m/s)."""
        return self.truth(self.judged_time_s)

    @reported
    def speed_rms(self) -> float:
        """Return the rms of the true velocity over the samples from which the score is computed (rad/s or m/s)."""
        return float(np.sqrt(np.mean(np.square(self.true_velocity))))

    @cached_property
    def arrays(self) -> tuple[Ints, Floats, Ints]:
        """Return counts, ages of the last encoder edge (s) and velocity periods since the sample before, shape (n,)."""
        return inputs(self.counts, self.dt, self.edge_time, self.elapsed)

    @cached_property
    def delayed_truths(self) -> tuple[slice, Floats, Floats, Floats]:
        """Return data to fit a delay: slice of samples, delays (s), true velocity at each delay, its sum of squares."""
        chosen = slice(None, None, max(1, len(self.judged_time_s) // DELAY_SAMPLES))
        delays = np.arange(EARLIEST_S, LATEST_S + DELAY_STEP_S, DELAY_STEP_S)
        time_s = self.judged_time_s[chosen]
        # Row by row: all delays at once would take ten times the memory.
        truths = np.array([self.truth(time_s - each) for each in delays])
        return chosen, delays, truths, np.sum(np.square(truths), axis=1)


def signal_case(signal: Signal, rate_hz: float, resolution: float, *, offset: float = 0.5) -> Case:
    """Return counts and true velocity of a reference motion, sampled by an ideal encoder with exact edge times.

    Parameters
    ----------
    signal
        Signal of `rig.experiments.estimation._signals`.
    rate_hz
        Velocity samples per second (Hz).
    resolution
        Travel for one count (m).
    offset
        Distance of position zero from the lower edge of its encoder cell (counts, 0 to below 1).
    """
    dt = 1.0 / rate_hz
    time_s = dt * np.arange(round(signal.end_s * rate_hz), dtype=np.float64)
    return Case(
        name=signal.name,
        motion="linear",
        dt=dt,
        resolution=resolution,
        time_s=time_s,
        counts=quantise(signal(time_s).position, resolution, offset=offset),
        edge_time=edge_times(signal, time_s, resolution, offset=offset),
        elapsed=np.ones(len(time_s), np.int64),
        judged=time_s >= signal.start_s,
        truth=lambda t: signal(t).velocity,
        reference="closed form",
    )


def counts_case(
    counts: ArrayLike,
    dt: float,
    *,
    resolution: float,
    velocity: ArrayLike,
    edge_time: ArrayLike | None = None,
    elapsed: ArrayLike | None = None,
    width: int | None = None,
    effort: ArrayLike | None = None,
    settle_s: float = 0.0,
    motion: Motion = "rotary",
    name: str = "counts",
) -> Case:
    """Return a test case from your own counts and velocities, on which to compare and tune estimators.

    Parameters
    ----------
    counts, dt, resolution
        Encoder counts, shape (n,), one for each velocity period (time between two velocity samples) of `dt` (s), and
        the travel for one count (rad or m).
    edge_time, elapsed, width
        Time of the last encoder edge (s) and velocity periods since the sample before, (n,); bits of the counter.
    velocity
        True velocity at each sample (rad/s or m/s), shape (n,), from a simulation or a better sensor; between samples
        it is interpolated linearly.
    effort
        Effort of the motor at each sample (N·m or N), shape (n,), for estimators that use it.
    settle_s
        Time after the first sample that is not judged, because estimators settle (s).
    motion
        ``"rotary"`` (rad) or ``"linear"`` (m), for the units in tables.
    name
        Name in tables.

    Raises
    ------
    ConfigError
        An array has a wrong shape or value, the velocities are not finite, or `settle_s` covers all samples.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = np.arange(2000) / 1000
    >>> counts = np.floor(np.sin(time_s) / 1e-3)
    >>> case = counts_case(counts, 1e-3, resolution=1e-3, velocity=np.cos(time_s))
    >>> round(case.speed_rms, 2)
    0.64
    """
    held, age_s, steps = own_inputs(
        counts, dt, resolution=resolution, edge_time=edge_time, elapsed=elapsed, width=width
    )
    time_s = dt * (np.cumsum(steps) - steps[:1].sum())
    true = real_numbers(velocity, "velocity", "rad/s or m/s")
    if true.shape != held.shape or not np.isfinite(true).all():
        raise ConfigError(
            f"{len(held)} counts, but the true velocities have shape {true.shape}, "
            f"{int(np.isfinite(true).sum())} of them finite",
            remedy="give one finite velocity for each count",
        )
    judged = time_s >= settle_s
    if not judged.any():
        raise ConfigError(
            f"{len(held)} samples last {len(held) * dt:g} s, not longer than the settling time of "
            f"{settle_s:g} s",
            remedy="give more samples, or a shorter settle_s",
        )
    return Case(
        name=name,
        motion=motion,
        dt=dt,
        resolution=resolution,
        time_s=time_s,
        counts=held,
        edge_time=time_s - age_s,
        elapsed=steps,
        judged=judged,
        truth=lambda t: np.interp(t, time_s, true),
        reference="given velocity",
        effort=None if effort is None else checked_efforts(effort, len(held)),
    )


def recording_case(recording: Recording, rate_hz: float | None = None, *, name: str = "recording") -> Case:
    """Return counts and true velocity of a recording; on a real rig the latter is a filtered reference.

    Parameters
    ----------
    recording
        Recording of any rig; its trial is judged, after the homing in which the estimators settle.
    rate_hz
        Velocity samples per second (Hz), which must divide the recording's position rate. None: the recording's own
        rate.
    name
        Name in tables.

    Raises
    ------
    ConfigError
        The rate does not divide the position rate, or the recording is too short.

    Notes
    -----
    The true velocity of a real rig is unknown. Its reference is the derivative of the position after a Butterworth
    filter of order 4 at 200 Hz, run forwards and backwards. The reference has no delay, but lacks higher frequencies:
    use errors relative to it only to compare estimators.
    """
    resolution: float
    position_rate: float
    motion: Motion
    experiment = None
    if (facts := counts_facts(recording)) is not None:
        resolution, position_rate = facts["resolution"], facts["rate_hz"]
        rate, motion = rate_hz or position_rate, recording.header["motion"]
    else:
        experiment = experiment_of(recording)
        resolution, position_rate = signed(experiment), experiment.controller.position_rate
        rate, motion = rate_hz or experiment.controller.velocity_rate, experiment.rig.motion
    divider = round(position_rate / rate)
    if divider < 1 or abs(divider * rate - position_rate) > 1e-6 * position_rate:
        raise ConfigError(
            f"{rate:g} Hz is not a whole fraction of the recording's {position_rate:g} Hz",
            remedy=f"choose {position_rate / max(1, divider):g} Hz",
        )
    if len(recording) < FEWEST_SAMPLES:
        raise ConfigError(
            f"the recording has {len(recording)} samples; at least {FEWEST_SAMPLES} are needed",
            remedy="choose a longer recording",
        )
    index = recording.column("sample_index") - recording.column("sample_index")[0]
    period = index // divider
    first = np.flatnonzero(np.diff(period, prepend=-1) > 0)  # the samples that enter a new velocity period
    elapsed = np.diff(period[first], prepend=period[first[0]] - 1)
    dt, time_s = divider / position_rate, index / position_rate
    truth, reference = _truth(recording, time_s, resolution)
    trial = recording.column("phase") == Phase.TRIAL
    judged = trial if trial.any() else np.ones_like(trial)
    if not recording.has_truth:  # the zero-phase filter is inaccurate at both ends
        judged = judged & (time_s >= time_s[0] + REFERENCE_END_S) & (time_s <= time_s[-1] - REFERENCE_END_S)
    if not judged.any():
        raise ConfigError(
            f"the recording lasts {time_s[-1]:.3g} s; {REFERENCE_END_S:g} s at each end are not judged, so no sample "
            "remains",
            remedy="choose a longer recording",
        )
    return Case(
        name=name,
        motion=motion,
        dt=dt,
        resolution=resolution,
        time_s=time_s[first],
        counts=recording.column("count")[first],
        edge_time=dt * (period[first] - period[first[0]]) - 1e-9 * recording.column("edge_age")[first],
        elapsed=elapsed,
        judged=judged[first],
        truth=truth,
        reference=reference,
        effort=None if experiment is None else _mean_efforts(recording, index, first),
        rig={} if experiment is None else settings_of_rig(experiment),
    )


def _mean_efforts(recording: Recording, index: Ints, first: NDArray[np.intp]) -> Floats:
    """Return the mean effort on the rig since the sample before, for each index in `first` (N·m or N)."""
    impulse = np.cumsum(recording.column("effort_applied") * np.diff(index, prepend=index[0] - 1))[first]
    ticks = index[first] + 1
    return np.asarray(np.diff(impulse, prepend=0.0) / np.diff(ticks, prepend=0))


def _truth(recording: Recording, time_s: Floats, resolution: float) -> tuple[Callable[[Floats], Floats], str]:
    """Return the true velocity (rad/s or m/s) as a function of time (s), and a text on its source."""
    if recording.has_truth:
        true = recording.column("velocity_true")
        known = np.isfinite(true)
        return lambda t: np.interp(t, time_s[known], true[known]), "the simulation's truth"
    tick_s = np.min(np.diff(time_s))
    grid = np.arange(time_s[0], time_s[-1] + 0.5 * tick_s, tick_s)
    position = np.interp(grid, time_s, resolution * np.unwrap(recording.column("count"), period=2**32))
    cutoff_hz = min(REFERENCE_HZ, 0.2 / tick_s)
    # Both ways (zero phase): a reference may look into the future, an estimator may not.
    smooth = np.gradient(
        signal.sosfiltfilt(signal.butter(4, cutoff_hz, fs=1.0 / tick_s, output="sos"), position), tick_s
    )
    return lambda t: np.interp(t, grid, smooth), f"zero-phase Butterworth of order 4 at {cutoff_hz:g} Hz"
