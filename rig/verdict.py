"""The verdict of one hit: stable, limit cycle, unstable or invalid, with every number behind it.

It uses only what a rig records, so that a simulated and a real trial are judged by the same text; in
simulation the same function runs a second time on the truth. All signals are cut to the trial, uniformly
sampled; the tail is its last `tail_s`.

* **felt**: rms velocity between 30 and 500 Hz, from counts by a central difference and a zero-phase filter;
* **heard**: rms of the commanded effort above 30 Hz;
* **moved**: peak-to-peak position above 30 Hz, less one count.

*Invalid* is a trial that says nothing: no contact, a gap, too many late ticks, a binding slew limit,
a device that overruled the law, or
saturation without motion. *Unstable*: the wall was left in the tail, or the ripple grows, or the motor
saturates while a threshold is exceeded. *Limit cycle*: not unstable, but felt, heard or moved. *Stable*:
none of them.

A velocity from counts has a floor: one toggling count of size Δ at f Hz is a square wave whose fundamental
reads 2√2·f·Δ rms, and each of its odd harmonics in the band as much again. It is reported for the dominant
frequency of the tail, and when it exceeds the threshold *felt* is not measurable and does not vote.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.faults import LimitFlag
from firmware_protocol.messages import NO_COMMAND_YET
from rig.sample import Phase, RowFlag

# Limit flags of the device that mean another effort than the commanded one; nearing a limit changes none.
_OVERRULES = int(~(LimitFlag.SPEED | LimitFlag.POSITION))

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Kind(StrEnum):
    """How a hit ended."""

    STABLE = "stable"
    LIMIT_CYCLE = "limit cycle"
    UNSTABLE = "unstable"
    INVALID = "invalid"


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Thresholds in the units of the rig; `rig.config.verdict_limits` makes them from handle terms."""

    tail_s: float
    highpass_hz: float
    lowpass_hz: float
    felt_velocity: float  # rms (rad/s or m/s)
    heard_effort: float  # rms (N·m or N)
    moved: float  # peak-to-peak (rad or m)
    growth: float  # rms of the second half of the tail over the first
    late_fraction: float
    saturated_fraction: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Signals:
    """One trial, uniformly sampled: arrays of equal length, positions and efforts in the units of the rig.

    `velocity` is None when it has to be derived from `position`; `resolution` is the count behind
    `position`, 0 for truth.
    """

    tick_s: float
    resolution: float
    position: Floats
    velocity: Floats | None
    effort: Floats
    penetration: Floats
    saturated: Bools
    late: Bools
    gap: Bools
    slew_bound: Bools
    overruled: Bools  # the device limited, ramped or withheld what the law commanded


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Outcome and numbers of one hit. Lengths and efforts in the units of the rig; None: not measurable."""

    kind: Kind
    reasons: tuple[str, ...]
    felt: float | None  # rms velocity in the tail
    felt_floor: float  # what one toggling count reads at the tail's dominant frequency
    heard: float  # rms ripple of the effort in the tail
    moved: float  # peak-to-peak position in the tail, less one count
    growth: float  # ripple of the second half of the tail over the first; 0 without ripple
    exits_in_tail: int
    exits: int
    contact_s: float | None  # first contact after the start of the trial
    impact_velocity: float | None
    peak_penetration: float
    resting_penetration: float
    settling_s: float | None  # from first contact until penetration stays near its resting value
    peak_effort: float
    saturated_fraction: float
    saturated_fraction_in_tail: float
    late_ticks: int
    gaps: int
    ticks: int

    def as_mapping(self) -> dict[str, Any]:
        """Plain numbers and strings, for JSON."""
        return {**asdict(self), "kind": str(self.kind), "reasons": list(self.reasons)}


def recorded_signals(rows: NDArray[np.void], tick_s: float, resolution: float) -> Signals:
    """What a rig records of the trial phase of its rows (`rig.sample.ROW`)."""
    trial = rows[rows["phase"] == Phase.TRIAL]
    return Signals(
        position=trial["position"].copy(),
        velocity=None,
        effort=trial["effort_sent"].copy(),
        penetration=trial["penetration"].copy(),
        **_shared(trial, tick_s, abs(resolution)),
    )


def true_signals(rows: NDArray[np.void], tick_s: float, wall_position: float, wall_side: float) -> Signals:
    """What really happened in a simulated trial: rows that carry `rig.sample.TRUTH_COLUMNS` too."""
    trial = rows[rows["phase"] == Phase.TRIAL]
    return Signals(
        position=trial["position_true"].copy(),
        velocity=trial["velocity_true"].copy(),
        effort=trial["effort_true"].copy(),
        penetration=wall_side * (trial["position_true"] - wall_position),
        **_shared(trial, tick_s, 0.0),
    )


def _shared(trial: NDArray[np.void], tick_s: float, resolution: float) -> dict[str, Any]:
    def flagged(flag: RowFlag) -> Bools:
        return np.asarray((trial["flags"] & int(flag)) != 0)

    return {
        "tick_s": tick_s,
        "resolution": resolution,
        "saturated": flagged(RowFlag.SATURATED),
        "late": flagged(RowFlag.LATE),
        "gap": flagged(RowFlag.GAP),
        "slew_bound": flagged(RowFlag.SLEW_BOUND),
        "overruled": ((trial["limits"] & _OVERRULES) != 0) | (trial["command_age"] == NO_COMMAND_YET),
    }


def judge(signals: Signals, limits: Limits) -> Verdict:
    """Judge one trial (see the module's text).

    A trial shorter than its tail is judged on what there is; one without samples is invalid.
    """
    count = len(signals.position)
    if count < 8:
        return _nothing(count)
    tail = slice(max(0, count - round(limits.tail_s / signals.tick_s)), count)
    inside = signals.penetration > 0.0
    exits = inside[:-1] & ~inside[1:]
    ripple = _highpassed(signals.effort, signals.tick_s, limits.highpass_hz)[tail]
    swing = _highpassed(signals.position, signals.tick_s, limits.highpass_hz)[tail]
    velocity = (
        signals.velocity
        if signals.velocity is not None
        else _central_difference(signals.position, signals.tick_s)
    )
    band = _band_passed(velocity, signals.tick_s, limits.highpass_hz, limits.lowpass_hz)[tail]

    heard = _rms(ripple)
    moved = max(0.0, float(np.ptp(swing)) - signals.resolution)
    floor = _toggling_floor(swing, signals, limits) if np.ptp(signals.position[tail]) else 0.0
    felt = None if floor > limits.felt_velocity else _rms(band)
    growth = _growth(ripple)
    exits_in_tail = int(np.count_nonzero(exits[max(0, tail.start - 1) :]))
    saturated_in_tail = float(np.mean(signals.saturated[tail]))

    exceeded = [
        f"{name} {value:.3g} above {limit:.3g}"
        for name, value, limit in (
            ("felt", felt, limits.felt_velocity),
            ("heard", heard, limits.heard_effort),
            ("moved", moved, limits.moved),
        )
        if value is not None and value > limit
    ]
    contact = int(np.argmax(inside)) if inside.any() else None
    resting = float(np.median(signals.penetration[tail]))
    peak = float(signals.penetration.max())
    settling_s = _settling(signals, contact, tail, resting, peak)

    saturates = saturated_in_tail > limits.saturated_fraction
    invalid = _why_invalid(signals, limits, inside, tail, saturates and not exceeded)
    if contact is not None and settling_s is not None and (exits_in_tail or exceeded):
        settled = contact + round(settling_s / signals.tick_s)
        if settled > tail.start:
            invalid.append(
                f"still settling when the tail began, {(settled - tail.start) * signals.tick_s:.3g} s too early: "
                "lengthen the trial"
            )
    unstable = []
    if exits_in_tail:
        unstable.append(f"left the wall {_times(exits_in_tail, 'time')} in the tail")
    if growth > limits.growth and exceeded:
        unstable.append(f"ripple grows {growth:.3g}-fold over the tail")
    if saturates and exceeded:
        unstable.append(f"saturates in {100 * saturated_in_tail:.2g} % of the tail")
    if invalid:
        kind, reasons = Kind.INVALID, invalid
    elif unstable:
        kind, reasons = Kind.UNSTABLE, unstable + exceeded
    elif exceeded:
        kind, reasons = Kind.LIMIT_CYCLE, exceeded
    else:
        kind, reasons = Kind.STABLE, []

    return Verdict(
        kind=kind,
        reasons=tuple(reasons),
        felt=felt,
        felt_floor=floor,
        heard=heard,
        moved=moved,
        growth=growth,
        exits_in_tail=exits_in_tail,
        exits=int(np.count_nonzero(exits)),
        contact_s=None if contact is None else contact * signals.tick_s,
        impact_velocity=None if contact is None else _impact_velocity(signals, contact),
        peak_penetration=peak,
        resting_penetration=resting,
        settling_s=settling_s,
        peak_effort=float(np.abs(signals.effort).max()),
        saturated_fraction=float(np.mean(signals.saturated)),
        saturated_fraction_in_tail=saturated_in_tail,
        late_ticks=int(np.count_nonzero(signals.late)),
        gaps=int(np.count_nonzero(signals.gap)),
        ticks=count,
    )


def _times(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def overruled(verdict: Verdict, kind: Kind, reason: str) -> Verdict:
    """Return the same numbers with another outcome, for a reason that the signals do not show."""
    return replace(verdict, kind=kind, reasons=(reason, *verdict.reasons))


def _why_invalid(
    signals: Signals, limits: Limits, inside: Bools, tail: slice, idle_saturation: bool
) -> list[str]:
    reasons = []
    if not inside.any():
        reasons.append("the wall was never touched")
    elif not inside[tail].any():
        reasons.append("the wall was not touched in the tail")
    elif np.argmax(inside) > tail.start:
        reasons.append("the first contact lies in the tail")
    gaps, late = int(np.count_nonzero(signals.gap)), float(np.mean(signals.late))
    if gaps:
        reasons.append(f"{_times(gaps, 'gap')} in the samples: the link or this computer was late")
    if late >= limits.late_fraction:
        reasons.append(f"{100 * late:.2g} % late ticks: close other programs, or lower the rate")
    if signals.slew_bound.any():
        reasons.append(f"the slew limit bound in {_times(int(np.count_nonzero(signals.slew_bound)), 'tick')}")
    if signals.overruled.any():
        reasons.append(
            f"the device overruled the law in {_times(int(np.count_nonzero(signals.overruled)), 'tick')}"
        )
    if idle_saturation:
        reasons.append("saturated in the tail without ripple or motion")
    return reasons


def _nothing(count: int) -> Verdict:
    numbers: dict[str, Any] = dict.fromkeys(Verdict.__dataclass_fields__, 0.0)
    numbers.update(kind=Kind.INVALID, reasons=(f"only {count} ticks of trial",), felt=None, contact_s=None)
    numbers.update(impact_velocity=None, settling_s=None, ticks=count, exits=0, exits_in_tail=0)
    numbers.update(late_ticks=0, gaps=0)
    return Verdict(**numbers)


def _rms(signal: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(signal))))


def _growth(ripple: Floats) -> float:
    half = len(ripple) // 2
    first, second = _rms(ripple[:half]), _rms(ripple[half:])
    return second / first if first > 0.0 else 0.0


def _highpassed(signal: Floats, tick_s: float, corner_hz: float) -> Floats:
    """Two-pole high pass, started in steady state at the first sample (one pole would leak a slow press)."""
    from scipy.signal import butter, sosfilt, sosfilt_zi  # noqa: PLC0415

    sections = butter(2, corner_hz, "highpass", fs=1.0 / tick_s, output="sos")
    filtered, _ = sosfilt(sections, signal, zi=sosfilt_zi(sections) * signal[0])
    return np.asarray(filtered)


def _band_passed(signal: Floats, tick_s: float, low_hz: float, high_hz: float) -> Floats:
    """Zero-phase band pass; the upper corner is dropped where it would reach Nyquist."""
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415

    rate_hz = 1.0 / tick_s
    if high_hz < 0.45 * rate_hz:
        sections = butter(2, [low_hz, high_hz], "bandpass", fs=rate_hz, output="sos")
    else:
        sections = butter(2, low_hz, "highpass", fs=rate_hz, output="sos")
    return np.asarray(
        sosfiltfilt(sections, signal, padlen=min(len(signal) - 1, round(3.0 * rate_hz / low_hz)))
    )


def _central_difference(position: Floats, tick_s: float) -> Floats:
    return np.gradient(position, tick_s)


def _toggling_floor(swing: Floats, signals: Signals, limits: Limits) -> float:
    """Velocity rms that one toggling count reads at the dominant frequency of the tail's motion.

    A square wave of height Δ at f Hz has odd harmonics whose velocities all have the rms 2√2·f·Δ; those in
    the band add up in power.
    """
    spectrum = np.abs(np.fft.rfft(swing * np.hanning(len(swing))))
    dominant_hz = max(1, int(np.argmax(spectrum))) / (len(swing) * signals.tick_s)
    harmonics_hz = dominant_hz * np.arange(1.0, limits.lowpass_hz / dominant_hz + 1.0, 2.0)
    in_band = (harmonics_hz >= limits.highpass_hz) & (harmonics_hz <= limits.lowpass_hz)
    return 2.0 * math.sqrt(2.0 * max(1, int(in_band.sum()))) * dominant_hz * signals.resolution


def _impact_velocity(signals: Signals, contact: int) -> float | None:
    """Velocity at contact (rad/s or m/s): the truth, or the end of a parabola through the last 10 ms of counts.

    A straight line would read the velocity of 5 ms earlier, which a push has raised by a fifth since.
    """
    if signals.velocity is not None:
        return float(signals.velocity[contact])
    first = max(0, contact - max(4, round(0.010 / signals.tick_s)))
    if contact - first < 4:
        return None
    time_s = (np.arange(first, contact + 1) - contact) * signals.tick_s
    return float(np.polynomial.polynomial.polyfit(time_s, signals.position[first : contact + 1], 2)[1])


def _settling(
    signals: Signals, contact: int | None, tail: slice, resting: float, peak: float
) -> float | None:
    """Time from contact until the penetration stays within 5 % of its peak (at least 2 counts) of its resting value.

    None when it still leaves that band in the second half of the tail.
    """
    if contact is None:
        return None
    band = max(2.0 * signals.resolution, 0.05 * peak)
    off = np.flatnonzero(np.abs(signals.penetration[contact:] - resting) > band)
    settled = contact + (int(off[-1]) + 1 if len(off) else 0)
    if settled > (tail.start + tail.stop) // 2:
        return None
    return (settled - contact) * signals.tick_s
