"""Compute all numbers by which one trial is judged from its arrays, in one compiled call that allocates nothing.

`measure` is used for recordings and for simulated trials; `rig.control.verdict` derives the outcome from the numbers.

`rig.control.judging`, simulated maps and tests call it. It must not allocate, and must not decide the outcome.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, NamedTuple

import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from rig.control._butterworth import band_pass, high_pass
from rig.control._median import median
from rig.core.sample import RowFlag
from rig.realtime.groups import group, type_of
from rig.realtime.kernel import kernel

NUMBERS = np.dtype(
    [
        # Fields of rig.control.verdict.Verdict, of which the tail is the last part of a trial; NaN stands for its None.
        ("felt", "<f8"),
        ("felt_floor", "<f8"),
        ("heard", "<f8"),
        ("moved", "<f8"),
        ("growth", "<f8"),
        ("exits_in_tail", "<i8"),
        ("exits", "<i8"),
        ("contact_s", "<f8"),
        ("impact_velocity", "<f8"),
        ("peak_penetration", "<f8"),
        ("resting_penetration", "<f8"),
        ("settling_s", "<f8"),
        ("peak_effort", "<f8"),
        ("saturated_fraction", "<f8"),
        ("saturated_fraction_in_tail", "<f8"),
        ("late_ticks", "<i8"),
        ("gaps", "<i8"),
        ("lost_samples", "<i8"),
        ("longest_gap", "<i8"),
        ("lost_fraction", "<f8"),
        ("late_fraction", "<f8"),
        ("current_observed", "<i8"),
        ("ticks", "<i8"),
        # Further numbers that decide the outcome.
        ("current_differs", "<i8"),
        ("other_current_ticks", "<i8"),
        ("slew_bound_ticks", "<i8"),
        ("overruled_ticks", "<i8"),
        ("inside_ticks_in_tail", "<i8"),
        # Without a contact, changes of the count in a row between the same two neighbours; else 0.
        ("toggles", "<i8"),
        # Length of the stay in the wall after which the handle stayed outside; 0 without such a stay, or if it was
        # shorter than a period of the high pass.
        ("stay_ticks", "<i8"),
        # Ripples up to one period of the high pass before the end of that stay.
        ("heard_in_stay", "<f8"),
        ("moved_in_stay", "<f8"),
        ("tail_begins_s", "<f8"),  # NaN for a trial too short to be measured
        # How long settling lasted into the tail; 0 if it ended before the tail, or never.
        ("settling_in_tail_s", "<f8"),
    ],
    align=True,
)

# Unit of each number, or the quantity that has one (`rig.core.sample.unit_of`); the others are counts and shares.
UNITS = {
    "felt": "velocity",
    "felt_floor": "velocity",
    "heard": "effort",
    "moved": "position",
    "contact_s": "s",
    "impact_velocity": "velocity",
    "peak_penetration": "position",
    "resting_penetration": "position",
    "settling_s": "s",
    "peak_effort": "effort",
    "tail_begins_s": "s",
    "settling_in_tail_s": "s",
    "heard_in_stay": "effort",
    "moved_in_stay": "position",
}

SETTINGS = np.dtype(
    [
        ("tick_s", "<f8"),
        ("resolution", "<f8"),  # travel of one count (rad or m); 0 for true signals
        ("felt_velocity", "<f8"),  # threshold; felt is not measurable if one toggling count exceeds it
        ("highpass_hz", "<f8"),
        ("lowpass_hz", "<f8"),
        ("tail_ticks", "<i8"),
        ("lead_ticks", "<i8"),  # ticks before the tail that are filtered too, until old samples are forgotten
        ("pad_ticks", "<i8"),  # ticks by which the velocity is mirrored beyond each end
        ("impact_ticks", "<i8"),  # ticks before the contact from which the velocity at impact is estimated
    ],
    align=True,
)

# A trial with fewer ticks has no numbers: filters, slopes and a median need some.
FEWEST_TICKS = 8
# Among the flags of a tick, above those of RowFlag: the device did not apply the law's effort, and from the next bit on
# how many samples were lost just before.
OVERRULED = 1 << 32
LOST_BITS = 33

# Plain integers, which compiled code can use as constants.
_SATURATED, _SLEW_BOUND = int(RowFlag.SATURATED), int(RowFlag.SLEW_BOUND)
_LATE = int(RowFlag.LATE)
_FOLLOWS, _DIFFERS, _OTHER = (
    int(RowFlag.CURRENT_FOLLOWS),
    int(RowFlag.CURRENT_DIFFERS),
    int(RowFlag.OTHER_CURRENT),
)

# Share of an old sample that the lead-in may leave in a filter: only the tail is filtered, and from rest.
_REMEMBERED = 1e-9
_PAD_PERIODS = 3.0  # of the high pass
_IMPACT_S, _IMPACT_TICKS = 0.010, 4
_SLOW = 0.8  # of a period of the band's upper edge, which lets half the amplitude through
_NYQUIST_SHARE = 0.45  # of the rate: an upper corner from here on is dropped

# b0, b1, b2, a1, a2 of each section; one is the high pass, the other two in series the band pass
_HIGHPASS, _BAND = 0, 1
_SECTIONS = 3

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Records = NDArray[np.void]

_SIGNAL = types.Array(types.float64, 1, "A", readonly=True)
_FLAGS = types.Array(types.int64, 1, "A", readonly=True)
SETTINGS_TYPE = types.Array(numba.from_dtype(SETTINGS), 1, "C", readonly=True)
SECTIONS_TYPE = types.Array(types.float64, 2, "C", readonly=True)
_SCRATCH_TYPE = types.float64[::1]
NUMBERS_TYPE = types.Array(numba.from_dtype(NUMBERS), 1, "C")


@dataclass(frozen=True, slots=True)
class Filters:
    """Coefficients of the high pass and the band pass with which a trial is judged.

    `sections` has one row (b0, b1, b2, a1, a2) for each second-order section. After `lead_ticks` ticks the output of
    both filters does not depend on earlier samples.
    """

    sections: Floats
    lead_ticks: int


@lru_cache(maxsize=64)
def filters(tick_s: float, highpass_hz: float, lowpass_hz: float) -> Filters:
    """Return the high pass and the band pass with which a trial is judged: Butterworth, two poles at each edge.

    The band pass has no upper edge if that edge would be at or above 0.45 of the sampling rate.
    """
    rate_hz = 1.0 / tick_s
    highpass = high_pass(2, highpass_hz, rate_hz)
    nothing = [[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]]
    band = [*highpass, *nothing]
    if lowpass_hz < _NYQUIST_SHARE * rate_hz:
        band = band_pass(highpass_hz, lowpass_hz, rate_hz)
    sections = np.ascontiguousarray(np.vstack([highpass, band])[:, [0, 1, 2, 4, 5]])
    sections.flags.writeable = False
    slowest = max(abs(pole) for _, _, _, a1, a2 in sections for pole in np.roots([1.0, a1, a2]))
    return Filters(sections, math.ceil(math.log(_REMEMBERED) / math.log(slowest)))


@kernel(types.int64(_SIGNAL, _SIGNAL, SETTINGS_TYPE, NUMBERS_TYPE), no_refcount=True)
def _contact(effort: Floats, penetration: Floats, settings: Records, numbers: Records) -> int:
    """Write first contact, exits, stay in the wall and peaks to `numbers`; return the tick of the last exit."""
    s, n = settings[0], numbers[0]
    ticks = penetration.shape[0]
    begin = max(0, ticks - s["tail_ticks"])
    contact, was_inside = -1, False
    exits = exits_in_tail = inside_in_tail = entries_in_tail = entered = left_at = stay = 0
    deepest, strongest = penetration[0], 0.0
    for k in range(ticks):
        inside, in_tail = penetration[k] > 0.0, k >= begin
        left = was_inside and not inside
        if inside and contact < 0:
            contact = k
        if inside and not was_inside:
            entered = k
            entries_in_tail += in_tail
        if left:
            left_at, stay = k, k - entered
        exits += left
        exits_in_tail += left and in_tail
        inside_in_tail += inside and in_tail
        was_inside = inside
        deepest = max(deepest, penetration[k])
        strongest = max(strongest, abs(effort[k]))
    n["exits"], n["exits_in_tail"], n["inside_ticks_in_tail"] = exits, exits_in_tail, inside_in_tail
    # A bounce is shorter than a period of the high pass, and its ripple could not be seen: it is no stay.
    once = entries_in_tail == 0 and (exits_in_tail == 1 or inside_in_tail == 0)
    n["stay_ticks"] = stay if once and stay * s["tick_s"] * s["highpass_hz"] >= 1.0 else 0
    n["contact_s"] = contact * s["tick_s"] if contact >= 0 else math.nan
    n["peak_penetration"], n["peak_effort"] = deepest, strongest
    return left_at


@kernel(types.void(_FLAGS, SETTINGS_TYPE, NUMBERS_TYPE), no_refcount=True)
def _marks(flags: Ints, settings: Records, numbers: Records) -> None:
    """Count flagged ticks and lost samples, in all and since the contact, and write the counts to `numbers`."""
    s, n = settings[0], numbers[0]
    ticks = flags.shape[0]
    begin = max(0, ticks - s["tail_ticks"])
    contact = ticks if math.isnan(n["contact_s"]) else int(np.rint(n["contact_s"] / s["tick_s"]))
    saturated_before = saturated = late = gaps = slew_bound = overruled = 0
    lost = lost_before = late_before = longest = follows = differs = other = 0
    for k in range(ticks):
        if k == begin:
            saturated_before = saturated
        if k == contact:
            lost_before, late_before = lost, late
        saturated += (flags[k] & _SATURATED) != 0
        late += (flags[k] & _LATE) != 0
        gap = flags[k] >> LOST_BITS
        gaps += gap > 0
        lost += gap
        if k >= contact:
            longest = max(longest, gap)
        slew_bound += (flags[k] & _SLEW_BOUND) != 0
        overruled += (flags[k] & OVERRULED) != 0
        follows += (flags[k] & _FOLLOWS) != 0
        differs += (flags[k] & _DIFFERS) != 0
        other += (flags[k] & _OTHER) != 0
    n["ticks"], n["tail_begins_s"] = ticks, begin * s["tick_s"]
    n["saturated_fraction"] = saturated / ticks
    n["saturated_fraction_in_tail"] = (saturated - saturated_before) / (ticks - begin)
    n["late_ticks"], n["gaps"], n["lost_samples"] = late, gaps, lost
    n["longest_gap"], n["lost_fraction"], n["late_fraction"] = longest, 0.0, 0.0
    if contact < ticks:
        n["late_fraction"] = (late - late_before) / (ticks - contact)
        n["lost_fraction"] = (lost - lost_before) / (ticks - contact + lost - lost_before)
    n["slew_bound_ticks"], n["overruled_ticks"] = slew_bound, overruled
    n["current_observed"], n["current_differs"], n["other_current_ticks"] = follows, differs, other


@kernel(types.float64(_SIGNAL, SETTINGS_TYPE), no_refcount=True)
def _toggling_hz(position: Floats, settings: Records) -> float:
    """Return the frequency (Hz) at which the encoder count toggles in the tail (last part) of a trial.

    It is half the rate of the changes that are not motion: changes against the direction of the previous change, and
    slow steps of a creeping count.
    """
    # No spectrum: its highest line is undefined for toggling without a period, whose velocity in the band depends on
    # the rate of changes alone. A toggling count changes direction twice in a period whatever its duty cycle. Pulses
    # much shorter than a period of the band read less than this floor.
    s = settings[0]
    ticks = position.shape[0]
    begin = max(0, ticks - s["tail_ticks"])
    first = max(0, begin - s["lead_ticks"])  # where the handle comes from decides what is a turn
    creeping = 0.5 / (s["highpass_hz"] * s["tick_s"])
    slow = _SLOW / (s["lowpass_hz"] * s["tick_s"])
    changes = 0
    direction, turned, changed = 0.0, first, first
    for k in range(first + 1, ticks):
        step = position[k] - position[k - 1]
        if step == 0.0:
            continue
        if step * direction <= 0.0:
            changes += k >= begin
            direction, turned = step, k
        # A motion in the band turns at least twice in a period of the high pass: a step in the same direction is creep
        # after half a period without a turn, and if it is slower than the band's upper edge.
        elif k - turned > creeping and k - changed > slow:
            changes += k >= begin
        changed = k
    return float(changes / (2.0 * (ticks - begin) * s["tick_s"]))


@kernel(types.int64(_SIGNAL, types.float64), inline=True, no_refcount=True)
def _toggles(position: Floats, resolution: float) -> int:
    """Return how often in a row the count changes between two neighbours; often means a dead encoder channel."""
    most = changes = 0
    low = position[0]
    for k in range(1, position.shape[0]):
        away = (position[k] - low) / resolution
        if not -0.5 < away < 1.5:
            changes, low = 0, position[k] if away < 0.0 else position[k] - resolution
        elif position[k] != position[k - 1]:
            changes += 1
            most = max(most, changes)
    return most


@kernel(types.float64(types.float64, types.float64, types.float64, types.float64))
def toggling_floor(frequency_hz: float, resolution: float, highpass_hz: float, lowpass_hz: float) -> float:
    """Return the rms velocity (rad/s or m/s) of a count that toggles at `frequency_hz`, within a band of frequencies.

    A square wave with the height Δ of one count (`resolution`, rad or m) has odd harmonics. At f Hz the velocity of
    each has the rms 2√2·f·Δ; the powers of those in the band are added.
    """
    # With no harmonic in the band at least one: the band's edges let a part of the fundamental through.
    harmonics = 0
    hz = frequency_hz
    while 0.0 < hz <= lowpass_hz:
        harmonics += hz >= highpass_hz
        hz += 2.0 * frequency_hz
    return 2.0 * math.sqrt(2.0 * max(1, harmonics)) * frequency_hz * resolution


@kernel(types.UniTuple(types.float64, 3)(*[types.float64] * 8), inline=True)
def _section(
    x: float, s1: float, s2: float, b0: float, b1: float, b2: float, a1: float, a2: float
) -> tuple[float, float, float]:
    """Return output and the two new states of a second-order section (transposed direct form II) for the sample `x`."""
    y = b0 * x + s1
    return y, (b1 * x + s2) - a1 * y, b2 * x - a2 * y


@kernel(types.void(_SIGNAL, _SIGNAL, SETTINGS_TYPE, SECTIONS_TYPE, NUMBERS_TYPE), no_refcount=True)
def _ripple_and_travel(
    position: Floats, effort: Floats, settings: Records, sections: Floats, numbers: Records
) -> None:
    """Write the ripples of effort and position and the growth of the effort's ripple to the record `numbers`.

    *heard* is the rms effort above the high pass, *moved* the peak-to-peak position above it, both in the tail (last
    part of the trial) and in the stay in the wall; *growth* is the rms effort of the tail's second half over that of
    the first.
    """
    s, n = settings[0], numbers[0]
    ticks = position.shape[0]
    begin = max(0, ticks - s["tail_ticks"])
    first = max(0, begin - s["lead_ticks"])
    half = begin + (ticks - begin) // 2
    calm = 0  # end of what is looked at of a stay: what follows belongs to leaving
    if n["inside_ticks_in_tail"] > 0 and n["stay_ticks"] > 0:
        calm = begin + n["inside_ticks_in_tail"] - int(np.rint(1.0 / (s["highpass_hz"] * s["tick_s"])))
    b0, b1, b2, a1, a2 = sections[_HIGHPASS]
    e1 = e2 = p1 = p2 = 0.0  # state of the two filters
    power = power_of_half = 0.0
    lowest = highest = 0.0
    for k in range(first, ticks):
        # Filters start as if their first sample had lasted forever. They stop a constant, so that is the deviation from
        # the first sample, filtered from rest.
        ripple, e1, e2 = _section(effort[k] - effort[first], e1, e2, b0, b1, b2, a1, a2)
        travelled, p1, p2 = _section(position[k] - position[first], p1, p2, b0, b1, b2, a1, a2)
        if k < begin:
            continue
        if k == begin:
            lowest = highest = travelled
        if k == half:
            power_of_half, power = power, 0.0
        power += ripple * ripple
        lowest, highest = min(lowest, travelled), max(highest, travelled)
        if k == calm - 1:
            n["heard_in_stay"] = math.sqrt((power_of_half + power) / (calm - begin))
            n["moved_in_stay"] = max(0.0, highest - lowest - s["resolution"])
    n["heard"] = math.sqrt((power_of_half + power) / (ticks - begin))
    n["growth"] = 0.0
    if power_of_half > 0.0:
        n["growth"] = math.sqrt(power / (ticks - half) / (power_of_half / (half - begin)))
    n["moved"] = max(0.0, highest - lowest - s["resolution"])


@kernel(types.float64(_SIGNAL, _SIGNAL, types.float64, types.int64), inline=True, no_refcount=True)
def _inner_velocity(position: Floats, velocity: Floats, rate_hz: float, k: int) -> float:
    if velocity.shape[0] > 0:
        return float(velocity[k])
    last = position.shape[0] - 1
    if k == 0:
        return float((position[1] - position[0]) * rate_hz)
    if k == last:
        return float((position[last] - position[last - 1]) * rate_hz)
    return float((position[k + 1] - position[k - 1]) * (0.5 * rate_hz))


@kernel(types.float64(_SIGNAL, _SIGNAL, types.float64, types.int64), inline=True, no_refcount=True)
def _velocity(position: Floats, velocity: Floats, rate_hz: float, k: int) -> float:
    """Return the velocity (rad/s or m/s) at tick `k`, mirrored beyond both ends; if not given, from `position`."""
    last = position.shape[0] - 1
    mirrored = abs(k) if k <= last else 2 * last - k
    return _inner_velocity(position, velocity, rate_hz, mirrored)


@kernel(types.float64(_SIGNAL, _SIGNAL, SETTINGS_TYPE, SECTIONS_TYPE, _SCRATCH_TYPE), no_refcount=True)
def _felt(position: Floats, velocity: Floats, settings: Records, sections: Floats, scratch: Floats) -> float:
    """Return the rms velocity (rad/s or m/s) in the pass band of `sections`, over the tail (last part) of a trial.

    The signal is filtered forwards, to `scratch`, and then backwards, which cancels the phase.
    """
    s = settings[0]
    ticks, rate_hz = position.shape[0], 1.0 / s["tick_s"]
    begin = max(0, ticks - s["tail_ticks"])
    # Even, as `scipy.signal.sosfiltfilt` with padtype="even": an odd one makes a step of ripple above the band.
    pad = min(s["pad_ticks"], ticks - 1)
    first, end = max(-pad, begin - s["lead_ticks"]), ticks + pad
    b0, b1, b2, a1, a2 = sections[_BAND]
    c0, c1, c2, d1, d2 = sections[_BAND + 1]
    s1 = s2 = z1 = z2 = 0.0
    start = _velocity(position, velocity, rate_hz, first)
    for k in range(first, end):
        y, s1, s2 = _section(_velocity(position, velocity, rate_hz, k) - start, s1, s2, b0, b1, b2, a1, a2)
        z, z1, z2 = _section(y, z1, z2, c0, c1, c2, d1, d2)
        if k >= begin:
            scratch[k - begin] = z
    s1 = s2 = z1 = z2 = power = 0.0
    start = scratch[end - 1 - begin]
    for i in range(end - 1 - begin, -1, -1):
        y, s1, s2 = _section(scratch[i] - start, s1, s2, b0, b1, b2, a1, a2)
        z, z1, z2 = _section(y, z1, z2, c0, c1, c2, d1, d2)
        if i < ticks - begin:
            power += z * z
    return math.sqrt(power / (ticks - begin))


@kernel(types.float64(_SIGNAL, types.int64, types.int64), no_refcount=True)
def _end_slope(position: Floats, first: int, last: int) -> float:
    """Return the slope (rad or m per tick) at tick `last` of a parabola fitted to ticks `first` to `last`.

    The fit has the least squared error. It uses the polynomials u and u² − mean(u²), which are orthogonal on an even
    grid; u counts ticks from the middle.
    """
    # Not a straight line: it reads the velocity of half the span earlier, which a push has raised by a fifth since.
    count = last - first + 1.0
    half = 0.5 * (last - first)
    mean_square = (count * count - 1.0) / 12.0
    slope = bend = 0.0
    for k in range(first, last + 1):
        u = k - first - half
        # Differences first: far from zero a sum of positions would lose the digits of the travel.
        travel = position[k] - position[last]
        slope += u * travel
        bend += (u * u - mean_square) * travel
    slope /= count * mean_square
    bend /= count * mean_square * (count * count - 4.0) / 15.0
    return float(slope + 2.0 * half * bend)


@kernel(types.void(_SIGNAL, _SIGNAL, _SIGNAL, SETTINGS_TYPE, _SCRATCH_TYPE, NUMBERS_TYPE), no_refcount=True)
def _rest_and_impact(
    position: Floats,
    velocity: Floats,
    penetration: Floats,
    settings: Records,
    scratch: Floats,
    numbers: Records,
) -> None:
    s, n = settings[0], numbers[0]
    ticks = penetration.shape[0]
    begin = max(0, ticks - s["tail_ticks"])
    for k in range(begin, ticks):
        scratch[k - begin] = penetration[k]
    resting = median(scratch, ticks - begin)
    n["resting_penetration"] = resting
    n["settling_s"] = n["impact_velocity"] = math.nan
    n["settling_in_tail_s"] = 0.0
    if math.isnan(n["contact_s"]):
        return
    contact = int(np.rint(n["contact_s"] / s["tick_s"]))
    band = max(2.0 * s["resolution"], 0.05 * n["peak_penetration"])
    settled = ticks
    while settled > contact and not abs(penetration[settled - 1] - resting) > band:
        settled -= 1
    # Later than half the tail, too little remains to call the rest a resting value.
    if settled <= (begin + ticks) // 2:
        n["settling_s"] = (settled - contact) * s["tick_s"]
        n["settling_in_tail_s"] = max(0, settled - begin) * s["tick_s"]
    if velocity.shape[0] > 0:
        n["impact_velocity"] = velocity[contact]
        return
    span = min(contact, s["impact_ticks"])
    if span >= _IMPACT_TICKS:
        n["impact_velocity"] = _end_slope(position, contact - span, contact) / s["tick_s"]


@kernel(types.void(NUMBERS_TYPE, types.int64), no_refcount=True)
def _write_nothing(numbers: Records, ticks: int) -> None:
    n = numbers[0]
    n["felt"] = n["contact_s"] = n["impact_velocity"] = n["settling_s"] = math.nan
    n["felt_floor"] = n["heard"] = n["moved"] = n["growth"] = 0.0
    n["exits_in_tail"] = n["exits"] = n["late_ticks"] = n["gaps"] = n["lost_samples"] = n["longest_gap"] = 0
    n["peak_penetration"] = n["resting_penetration"] = n["peak_effort"] = 0.0
    n["saturated_fraction"] = n["saturated_fraction_in_tail"] = 0.0
    n["late_fraction"] = n["lost_fraction"] = 0.0
    n["ticks"] = ticks
    n["slew_bound_ticks"] = n["overruled_ticks"] = n["inside_ticks_in_tail"] = n["stay_ticks"] = 0
    n["current_observed"] = n["current_differs"] = n["other_current_ticks"] = n["toggles"] = 0
    n["heard_in_stay"] = n["moved_in_stay"] = 0.0
    n["tail_begins_s"], n["settling_in_tail_s"] = math.nan, 0.0


@kernel(
    types.void(*[_SIGNAL] * 4, _FLAGS, SETTINGS_TYPE, SECTIONS_TYPE, _SCRATCH_TYPE, NUMBERS_TYPE),
    no_refcount=True,
)
def measure(
    position: Floats,
    velocity: Floats,
    effort: Floats,
    penetration: Floats,
    flags: Ints,
    settings: Records,
    sections: Floats,
    scratch: Floats,
    numbers: Records,
) -> None:
    """Compute all numbers of one trial, from which `rig.control.verdict` derives the outcome (stable, limit cycle, …).

    Parameters
    ----------
    position, velocity, effort, penetration
        One value for each tick (SI units); if `velocity` is empty, it is derived from `position`.
    flags
        For each tick the bits of `rig.core.sample.RowFlag`, the bit `OVERRULED` (the device did not apply the commanded
        effort), and, from bit `LOST_BITS` on, the number of samples lost just before.
    settings, sections, scratch
        One record of dtype `SETTINGS`, the filters (`Filters.sections`), and `tail_ticks` + `pad_ticks` values to
        overwrite.
    numbers
        One record of dtype `NUMBERS` for the results; all of it is overwritten. For a trial of fewer than
        `FEWEST_TICKS` ticks it gets zeros, and NaN for numbers that cannot be known.
    """
    n = numbers[0]
    ticks = position.shape[0]
    if ticks < FEWEST_TICKS:
        _write_nothing(numbers, ticks)
        return
    left_at = _contact(effort, penetration, settings, numbers)
    _marks(flags, settings, numbers)
    s = settings[0]
    n["heard_in_stay"] = n["moved_in_stay"] = 0.0
    if n["stay_ticks"] > 0 and n["inside_ticks_in_tail"] == 0:
        n["inside_ticks_in_tail"] = min(left_at, s["tail_ticks"])
        _ripple_and_travel(position[:left_at], effort[:left_at], settings, sections, numbers)
        n["inside_ticks_in_tail"] = 0
    _ripple_and_travel(position, effort, settings, sections, numbers)
    n["felt_floor"], n["felt"], n["toggles"] = 0.0, math.nan, 0
    if s["resolution"] > 0.0:
        if math.isnan(n["contact_s"]):
            n["toggles"] = _toggles(position, s["resolution"])
        toggling_hz = _toggling_hz(position, settings)
        n["felt_floor"] = toggling_floor(toggling_hz, s["resolution"], s["highpass_hz"], s["lowpass_hz"])
    if n["felt_floor"] <= s["felt_velocity"]:
        n["felt"] = _felt(position, velocity, settings, sections, scratch)
    _rest_and_impact(position, velocity, penetration, settings, scratch, numbers)


@group
class MeterArguments(NamedTuple):
    """Filters, memory and settings by which compiled code judges trials, `recorded` by an encoder or `true`."""

    recorded: Annotated[Records, types.Array(numba.from_dtype(SETTINGS), 1, "C")]
    true: Annotated[Records, types.Array(numba.from_dtype(SETTINGS), 1, "C")]
    sections: Annotated[Floats, SECTIONS_TYPE]
    scratch: Annotated[Floats, _SCRATCH_TYPE]


METER_TYPE = type_of(MeterArguments)


class Meter:
    """Filters, settings and work memory to measure any number of trials with the same tick and thresholds.

    Parameters
    ----------
    tick_s
        Tick of the trials (s).
    resolution
        Travel of one count in recorded trials (rad or m); its sign does not matter.
    tail_s
        Length of the last part of a trial, in which ripples are measured (s).
    highpass_hz, lowpass_hz
        Band in which velocity is measured; position and effort are measured above `highpass_hz`.
    felt_velocity
        Threshold of the rms velocity (rad/s or m/s), which is not measured if one toggling count exceeds it.

    Notes
    -----
    Use one object for each thread. Signals are float64 arrays of equal length and any stride: columns of a larger array
    need no copy. `flags` are int64; `measure` explains their bits.
    """

    def __init__(
        self,
        *,
        tick_s: float,
        resolution: float,
        tail_s: float,
        highpass_hz: float,
        lowpass_hz: float,
        felt_velocity: float,
    ) -> None:
        designed = filters(tick_s, highpass_hz, lowpass_hz)
        self._sections = designed.sections
        self._recorded = np.zeros(1, SETTINGS)
        settings = self._recorded[0]
        settings["tick_s"], settings["resolution"] = tick_s, abs(resolution)
        settings["felt_velocity"] = felt_velocity
        settings["highpass_hz"], settings["lowpass_hz"] = highpass_hz, lowpass_hz
        settings["tail_ticks"] = max(1, round(tail_s / tick_s))
        settings["lead_ticks"] = designed.lead_ticks
        settings["pad_ticks"] = round(_PAD_PERIODS / highpass_hz / tick_s)
        settings["impact_ticks"] = max(_IMPACT_TICKS, round(_IMPACT_S / tick_s))
        self._true = self._recorded.copy()
        self._true["resolution"] = 0.0
        self._scratch = np.zeros(int(settings["tail_ticks"] + settings["pad_ticks"]))
        self._numbers = np.zeros(1, NUMBERS)
        self._no_velocity = np.zeros(0)

    def arguments(self) -> MeterArguments:
        """Return filters, settings and work memory as an argument for a kernel that calls `measure` itself."""
        return MeterArguments(
            recorded=self._recorded, true=self._true, sections=self._sections, scratch=self._scratch
        )

    def recorded(
        self,
        position: Floats,
        effort: Floats,
        penetration: Floats,
        flags: Ints,
        velocity: Floats | None = None,
    ) -> np.void:
        """Return the numbers by which a trial is judged (a record of dtype `NUMBERS`), from its recorded signals.

        Without `velocity` (rad/s or m/s) it is derived from `position`.
        """
        derived = self._no_velocity if velocity is None else velocity
        return self._measured(self._recorded, (position, derived, effort, penetration), flags)

    def true(
        self, position: Floats, velocity: Floats, effort: Floats, penetration: Floats, flags: Ints
    ) -> np.void:
        """Return the numbers by which a trial is judged (dtype `NUMBERS`), from a simulation's true signals."""
        return self._measured(self._true, (position, velocity, effort, penetration), flags)

    def _measured(
        self, settings: Records, signals: tuple[Floats, Floats, Floats, Floats], flags: Ints
    ) -> np.void:
        measure(*signals, flags, settings, self._sections, self._scratch, self._numbers)
        record: np.void = self._numbers[0].copy()
        return record
