"""The verdict of one hit: stable, limit cycle, unstable or invalid, with every number behind it.

Here is what the numbers mean; `rig.control.judging` takes them from the signals of a trial. They are of its tail, the
last `tail_s`:

* **felt**: rms velocity between 30 and 500 Hz, from counts by a central difference and a zero-phase filter;
* **heard**: rms of the commanded effort above 30 Hz;
* **moved**: peak-to-peak position above 30 Hz, less one count.

A rig records the side of its encoder; of the truth, felt and moved are those of the handle, which a hand holds.

*Invalid* is a trial that says nothing: no contact, contact in the baseline, a gap, too many late ticks, a binding slew
limit, a device that overruled the law, or saturation without motion. *Unstable*: the wall was left in the tail, or the
ripple grows, or the motor saturates while a threshold is exceeded. *Limit cycle*: not unstable, but felt, heard or
moved. *Stable*: none of them.

A person may leave the wall too early, by themselves. What tells that from a wall that throws them out is what came
before, and what follows: a wall that throws beats or rings first, and a hand that pushes comes back. So where a person
hits, a tail in which the wall was left once and not touched again is invalid if the stay before lasted a period of the
high pass (a bounce is shorter) and was neither heard nor moved above the thresholds in the tail until such a period
before its end. Whatever bounces, or buzzed before it left, stays unstable; so does a hand that comes back: stay out.

A velocity from counts has a floor: one toggling count of size Δ at f Hz is a square wave whose fundamental
reads 2√2·f·Δ rms, and each of its odd harmonics in the band as much again. It is reported for the frequency at which
the count toggles in the tail (`rig.control.measure`), and when it exceeds the threshold *felt* is not measurable and
does not vote.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from enum import IntFlag, StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Numbers = NDArray[np.void] | np.void

_WORDS = ("kind", "reasons")
_MAY_BE_NONE = ("felt", "contact_s", "impact_velocity", "settling_s")


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
    baseline_s: float = 0.0  # at the start of the trial, in which the wall must not be touched
    may_leave: bool = False  # a person hits, whose hand may leave the wall by itself


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Outcome and numbers of one hit. Lengths and efforts in the units of the rig; None: not measurable."""

    kind: Kind
    reasons: tuple[str, ...]
    felt: float | None  # rms velocity in the tail
    felt_floor: float  # what one count reads that toggles as often as this one in the tail
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


class Finding(IntFlag):
    """What speaks against a trial, in the order in which it is told."""

    TOO_SHORT = 1
    NEVER_TOUCHED = 2
    GONE = 4  # it touched the wall and has left it for the whole tail
    TOUCHED_LATE = 8
    GAPS = 16
    LATE = 32
    SLEW_BOUND = 64
    OVERRULED = 128
    IDLE_SATURATION = 256  # saturated in the tail with no threshold exceeded
    STILL_SETTLING = 512
    EXITS = 1024
    GROWS = 2048
    SATURATES = 4096  # in the tail, with a threshold exceeded
    FELT = 8192
    HEARD = 16384
    MOVED = 32768
    TOUCHED_EARLY = 65536  # in the baseline
    LEFT = 131072  # a person's hand left the calm wall in the tail, and stayed away


EXCEEDED = Finding.FELT | Finding.HEARD | Finding.MOVED
UNSTABLE = Finding.EXITS | Finding.GROWS | Finding.SATURATES
INVALID = Finding(Finding.EXITS - 1) | Finding.TOUCHED_EARLY | Finding.LEFT  # all before, and the last two
KINDS = (Kind.STABLE, Kind.LIMIT_CYCLE, Kind.UNSTABLE, Kind.INVALID)  # by the codes of `kinds`
CRITERIA = ("felt", "heard", "any")  # what may end a Z-width, besides instability
_EXCEEDED_BY = dict(zip(CRITERIA, (Finding.FELT, Finding.HEARD, EXCEEDED), strict=True))


