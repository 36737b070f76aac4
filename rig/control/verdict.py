"""Verdict of one hit (stable, limit cycle, unstable or invalid), with all numbers that decide it.

`rig.control.judging` computes three ripples from the signals of a trial over its tail, which is its last `tail_s`:

* **felt**: rms velocity from 30 to 500 Hz, computed from counts by a central difference and a zero-phase filter;
* **heard**: rms of the commanded effort above 30 Hz;
* **moved**: peak-to-peak position above 30 Hz, minus one count.

A recording has the motion at the encoder. In simulation, the true felt and moved are those of the handle.

*Invalid*: the trial cannot be judged. It has no contact, or too long a gap, too many lost samples or late ticks after
the first contact, or the slew limit acted, the device overruled the law, the measured current differed from the set
current, or the motor saturated without motion. Losses before the contact are only reported. *Unstable*: the handle left
the wall in the tail, or the ripple grows, or the motor saturates while a threshold is exceeded. *Limit cycle*: not
unstable, but felt, heard or moved is above its threshold. *Stable*: none of these conditions holds.

If a person hits, leaves the wall and does not return, the trial is invalid if the last stay in the wall lasted at least
one period of the high pass and was calm until one period before its end; otherwise it is unstable. One toggling count
reads as a velocity, the floor of *felt*. If the floor exceeds the threshold, *felt* is not measurable and is ignored.

Trials, maps, sessions, the console and the analysis of studies use it. It must not open a recording or filter a signal:
it uses the computed numbers only.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntFlag, StrEnum
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from rig.core.quantity import Quantity

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Numbers = NDArray[np.void] | np.void

_WORDS = ("kind", "reasons")
_MAY_BE_NONE = ("felt", "contact_s", "impact_velocity", "settling_s")


class Kind(StrEnum):
    """Outcome of a hit: stable, limit cycle, unstable or invalid."""

    STABLE = "stable"
    LIMIT_CYCLE = "limit cycle"
    UNSTABLE = "unstable"
    INVALID = "invalid"


@dataclass(frozen=True, slots=True, kw_only=True)
class Thresholds:
    """Thresholds for judging a trial (SI units, at the link); `rig.config.verdict_thresholds` computes them."""

    tail_s: float  # length of the tail, the last part of a trial
    highpass_hz: float  # band of the rms velocity; effort and position have no upper edge
    lowpass_hz: float
    felt_velocity: float  # rms (rad/s or m/s)
    heard_effort: float  # rms (N·m or N)
    moved: float  # peak-to-peak (rad or m)
    growth: float  # rms of the second half of the tail over the first
    late_fraction: float  # of the ticks from the first contact on
    saturated_fraction: float  # of the ticks in the tail
    longest_gap: int  # samples lost in a row from the first contact on
    lost_fraction: float  # of the samples from the first contact on
    may_leave: bool = False  # True if a person hits, whose hand may leave the wall without being thrown


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Verdict and numbers of one hit, in SI units; a number is None if it is not measurable."""

    kind: Annotated[Kind, Quantity("", "verdict")]
    reasons: Annotated[tuple[str, ...], Quantity("", "reasons of the verdict")]
    felt: Annotated[float | None, Quantity("velocity", "rms velocity in the tail, 30 to 500 Hz")]
    felt_floor: Annotated[
        float, Quantity("velocity", "velocity reading of one count that toggles as often as in the tail")
    ]
    heard: Annotated[float, Quantity("effort", "rms ripple of the effort in the tail, above 30 Hz")]
    moved: Annotated[
        float, Quantity("position", "peak-to-peak position in the tail, above 30 Hz, less one count")
    ]
    growth: Annotated[
        float, Quantity("1", "ripple of the second half of the tail over the first; 0 without ripple")
    ]
    exits_in_tail: Annotated[int, Quantity("1", "times that the handle left the wall in the tail")]
    exits: Annotated[int, Quantity("1", "times that the handle left the wall")]
    contact_s: Annotated[float | None, Quantity("s", "first contact after the start of the trial")]
    impact_velocity: Annotated[float | None, Quantity("velocity", "velocity at first contact")]
    peak_penetration: Annotated[float, Quantity("position", "greatest penetration")]
    resting_penetration: Annotated[float, Quantity("position", "median penetration in the tail")]
    settling_s: Annotated[
        float | None, Quantity("s", "from first contact until penetration stays near its resting value")
    ]
    peak_effort: Annotated[float, Quantity("effort", "greatest effort commanded")]
    saturated_fraction: Annotated[float, Quantity("1", "share of ticks in which the effort was clipped")]
    saturated_fraction_in_tail: Annotated[
        float, Quantity("1", "share of ticks in the tail with a clipped effort")
    ]
    late_ticks: Annotated[int, Quantity("1", "ticks with a late command")]
    gaps: Annotated[int, Quantity("1", "gaps in the samples")]
    lost_samples: Annotated[int, Quantity("1", "samples lost in them")]
    longest_gap: Annotated[
        int, Quantity("1", "largest number of successive lost samples from the first contact on")
    ]
    lost_fraction: Annotated[float, Quantity("1", "share of samples lost from the first contact on")]
    late_fraction: Annotated[float, Quantity("1", "share of late ticks from the first contact on")]
    current_observed: Annotated[
        int, Quantity("1", "windows of 10 ms in which the measured current followed the active one")
    ]
    ticks: Annotated[int, Quantity("1", "ticks of the trial")]


