"""Record the signals from which an impedance is estimated: whole periods of a rig that is excited about its wall.

Identification, measured impedances, their maps and papers call this module. A record
(`rig.analysis.impedance._signals.ExcitedRun`) comes from a simulation without the byte link (`ExcitedRig`: excited by a
second actuator or the rig's motor), or from a recording (`record_of`: excited by the rig's motor). This module opens no
device, and must not fit an impedance (`rig.analysis.impedance`).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rig import config, devices
from rig.analysis.impedance import Complexes, ExcitedRun, Floats, hold
from rig.config import Experiment, controller, rig_model
from rig.control import bilateral, laws
from rig.control.excitation import Multisine
from rig.control.excitation_table import ExcitationTable, Phases
from rig.control.laws import Law
from rig.core.errors import RecordingError
from rig.core.exponential import expm
from rig.core.model import RigModel, state_space
from rig.core.sample import Phase, RowFlag
from rig.recording.data import Recording

ACQUISITION_HZ = 4000.0  # Chawda et al., section VI: velocity and force at 4 kHz
# The amplitude rises in this fraction of the settling time; in the rest of it transients decay.
SETTLING_SHARE = 0.5
LONGEST_DELAY = 20  # largest delay from a command to its effort that is searched (ticks)

_BOUND = int(RowFlag.SATURATED | RowFlag.SLEW_BOUND)

Signal = Literal["count", "truth"]


@dataclass(frozen=True, slots=True, eq=False)
class RealisationRun:
    """A run of one realisation of the excitation (one draw of its random phases).

    Attributes
    ----------
    record
        Signals of whole periods of the excitation; None if the safety guard (limits of motion) ended the run early.
    ended
        Reason for the early end in a few words; empty for a complete run.
    ended_s
        Time of the early end since the beginning of the run (s).
    saturated
        Fraction of ticks in which the guard clipped the effort (0 to 1).
    """

    record: ExcitedRun | None
    ended: str = ""
    ended_s: float = 0.0
    saturated: float = 0.0


def multisine_of(experiment: Experiment, realisation: int = 0) -> Multisine:
    """Return the excitation by the experiment's ``[excitation]``; each `realisation` number has its own phases.

    If the device generates the excitation, the multisine has the device's phases.
    """
    if _made_by_the_device(experiment):
        quantum = experiment.rig.amplifier.effort_quantum
        return device_table(experiment, realisation).multisine(experiment.controller.position_rate, quantum)
    return _own_multisine(experiment, realisation)


def _made_by_the_device(experiment: Experiment) -> bool:
    return experiment.controller.loop == "device" and experiment.excitation.channel == "motor"


def _own_multisine(experiment: Experiment, realisation: int) -> Multisine:
    given = experiment.excitation
    band, size = (given.low_hz, given.high_hz), config.excitation_size(experiment)
    if given.kind == "schroeder":
        return Multisine.schroeder(band, given.period_s, **size)
    return Multisine.random(band, given.period_s, seed=(given.seed, realisation), **size)


def ramp_s(experiment: Experiment) -> float:
    """Return the time in which the amplitude of the excitation rises at the beginning of a run (s)."""
    return SETTLING_SHARE * config.excitation_s(experiment)[1]


def device_table(
    experiment: Experiment, realisation: int = 0, current_quantum_a: float | None = None
) -> ExcitationTable:
    """Return the frequencies and phases from which a device generates a realisation of the excitation.

    Frequencies and amplitude come from ``[excitation]``; each realisation has its own phases. `current_quantum_a` is
    the step of current that the device can set (A); None: the experiment's. Raise `ConfigError` for an excitation that
    a device cannot generate.
    """
    given, amplifier = experiment.excitation, experiment.rig.amplifier
    quantum = amplifier.current_quantum_a if current_quantum_a is None else current_quantum_a
    size = config.excitation_size(experiment)
    return _device_table(
        given,
        realisation,
        size.get("rms"),
        size.get("peak"),
        experiment.controller.position_rate,
        amplifier.effort_per_ampere * quantum,
        round(ramp_s(experiment) * experiment.controller.position_rate),
    )


# Cached: a table takes a tenth of a second to compute, and plan, law and record each need it.
@lru_cache(maxsize=64)
def _device_table(
    given: config.Excitation,
    realisation: int,
    rms: float | None,
    peak: float | None,
    rate: int,
    effort_quantum: float,
    ramp: int,
) -> ExcitationTable:
    seed = int(np.random.SeedSequence((given.seed, realisation)).generate_state(1)[0])
    phases: Phases = "schroeder" if given.kind == "schroeder" else "hashed"

    def table(wanted: float) -> ExcitationTable:
        flat = Multisine.schroeder((given.low_hz, given.high_hz), given.period_s, rms=wanted)
        return ExcitationTable.of(flat, rate, effort_quantum, ramp=ramp, phases=phases, seed=seed)

    if peak is None:
        assert rms is not None
        return table(rms)
    # The crest factor depends on the phases only, not on the amplitude of this first table.
    first = table(peak / 4.0)
    return table(peak / first.multisine(rate, effort_quantum).crest_factor)


def excited_law(experiment: Experiment, realisation: int = 0, current_quantum_a: float | None = None) -> Law:
    """Return a control law: a bilateral wall, plus one realisation of the excitation as effort of the motor.

    If the device generates the excitation, the law uses the device's table, so that host and device compute equal
    efforts to the last bit; `current_quantum_a` is the step of current that the device can set (A).
    """
    if _made_by_the_device(experiment):
        quantum = (
            experiment.rig.amplifier.current_quantum_a if current_quantum_a is None else current_quantum_a
        )
        table = device_table(experiment, realisation, current_quantum_a)
        return bilateral.excited_law(
            table.efforts(controller.effort_quantum(experiment, quantum)), table.ramp, table.parameters()
        )
    rate = experiment.controller.position_rate
    efforts = multisine_of(experiment, realisation).period(rate)
    return bilateral.excited_law(efforts, round(ramp_s(experiment) * rate))


class ExcitedRig:
    """A simulated rig with one sampling scheme that is excited about any wall, without the byte link.

    Use one object per thread.

    Parameters
    ----------
    experiment
        Rig, controller, excitation and wall; the wall's stiffness and damping are ignored.
    signal
        Position signal for the impedance: encoder counts ("count"), or the true position of the handle ("truth"). A
        second actuator pushes at the handle: on a rig of two masses only the true position then gives an impedance
        whose phase shows passivity.
    acquisition_hz
        Lowest rate at which positions are stored (Hz).

    Attributes
    ----------
    experiment
        The given experiment, changed to an excited run.
    """

    def __init__(
        self,
        experiment: Experiment,
        *,
        signal: Signal = "count",
        acquisition_hz: float = ACQUISITION_HZ,
    ) -> None:
        self.experiment = config.excited(experiment)
        self._signal = signal
        self._model = config.rig_model(self.experiment)
        rate = self.experiment.controller.position_rate
        self._ticks = round(self.experiment.trial.duration_s * rate)
        self._template = controller.for_experiment(
            self.experiment,
            current_quantum_a=self._model.amplifier.current_quantum_a,
            law=laws.get("bilateral"),
        )
        self._excited_plant = devices.excited_simulation()(
            self._model, 1.0 / rate, acquisition_hz, self._ticks
        )
        self._excitations: dict[int, _Excitation] = {}

    def excite(self, stiffness: float, damping: float, realisation: int = 0) -> RealisationRun:
        """Excite the simulated rig at a wall, and return the signals of the run.

        The wall has the given stiffness (N·m/rad or N/m) and damping (N·m·s/rad or N·s/m); `realisation` selects the
        phases.

        Raises
        ------
        LawError
            The estimator or the law returned a value that is not finite.
        """
        experiment, prepared = self.experiment, self._excitation(realisation)
        wall = asdict(replace(experiment.wall, stiffness=stiffness, damping=damping))
        fresh = self._template.fresh(wall)
        if prepared.law is not None:
            fresh = replace(fresh, law=prepared.law.prepare(wall))
        ramp, middle = ramp_s(experiment), experiment.wall.position
        motion = self._excited_plant.excite(fresh, middle, prepared.external, ramp, self._ticks)
        saturated = motion.saturated / max(1, motion.ticks)
        tick_s = 1.0 / experiment.controller.position_rate
        if motion.ticks < self._ticks:
            memory = fresh.memory[0]
            reason = _explain_trip(experiment, float(memory["position"]), float(memory["velocity"]))
            return RealisationRun(None, reason, motion.ticks * tick_s, saturated)
        each = round(tick_s / motion.acquisition_s)  # stored positions per tick
        first = round(config.excitation_s(experiment)[1] / tick_s)
        position: Floats = motion.position
        if self._signal == "count":
            position = np.asarray(controller.resolution(experiment) * motion.counts, dtype=np.float64)
        excitation = np.tile(prepared.multisine.period(each / tick_s), experiment.excitation.periods)
        effort, delay_s, hold_s = excitation, 0.0, 0.0
        if experiment.excitation.channel == "motor":
            table = np.tile(prepared.multisine.period(1.0 / tick_s), experiment.excitation.periods)
            effort = _apply_lag(np.repeat(table + motion.withheld[first:], each), self._model, each / tick_s)
            delay_s, hold_s = _delay_s(experiment), motion.acquisition_s
        record = ExcitedRun(
            rate_hz=each / tick_s,
            period_samples=len(excitation) // experiment.excitation.periods,
            periods=experiment.excitation.periods,
            excitation=excitation,
            effort=effort,
            position=position[first * each :],
            lines_hz=prepared.multisine.lines_hz,
            effort_delay_s=-delay_s,
            effort_hold_s=hold_s,
        )
        return RealisationRun(record, saturated=saturated)

    def _excitation(self, realisation: int) -> _Excitation:
        if realisation not in self._excitations:
            self._excitations[realisation] = _Excitation.of(
                self.experiment, realisation, self._excited_plant.inner_rate_hz
            )
        return self._excitations[realisation]


@dataclass(frozen=True, slots=True, eq=False)
class _Excitation:
    """One realisation of the excitation (draw of its random phases), as signals for the simulation."""

    multisine: Multisine
    external: Floats  # effort of the second actuator in each step of the simulation (N·m or N)
    law: Law | None  # law that adds the excitation if the rig's motor excites it; else None

    @classmethod
    def of(cls, experiment: Experiment, realisation: int, inner_rate_hz: float) -> _Excitation:
        multisine = multisine_of(experiment, realisation)
        if experiment.excitation.channel == "motor":
            return cls(multisine, np.zeros(1), excited_law(experiment, realisation))
        # A sample-and-hold attenuates each frequency by sinc: amplify, so that the amplitude is as requested.
        larger = multisine.through(1.0 / np.sinc(multisine.lines_hz / inner_rate_hz))
        return cls(multisine, larger.period(inner_rate_hz, offset=0.5), None)


def record_of(recording: Recording, experiment: Experiment) -> ExcitedRun:
    """Return effort and position in whole periods from a recorded trial whose motor excited the rig.

    Raises
    ------
    RecordingError
        The recorded trial is not excited, ended early, or lost samples during the excitation.
    """
    saved = recording.header["initial_state"]["law"]
    if experiment.trial.kind != "excitation" or saved["name"] != "excited":
        raise RecordingError(
            f"the recording is of kind {experiment.trial.kind} with the law {saved['name']}, and contains no "
            "excitation",
            remedy="record an excited trial with rig impedance measure --url",
        )
    rows = recording.rows[recording.rows["phase"] == Phase.TRIAL]
    tick_s = 1.0 / experiment.controller.position_rate
    first, ticks = (round(s / tick_s) for s in reversed(config.excitation_s(experiment)))
    lost = int(rows["elapsed_ticks"].sum()) - len(rows) if len(rows) else 0
    if len(rows) < ticks or lost:
        raise RecordingError(
            f"the excited run has {len(rows)} of {ticks} samples ({lost} were lost), so its periods "
            "are incomplete",
            remedy="measure this realisation again; if the host is busy, choose a rate of "
            f"{experiment.controller.position_rate // 2} Hz",
        )
    rows = rows[:ticks]
    parameters = np.array(saved["parameters"], dtype=np.float64)
    excitation = bilateral.played(parameters, experiment.wall.side, tick_s, ticks)
    # Z = F/V with the external effort F on the handle. Here the rig's motor renders the wall and excites the rig at the
    # same time, so that F is the part of its effort besides the wall's reaction: the excitation, plus the change by the
    # guard's rounding and clipping. F acts later by the hold, the delay and the amplifier's lag.
    effort = excitation + rows["effort_sent"] - rows["effort_wanted"]
    model = config.rig_model(experiment)
    lines = multisine_of(experiment).lines_hz
    late = late_ticks(rows["current_sent"], rows["current_applied"])
    return ExcitedRun(
        rate_hz=1.0 / tick_s,
        period_samples=round(experiment.excitation.period_s / tick_s),
        periods=experiment.excitation.periods,
        excitation=excitation[first:],
        effort=_apply_lag(effort[first:], model, 1.0 / tick_s),
        # Samples at the loop's rate underestimate the motion between them, for a free mass at 250 Hz and 1 kHz by 3 %.
        # The ratio depends on the rig only, not on the wall (`seen_at_ticks`), so that it can be corrected.
        position=_correct_for_sampling(rows["position"][first:], model, tick_s, float(lines[-1])),
        lines_hz=lines,
        effort_delay_s=-(_delay_s(experiment) + late * tick_s),
        effort_hold_s=tick_s,
    )


def bound_share(recording: Recording) -> float:
    """Return the fraction of a trial's ticks in which the effort or its slew rate was clipped (0 to 1)."""
    flags = recording.rows["flags"][recording.rows["phase"] == Phase.TRIAL]
    return float(np.mean((flags & _BOUND) != 0)) if len(flags) else 0.0