def findings(numbers: Numbers, limits: Limits) -> Any:
    """What speaks against trials: bits of `Finding`, for a record of `rig.control.measure.NUMBERS` or an array.

    The thresholds must be those that the numbers were measured with: where the floor hides it, felt is NaN.
    """
    n: Any = numbers
    if isinstance(n, np.void):  # plain numbers are compared ten times as fast as numpy's scalars
        n = dict(zip(n.dtype.names or (), n.item(), strict=True))
    touched, stayed = n["contact_s"] >= 0.0, n["inside_ticks_in_tail"] > 0
    felt = n["felt"] > limits.felt_velocity  # never, when it is not measurable
    heard, moved = n["heard"] > limits.heard_effort, n["moved"] > limits.moved
    exceeded = felt | heard | moved
    exits = n["exits_in_tail"] > 0
    saturates = n["saturated_fraction_in_tail"] > limits.saturated_fraction
    measured = n["tail_begins_s"] >= 0.0
    calm = (n["heard_in_stay"] <= limits.heard_effort) & (n["moved_in_stay"] <= limits.moved)
    found = (
        (Finding.NEVER_TOUCHED, touched ^ True),
        (Finding.GONE, touched & (stayed ^ True)),
        (Finding.TOUCHED_LATE, stayed & (n["contact_s"] > n["tail_begins_s"])),
        (Finding.GAPS, n["gaps"] > 0),
        (Finding.LATE, n["late_fraction"] >= limits.late_fraction),
        (Finding.SLEW_BOUND, n["slew_bound_ticks"] > 0),
        (Finding.OVERRULED, n["overruled_ticks"] > 0),
        (Finding.IDLE_SATURATION, saturates & (exceeded ^ True)),
        (Finding.STILL_SETTLING, (n["settling_in_tail_s"] > 0.0) & (exits | exceeded)),
        (Finding.EXITS, exits),
        (Finding.GROWS, (n["growth"] > limits.growth) & exceeded),
        (Finding.SATURATES, saturates & exceeded),
        (Finding.FELT, felt),
        (Finding.HEARD, heard),
        (Finding.MOVED, moved),
        (Finding.TOUCHED_EARLY, touched & (n["contact_s"] < limits.baseline_s)),
        (Finding.LEFT, (n["stay_ticks"] > 0) & calm & limits.may_leave),
    )
    bits = sum(finding.value * condition for finding, condition in found)
    return Finding.TOO_SHORT.value * (measured ^ True) + measured * bits


def kinds(numbers: Numbers, limits: Limits) -> NDArray[np.int64]:
    """Return the place in `KINDS` of each trial: what `decide` says, without its texts."""
    codes: NDArray[np.int64] = _codes(findings(numbers, limits))
    return codes


def decide(numbers: np.void, limits: Limits) -> tuple[Kind, tuple[str, ...]]:
    """Return the kind of one trial (a record of `rig.control.measure.NUMBERS`) and the reasons for it."""
    found = Finding(int(findings(numbers, limits)))
    kind = KINDS[int(_codes(int(found)))]
    told = {Kind.INVALID: INVALID, Kind.UNSTABLE: UNSTABLE | EXCEEDED}.get(kind, EXCEEDED)
    return kind, tuple(_TEXTS[finding](numbers, limits) for finding in found & told)


@dataclass(frozen=True)
class Measured:
    """A trial as numbers, with what follows from them: a verdict without its texts.

    Attributes
    ----------
    numbers
        One record of `rig.control.measure.NUMBERS`.
    limits
        Those that it was measured with.
    thrown_out
        Whether a guard ended the push because the handle left its window or went too fast, or the motor gave too much
        energy or oscillated violently (`rig.control.watch`), which the signals before do not show. After contact that
        is unstable, without it invalid.
    """

    numbers: np.void
    limits: Limits
    thrown_out: bool = False

    @cached_property
    def found(self) -> Finding:
        """Everything that speaks against the trial."""
        return Finding(int(findings(self.numbers, self.limits)))

    @property
    def kind(self) -> Kind:
        """How the hit ended."""
        if self.thrown_out:
            return Kind.UNSTABLE if self.numbers["contact_s"] >= 0.0 else Kind.INVALID
        return KINDS[int(_codes(int(self.found)))]

    @cached_property
    def verdict(self) -> Verdict:
        """Outcome, reasons and numbers, by the signals alone (see `overruled` for the rest)."""
        kind, reasons = decide(self.numbers, self.limits)
        shown = {
            name: self.numbers[name].item() for name in Verdict.__dataclass_fields__ if name not in _WORDS
        }
        shown.update({name: None for name in _MAY_BE_NONE if math.isnan(shown[name])})
        return Verdict(kind=kind, reasons=reasons, **shown)

    def passes(self, criterion: str) -> bool | None:
        """Whether the wall lies within the Z-width under a criterion; None when the trial says nothing about it.

        Parameters
        ----------
        criterion
            One of `CRITERIA`: ``felt``, ``heard``, or ``any`` (of felt, heard and moved).

        Notes
        -----
        A wall fails whose trial is unstable, or exceeds the criterion's own threshold, or touched the wall and was out
        of it for the whole tail or left it there: against a push that lasts, as it does in a map, only a wall that
        gives energy throws a handle that far (a session asks nothing of a person's invalid trial). A
        trial that is still settling counts for what its tail shows: it has rung as long as the trial lasts. Every
        other invalid trial says nothing: never touched, touched only in the tail, too short, gaps, late ticks, a slew
        limit that bound or a device that overruled the law (then it was another wall), or a push that saturates the
        motor at rest. Where *felt* is not measurable it exceeds nothing: a Z-width under ``felt`` is one of truths, or
        of a fine encoder.
        """
        if self.thrown_out:
            return False if self.numbers["contact_s"] >= 0.0 else None
        if self.found & INVALID & ~(Finding.GONE | Finding.STILL_SETTLING | Finding.LEFT):
            return None
        return not self.found & (UNSTABLE | Finding.GONE | _EXCEEDED_BY[criterion])