class Opening(StrEnum):
    """Beginnings of the texts that explain why a trial is invalid; by its beginning a reader recognises the reason.

    Recordings and session logs store only texts. Their readers (`rig.session.planning._reasons`) compare with these
    members, so that a change of wording needs no change anywhere else.
    """

    TOO_SHORT = "only "
    NEVER_TOUCHED = "the wall was never touched"
    GONE = "the wall was not touched in the tail"
    TOUCHED_LATE = "the first contact lies in the tail"
    LOST_OR_LATE = "from contact on, "
    SLEW_BOUND = "the slew limit "
    OVERRULED = "the device overruled the law "
    IDLE_SATURATION = "saturated "
    STILL_SETTLING = "still settling "
    CURRENT = "the measured current "
    LEFT = "the hand left "
    FALSE_START = "a false start: "
    ENDED_EARLY = "the run ended early: "
    HIT_WRONGLY = "hit too "
    PRESSED_LIGHTLY = "pressed too lightly: "
    PRESSED_HARD = "pressed too hard: "
    # Trials of older logs: a touch in the baseline has been a false start since.
    TOUCHED_EARLY = "the wall was touched at "


class Objection(IntFlag):
    """Reasons against calling a trial stable, as bit flags, in the order in which they are reported."""

    TOO_SHORT = 1
    NEVER_TOUCHED = 2
    GONE = 4  # the handle touched the wall and was outside of it for the whole tail
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
    THROWN = 65536  # a person's hand left a wall that was not calm, before the tail, and stayed away
    # The measured current did not follow the active one, or the active one not the commanded one.
    CURRENT = 262144
    LEFT = 131072  # a person's hand left the calm wall and stayed away


MACHINE = Objection.GAPS | Objection.LATE  # faults of computer and link, not of the rig or the person
EXCEEDED = Objection.FELT | Objection.HEARD | Objection.MOVED
UNSTABLE = Objection.EXITS | Objection.GROWS | Objection.SATURATES | Objection.THROWN
INVALID = Objection(Objection.EXITS - 1) | Objection.LEFT | Objection.CURRENT  # all before, and the last two
KINDS = (Kind.STABLE, Kind.LIMIT_CYCLE, Kind.UNSTABLE, Kind.INVALID)  # by the codes of `kinds`
# Changes of the count between two neighbours: a dead channel has hundreds in a reach, tremor some ten a second.
TOGGLES = 64
CRITERIA = ("felt", "heard", "any")  # ripples that, besides instability, put a wall outside of the Z-width
_EXCEEDED_BY = dict(zip(CRITERIA, (Objection.FELT, Objection.HEARD, EXCEEDED), strict=True))