def late_ticks(sent: NDArray[np.int64], applied: NDArray[np.int64]) -> int:
    """Return the most likely delay of commands (ticks), from the sent and the applied current of each tick (quanta).

    The delay is 0 if the command computed from sample k is active at sample k + 1.
    """
    count = min(LONGEST_DELAY, len(sent) - 2)
    same = [np.mean(sent[: len(sent) - 1 - d] == applied[1 + d :]) for d in range(max(1, count))]
    return int(np.argmax(same))


def seen_at_ticks(model: RigModel, tick_s: float, frequency_hz: Floats) -> Complexes:
    """Return at each frequency (Hz) the ratio (complex) of sampled to true motion of a rig under a held effort."""
    space = state_space(model.mechanics, model.amplifier)
    a, b, n = space.a, space.b[:, :1], space.order
    both = expm(np.block([[a, b], [np.zeros((1, n + 1))]]) * tick_s)
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    # Samples show the sum of all aliases of the response. A wall changes sum and response in the same way, so that
    # their ratio does not depend on the wall; it is 1 at low frequencies.
    sampled = _frequency_response(both[:n, :n], both[:n, n:], np.exp(s * tick_s), space.sensed_position)
    true = _frequency_response(a, b, s, space.sensed_position) * hold(frequency_hz, tick_s)
    return np.asarray(sampled / true)