def overruled(verdict: Verdict, kind: Kind, reason: str) -> Verdict:
    """Return the same numbers with another outcome, for a reason that the signals do not show."""
    return replace(verdict, kind=kind, reasons=(reason, *verdict.reasons))


def _codes(found: Any) -> Any:
    """Index into `KINDS`: what makes a trial invalid outweighs what it shows, and instability a limit cycle."""
    invalid, unstable, exceeded = ((found & int(bits)) != 0 for bits in (INVALID, UNSTABLE, EXCEEDED))
    shown = 2 * unstable + (unstable ^ True) * exceeded
    return 3 * invalid + (invalid ^ True) * shown


def _times(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


_TEXTS: dict[Finding, Callable[[np.void, Limits], str]] = {
    Finding.TOO_SHORT: lambda n, _: f"only {n['ticks']} ticks of trial",
    Finding.NEVER_TOUCHED: lambda _, __: "the wall was never touched",
    Finding.GONE: lambda _, __: "the wall was not touched in the tail",
    Finding.TOUCHED_LATE: lambda _, __: "the first contact lies in the tail",
    Finding.GAPS: lambda n, _: (
        f"{_times(n['gaps'], 'gap')} in the samples: the link or this computer was late"
    ),
    Finding.LATE: lambda n, _: (
        f"{100 * n['late_ticks'] / n['ticks']:.2g} % late ticks: close other programs, or lower the rate"
    ),
    Finding.SLEW_BOUND: lambda n, _: f"the slew limit bound in {_times(n['slew_bound_ticks'], 'tick')}",
    Finding.OVERRULED: lambda n, _: f"the device overruled the law in {_times(n['overruled_ticks'], 'tick')}",
    Finding.IDLE_SATURATION: lambda _, __: "saturated in the tail without ripple or motion",
    Finding.STILL_SETTLING: lambda n, _: (
        f"still settling when the tail began, {n['settling_in_tail_s']:.3g} s too early: lengthen the trial"
    ),
    Finding.EXITS: lambda n, _: f"left the wall {_times(n['exits_in_tail'], 'time')} in the tail",
    Finding.GROWS: lambda n, _: f"ripple grows {n['growth']:.3g}-fold over the tail",
    Finding.SATURATES: lambda n, _: f"saturates in {100 * n['saturated_fraction_in_tail']:.2g} % of the tail",
    Finding.FELT: lambda n, limits: f"felt {n['felt']:.3g} above {limits.felt_velocity:.3g}",
    Finding.HEARD: lambda n, limits: f"heard {n['heard']:.3g} above {limits.heard_effort:.3g}",
    Finding.MOVED: lambda n, limits: f"moved {n['moved']:.3g} above {limits.moved:.3g}",
    Finding.LEFT: lambda _, __: (
        "the hand left the calm wall before the end and did not come back: ask to stay in it"
    ),
    Finding.TOUCHED_EARLY: lambda n, limits: (
        f"the wall was touched {n['contact_s']:.3g} s into the {limits.baseline_s:.3g} s of free space before the hit"
    ),
}