def objections(numbers: Numbers, thresholds: Thresholds) -> Any:
    """Return for each trial the reasons against calling it stable, as bits of `Objection`.

    `numbers` is a record of `rig.control._measure.NUMBERS` (one trial) or an array of records. The thresholds must be
    those used for the measurement, which leaves out the rms velocity if its threshold is too low to measure.
    """
    n: Any = numbers
    # Plain numbers are compared ten times as fast as numpy's scalars.
    if isinstance(n, np.void):
        n = dict(zip(n.dtype.names or (), n.item(), strict=True))
    touched, stayed = n["contact_s"] >= 0.0, n["inside_ticks_in_tail"] > 0
    felt = n["felt"] > thresholds.felt_velocity  # never, when it is not measurable
    heard, moved = n["heard"] > thresholds.heard_effort, n["moved"] > thresholds.moved
    exceeded = felt | heard | moved
    exits = n["exits_in_tail"] > 0
    saturates = n["saturated_fraction_in_tail"] > thresholds.saturated_fraction
    measured = n["tail_begins_s"] >= 0.0
    # `^ True` and not `~` or `not`: it negates Python's bool and numpy's arrays alike.
    gone = touched & (stayed ^ True)
    # A person may leave the wall too early; an unstable wall oscillates first, and a hand that pushes comes back. A
    # wall that bounces, or buzzed before it was left, is unstable also if the hand stays away: to repeat such trials
    # would discard unstable walls.
    calm = (
        (n["stay_ticks"] > 0)
        & (n["heard_in_stay"] <= thresholds.heard_effort)
        & (n["moved_in_stay"] <= thresholds.moved)
    )
    found = (
        (Objection.NEVER_TOUCHED, touched ^ True),
        (Objection.GONE, gone & (thresholds.may_leave ^ True)),
        (Objection.TOUCHED_LATE, stayed & (n["contact_s"] > n["tail_begins_s"])),
        (
            Objection.GAPS,
            (n["longest_gap"] > thresholds.longest_gap) | (n["lost_fraction"] > thresholds.lost_fraction),
        ),
        (Objection.LATE, n["late_fraction"] >= thresholds.late_fraction),
        (Objection.SLEW_BOUND, n["slew_bound_ticks"] > 0),
        (Objection.OVERRULED, n["overruled_ticks"] > 0),
        (Objection.IDLE_SATURATION, saturates & (exceeded ^ True)),
        (Objection.STILL_SETTLING, (n["settling_in_tail_s"] > 0.0) & (exits | exceeded)),
        (Objection.EXITS, exits),
        (Objection.GROWS, (n["growth"] > thresholds.growth) & exceeded),
        (Objection.SATURATES, saturates & exceeded),
        (Objection.FELT, felt),
        (Objection.HEARD, heard),
        (Objection.MOVED, moved),
        (Objection.THROWN, gone & (calm ^ True) & thresholds.may_leave),
        (Objection.CURRENT, (n["current_differs"] > 0) | (n["other_current_ticks"] > 0)),
        (Objection.LEFT, calm & thresholds.may_leave),
    )
    bits = sum(objection.value * condition for objection, condition in found)
    return Objection.TOO_SHORT.value * (measured ^ True) + measured * bits


def kinds(numbers: Numbers, thresholds: Thresholds) -> NDArray[np.int64]:
    """Return each trial's outcome without texts: an index into `KINDS` (stable, limit cycle, unstable, invalid)."""
    codes: NDArray[np.int64] = _codes(objections(numbers, thresholds))
    return codes


def decide(numbers: np.void, thresholds: Thresholds) -> tuple[Kind, tuple[str, ...]]:
    """Return the outcome of one trial (stable, limit cycle, unstable or invalid), and the texts of its reasons."""
    found = Objection(int(objections(numbers, thresholds)))
    kind = KINDS[int(_codes(int(found)))]
    shown = {Kind.INVALID: INVALID, Kind.UNSTABLE: UNSTABLE | EXCEEDED}.get(kind, EXCEEDED)
    return kind, tuple(_TEXTS[objection](numbers, thresholds) for objection in found & shown)