def _frequency_response(a: Floats, b: Floats, at: NDArray[Any], place: int) -> Complexes:
    resolvent = at[:, None, None] * np.eye(len(a)) - a
    return np.asarray(np.linalg.solve(resolvent, np.broadcast_to(b, (len(at), *b.shape)))[:, place, 0])


def _correct_for_sampling(position: Floats, model: RigModel, tick_s: float, highest_hz: float) -> Floats:
    """Return positions (rad or m, whole periods) corrected for the motion between samples, up to `highest_hz` (Hz)."""
    spectrum = np.fft.rfft(position)
    frequency = np.asarray(np.fft.rfftfreq(len(position), tick_s), dtype=np.float64)
    inside = (frequency > 0.0) & (frequency <= highest_hz * (1.0 + 1e-9))
    spectrum[inside] /= seen_at_ticks(model, tick_s, frequency[inside])
    return np.fft.irfft(spectrum, len(position))


def _apply_lag(effort: Floats, model: RigModel, rate_hz: float) -> Floats:
    """Return the effort (N·m or N) after the amplifier's electrical lag; the signal must span whole periods."""
    lag_s = model.amplifier.lag_s
    if lag_s == 0.0:
        return np.asarray(effort)
    s = 2j * np.pi * np.fft.rfftfreq(len(effort), 1.0 / rate_hz)
    return np.fft.irfft(np.fft.rfft(effort) / (1.0 + s * lag_s), len(effort))


def _delay_s(experiment: Experiment) -> float:
    tick_s = 1.0 / experiment.controller.position_rate
    return rig_model(experiment).delay_ticks(tick_s) * tick_s


def _explain_trip(experiment: Experiment, position: float, velocity: float) -> str:
    limits = experiment.rig.limits
    if abs(velocity) > limits.speed:
        return f"estimated speed {abs(velocity):.3g} above the limit {limits.speed:g}"
    return f"position {position:.3g} outside the window {limits.position_minimum:g} … {limits.position_maximum:g}"