@dataclass(frozen=True)
class Measured:
    """Numbers of one trial, and the outcome that they imply.

    Attributes
    ----------
    numbers
        One record of `rig.control._measure.NUMBERS`.
    thresholds
        Thresholds used for the measurement.
    thrown_out
        True if a safety limit ended the run: the handle left its range or was too fast, or the motor gave too much
        energy or oscillated violently (`rig.control._watch`). The signals up to that tick do not show it. The trial is
        then unstable after a contact, and invalid without a contact.
    """

    numbers: np.void
    thresholds: Thresholds
    thrown_out: bool = False

    @cached_property
    def found(self) -> Objection:
        """Return all reasons against calling the trial stable, as bit flags."""
        return Objection(int(objections(self.numbers, self.thresholds)))

    @property
    def kind(self) -> Kind:
        """Return the outcome of the trial: stable, limit cycle, unstable or invalid."""
        if self.thrown_out and not self.found & Objection.CURRENT:
            return Kind.UNSTABLE if self.numbers["contact_s"] >= 0.0 else Kind.INVALID
        return KINDS[int(_codes(int(self.found)))]

    @property
    def by_machine(self) -> bool:
        """Return True if only lost samples or late ticks make the trial invalid, so that a repeat may be valid."""
        # A device whose command is late overrules the law: beside a gap or late ticks that is the same fault.
        against = self.found & INVALID
        return (
            not self.thrown_out and bool(against & MACHINE) and not against & ~(MACHINE | Objection.OVERRULED)
        )

    @cached_property
    def verdict(self) -> Verdict:
        """Return the verdict of the trial (outcome, reasons, numbers) from its signals only."""
        kind, reasons = decide(self.numbers, self.thresholds)
        shown = {
            name: self.numbers[name].item() for name in Verdict.__dataclass_fields__ if name not in _WORDS
        }
        shown.update({name: None for name in _MAY_BE_NONE if math.isnan(shown[name])})
        return Verdict(kind=kind, reasons=reasons, **shown)

    def passes(self, criterion: str) -> bool | None:
        """Return True if the trial shows a stable wall under a criterion; None if the trial cannot decide it.

        Parameters
        ----------
        criterion
            Ripples that count: ``felt`` (rms velocity), ``heard`` (rms effort), or ``any`` (both, and peak-to-peak
            position).

        Notes
        -----
        A wall fails if the trial is unstable, exceeds the criterion's own threshold, or if the handle touched the wall
        and was
        outside of it for the whole tail (last part of the trial) or left it in the tail. Other invalid trials give
        None, except
        a trial that is still settling. If the rms velocity is not measurable it exceeds no threshold: use ``felt`` only
        with
        true signals or a fine encoder.
        """
        if self.thrown_out and not self.found & Objection.CURRENT:
            return False if self.numbers["contact_s"] >= 0.0 else None
        # GONE and LEFT fail: against a push that lasts, as in a map, only a wall that gives energy throws a handle that
        # far. STILL_SETTLING counts for what its tail shows: it has rung as long as the trial lasts. With a slew limit
        # that acted, or a device that overruled the law, it was another wall.
        if self.found & INVALID & ~(Objection.GONE | Objection.STILL_SETTLING | Objection.LEFT):
            return None
        return not self.found & (UNSTABLE | Objection.GONE | Objection.LEFT | _EXCEEDED_BY[criterion])


def overrule(verdict: Verdict, kind: Kind, reason: str) -> Verdict:
    """Return the verdict with another outcome and an additional reason that the signals do not show."""
    return replace(verdict, kind=kind, reasons=(reason, *verdict.reasons))


def _codes(found: Any) -> Any:
    """Return each trial's outcome as an index into `KINDS`; invalid wins over unstable, unstable over limit cycle."""
    invalid, unstable, exceeded = ((found & int(bits)) != 0 for bits in (INVALID, UNSTABLE, EXCEEDED))
    shown = 2 * unstable + (unstable ^ True) * exceeded
    return 3 * invalid + (invalid ^ True) * shown


def percent(share: float) -> str:
    """Return a ratio from 0 to 1 as a text in per cent with two digits, such as "12 %"."""
    # Not .2g for all: 100 % would read 1e+02 %.
    return f"{100 * share:{'.0f' if share >= 0.1 else '.2g'}} %"


def _times(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


_TEXTS: dict[Objection, Callable[[np.void, Thresholds], str]] = {
    Objection.TOO_SHORT: lambda n, _: f"{Opening.TOO_SHORT}{n['ticks']} ticks in the trial",
    Objection.NEVER_TOUCHED: lambda n, _: (
        Opening.NEVER_TOUCHED.value
        if n["toggles"] < TOGGLES
        else f"{Opening.NEVER_TOUCHED}, and the count changed {n['toggles']} times between two neighbours: if the "
        "handle moved, one channel of the encoder is dead"
    ),
    Objection.GONE: lambda _, __: Opening.GONE.value,
    Objection.TOUCHED_LATE: lambda _, __: Opening.TOUCHED_LATE.value,
    Objection.GAPS: lambda n, thresholds: (
        f"{Opening.LOST_OR_LATE}{percent(n['lost_fraction'])} of the samples lost (limit "
        f"{percent(thresholds.lost_fraction)}), {n['longest_gap']} in a row (limit "
        f"{thresholds.longest_gap}): the link or this computer was too slow"
    ),
    Objection.LATE: lambda n, thresholds: (
        f"{Opening.LOST_OR_LATE}{percent(n['late_fraction'])} late ticks (limit {percent(thresholds.late_fraction)}): "
        "close other programs, or lower the rate"
    ),
    Objection.SLEW_BOUND: lambda n, _: (
        f"{Opening.SLEW_BOUND}acted in {_times(n['slew_bound_ticks'], 'tick')}"
    ),
    Objection.OVERRULED: lambda n, _: f"{Opening.OVERRULED}in {_times(n['overruled_ticks'], 'tick')}",
    Objection.IDLE_SATURATION: lambda _, __: f"{Opening.IDLE_SATURATION}in the tail without ripple or motion",
    Objection.STILL_SETTLING: lambda n, _: (
        f"{Opening.STILL_SETTLING}when the tail began, {n['settling_in_tail_s']:.3g} s too early: lengthen the trial"
    ),
    Objection.EXITS: lambda n, _: f"left the wall {_times(n['exits_in_tail'], 'time')} in the tail",
    Objection.GROWS: lambda n, _: f"ripple grows {n['growth']:.3g}-fold over the tail",
    Objection.SATURATES: lambda n, _: f"saturates in {percent(n['saturated_fraction_in_tail'])} of the tail",
    Objection.FELT: lambda n, thresholds: f"felt {n['felt']:.3g} above {thresholds.felt_velocity:.3g}",
    Objection.HEARD: lambda n, thresholds: f"heard {n['heard']:.3g} above {thresholds.heard_effort:.3g}",
    Objection.MOVED: lambda n, thresholds: f"moved {n['moved']:.3g} above {thresholds.moved:.3g}",
    Objection.CURRENT: lambda n, _: (
        f"{Opening.CURRENT}differed from the set current in "
        f"{_times(n['current_differs'], 'window')} of 10 ms, and the set current from the commanded "
        f"one in {_times(n['other_current_ticks'], 'tick')}: check described delay, motor leads, "
        "amplifier and sensor"
    ),
    Objection.LEFT: lambda _, __: (
        f"{Opening.LEFT}the calm wall before the end and did not return: ask the person to stay in the wall"
    ),
    Objection.THROWN: lambda _, __: "the wall threw the hand out, and the hand did not return",
}
