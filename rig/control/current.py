"""Compare measured and set current of the motor, to detect a loose lead, a dead amplifier, or a wrong sign or scale.

The expected current is the active set-point after delay and lag of the amplifier. The magnitude of the residual
(measured minus expected) is summed over `WINDOW_S`, without its largest value. At the end of each window the sum is
compared with a threshold, the larger of `SIGMAS` of the sensor's noise and a tenth of the expected current:

* above the threshold the currents *disagree*;
* below it they *agree* if a motor without current would have exceeded it; otherwise the current was *not observed*.

The simulated device and the host's loops (simulated and real time) use it; firmware has the same in `core/current.c`.
It must not use floating point or allocate in a tick. Change it only together with the firmware, so that both give the
same results.

Source: R·i + L·i′ = V − k_e·ω, and a current loop as a first-order lag; the thresholds are set by this project;
`rig/docs/explanation/verdicts.md` has the resulting rates of false alarms and of detection.
"""

import math
from collections import namedtuple
from typing import Any

from rig.core.current_sensor import SPEED_LAG_S, CurrentSensor
from rig.realtime.groups import Ints
from rig.realtime.kernel import rule

WINDOW_S = 10e-3
FEWEST_TICKS = 4
SLOTS = 33  # of the delay line; where twice the delay is more ticks, each slot holds the extremes of several
SIGMAS = 4.0
SHARE = 10  # of the expected current: one in so many

AGREES, DISAGREES = 1, 2

_Places = namedtuple(
    "_Places",
    # Settings. decay, speed_decay: share of its input that a lag follows in a tick (1/65536). back_emf: current for one
    # count a tick (1/256 quantum); sign: the direction in which it acts. ticks, noise: length of a window, and the sum
    # of residuals in it that is noise. late: share of a linear change within a tick that a lag has not followed at its
    # end (1/65536). quick_decay, slow_decay: decay for half and for twice the lag. stride: ticks of a slot of the delay
    # line. first, middle, last: slots by which half the delay, the delay and twice the delay reach back. delayed: ticks
    # that twice the delay lasts.
    "decay speed_decay back_emf sign ticks noise late quick_decay slow_decay stride first middle last delayed "
    # Memory (1/16384 quantum). expected: current behind the lag, without back-EMF. quick_low … slow_high: lowest and
    # highest current of all delays, behind half the lag and behind twice the lag. count, known: last encoder count, and
    # how many counts are known (0, 1 or more). newest, filled: newest slot of the delay line, and ticks in it. awaited:
    # ticks until the active current of each delay is known.
    "expected quick_low quick_high slow_low slow_high count known newest filled awaited "
    # Memory with back-EMF. speed, moved: speed, and the same behind the lag (1/16384 count a tick). left, before:
    # residual, smoothed and not. smooth: expected current, smoothed. quick_low_left … slow_high_left: differences of
    # the four bounds from the expected current, smoothed.
    "speed moved left before smooth quick_low_left quick_high_left slow_low_left slow_high_left "
    # Sums of this window (quanta). passed: its ticks so far. difference, dead: residuals, and those of a motor without
    # current. largest, most: the largest residual and expected current; last_…: those of the window before.
    "passed difference largest sum most dead last_largest last_most "
    # Delay line: lowest and highest active current of each slot (quanta), `SLOTS` of each.
    "lowest highest",
)
CURRENT: Any = _Places(*(*range(len(_Places._fields) - 1), len(_Places._fields) - 2 + SLOTS))
WORDS = CURRENT.highest + SLOTS

_HALF = 1 << 15  # of 65536
_UNIT = 1 << 14  # units of a current in memory for one quantum
_MOST = 32767 * _UNIT
_COUNT = 1 << 14  # units of a speed in memory for one count a tick
_MOST_COUNTS = 32767  # largest speed (counts a tick)
_UNOBSERVED = 2**32 - 1


def configure(words: Ints, sensor: CurrentSensor, rate: int, encoder_sign: int) -> None:
    """Initialise the memory of the comparison of currents: `words`, `WORDS` integers, each at its index in `CURRENT`.

    `rate` is the number of ticks a second, `encoder_sign` 1 if counts rise with the position and −1 if they fall.
    """
    words[CURRENT.decay] = _share_of(sensor.lag_s, rate)
    words[CURRENT.speed_decay] = _share_of(SPEED_LAG_S, rate)
    words[CURRENT.back_emf] = min(math.floor(sensor.back_emf * rate * 256.0 + 0.5), 2**31 - 1)
    words[CURRENT.sign] = encoder_sign
    words[CURRENT.late] = _late_part(sensor.lag_s, rate)
    words[CURRENT.quick_decay] = _share_of(0.5 * sensor.lag_s, rate)
    words[CURRENT.slow_decay] = _share_of(2.0 * sensor.lag_s, rate)
    ticks = words[CURRENT.ticks] = max(FEWEST_TICKS, math.floor(rate * WINDOW_S))
    noise = math.ceil(SIGMAS * sensor.noise * ticks) if sensor.noise >= 0.0 else _UNOBSERVED
    words[CURRENT.noise] = min(noise, _UNOBSERVED)
    _configure_delay(words, sensor.delay_s * rate)
    _begin_at(words, 0)
    forget(words)


def _configure_delay(words: Ints, ticks: float) -> None:
    delayed = words[CURRENT.delayed] = math.ceil(2.0 * ticks - 1e-9)
    stride = words[CURRENT.stride] = max(1, -(-delayed // (SLOTS - 1)))
    words[CURRENT.first] = math.floor(0.5 * ticks + 1e-9) // stride
    words[CURRENT.middle] = math.ceil(ticks - 1e-9) // stride
    words[CURRENT.last] = -(-delayed // stride)
    words[CURRENT.newest] = 0
    words[CURRENT.filled] = stride
    for slot in range(SLOTS):
        words[CURRENT.lowest + slot] = words[CURRENT.highest + slot] = 0


def _share_of(lag_s: float, rate: int) -> int:
    """Return the part (in 1/65536) of a step that a first-order lag follows within one tick of `rate` (Hz)."""
    return 65536 if lag_s <= 0.0 else math.floor(-math.expm1(-1.0 / (rate * lag_s)) * 65536.0 + 0.5)


def _late_part(lag_s: float, rate: int) -> int:
    """Return the part (in 1/65536) of a linear change in a tick that a first-order lag does not follow by its end."""
    if lag_s <= 0.0:
        return 0
    ticks = lag_s * rate
    return math.floor((ticks + 1.0 / math.expm1(-1.0 / ticks) + 1.0) * 65536.0 + 0.5)


@rule
def _begin_window(words: Ints) -> None:
    smoothed = words[CURRENT.back_emf] != 0
    words[CURRENT.last_largest] = words[CURRENT.largest] if smoothed else 0
    words[CURRENT.last_most] = words[CURRENT.most] if smoothed else 0
    words[CURRENT.passed] = words[CURRENT.difference] = words[CURRENT.largest] = 0
    words[CURRENT.sum] = words[CURRENT.most] = words[CURRENT.dead] = 0


@rule
def _begin_at(words: Ints, current: int) -> None:
    words[CURRENT.expected] = current * _UNIT
    words[CURRENT.quick_low] = words[CURRENT.quick_high] = current * _UNIT
    words[CURRENT.slow_low] = words[CURRENT.slow_high] = current * _UNIT


@rule
def forget(words: Ints) -> None:
    """Start the comparison of measured and set current anew, without the past: at a new session or after a gap."""
    _begin_window(words)
    words[CURRENT.last_largest] = words[CURRENT.last_most] = 0
    words[CURRENT.known] = words[CURRENT.speed] = words[CURRENT.moved] = 0
    words[CURRENT.left] = words[CURRENT.before] = words[CURRENT.smooth] = 0
    words[CURRENT.quick_low_left] = words[CURRENT.quick_high_left] = 0
    words[CURRENT.slow_low_left] = words[CURRENT.slow_high_left] = 0
    # The active currents of before are not known, but still on their way; with back-EMF the first count is needed too.
    words[CURRENT.awaited] = words[CURRENT.delayed] + (1 if words[CURRENT.back_emf] != 0 else 0)


@rule
def resume(words: Ints, measured: int) -> None:
    """Start the comparison of measured and set current anew; the expected current starts at `measured` (quanta)."""
    _begin_at(words, measured)
    forget(words)


@rule
def compare(words: Ints, count: int, active: int, measured: int) -> int:
    """Add a tick to the comparison of currents; at the end of a window, return if measured and expected current agree.

    `active` (quanta) was the set current during the tick; `count` and `measured` (quanta) are encoder count and motor
    current at its end. Return `AGREES` or `DISAGREES`; 0 if the window is not complete or the current was too small.
    """
    if words[CURRENT.noise] == _UNOBSERVED:
        return 0
    # Without a delay the line holds nothing and the highest current is the lowest: the device saves 200 cycles a tick.
    delays = words[CURRENT.delayed] > 0
    if delays:
        _set(words, active)
    if words[CURRENT.awaited] > 0:
        # Count and current of one instant agree at any speed: from here on the residual follows the back-EMF.
        words[CURRENT.count], words[CURRENT.known] = count, 1
        words[CURRENT.awaited] -= 1
        _begin_at(words, measured)
        return 0
    # Lag and delay are known to a factor of two: the expected current is computed for half and twice of both, and only
    # a residual that none of these currents explains counts. Under voltage drive it includes that of the back-EMF.
    low, high, delayed = active * _UNIT, active * _UNIT, active * _UNIT
    if delays:
        low, high, delayed = _extremes(words)
    expected = _follow(words, CURRENT.expected, delayed, words[CURRENT.decay])
    quick_low = quick_high = _follow(words, CURRENT.quick_low, low, words[CURRENT.quick_decay]) - expected
    slow_low = slow_high = _follow(words, CURRENT.slow_low, low, words[CURRENT.slow_decay]) - expected
    if delays:
        quick_high = _follow(words, CURRENT.quick_high, high, words[CURRENT.quick_decay]) - expected
        slow_high = _follow(words, CURRENT.slow_high, high, words[CURRENT.slow_decay]) - expected
    left = measured * _UNIT - expected
    # The largest residual of a window is subtracted at its end: it may be a spike of the converter.
    words[CURRENT.largest] = max(words[CURRENT.largest], _size(left))
    words[CURRENT.most] = max(words[CURRENT.most], _size(expected))
    if words[CURRENT.back_emf] != 0:
        # Residual and back-EMF are smoothed alike, so that motion of any speed is compared with its own back-EMF.
        back_emf = _back_emf(words, count)
        _smooth(words, measured)
        left, expected = words[CURRENT.left] + back_emf, words[CURRENT.smooth] - back_emf
        share = words[CURRENT.speed_decay]
        quick_low = _follow(words, CURRENT.quick_low_left, quick_low, share)
        slow_low = _follow(words, CURRENT.slow_low_left, slow_low, share)
        quick_high = _follow(words, CURRENT.quick_high_left, quick_high, share) if delays else quick_low
        slow_high = _follow(words, CURRENT.slow_high_left, slow_high, share) if delays else slow_low
    low, high = min(0, quick_low, slow_low), max(0, quick_high, slow_high)
    # Magnitudes: a signed sum would average an oscillation away.
    words[CURRENT.difference] += _outside(left, low, high)
    words[CURRENT.dead] += _outside(-expected, low, high)
    words[CURRENT.sum] += _size(expected)
    words[CURRENT.passed] += 1
    if words[CURRENT.passed] < words[CURRENT.ticks]:
        return 0
    total, noise = words[CURRENT.sum], words[CURRENT.noise]
    # A smoothed residual keeps a spike for longer than a window: the largest of the window before may still act.
    difference = words[CURRENT.difference] - max(words[CURRENT.largest], words[CURRENT.last_largest])
    dead = words[CURRENT.dead] - max(words[CURRENT.most], words[CURRENT.last_most])
    _begin_window(words)
    if difference > noise and difference * SHARE > total:
        return DISAGREES
    return AGREES if dead > noise and dead * SHARE > total else 0


@rule
def _set(words: Ints, active: int) -> None:
    if words[CURRENT.filled] >= words[CURRENT.stride]:
        words[CURRENT.filled] = 0
        words[CURRENT.newest] = words[CURRENT.newest] + 1 if words[CURRENT.newest] + 1 < SLOTS else 0
    begins, slot = words[CURRENT.filled] == 0, words[CURRENT.newest]
    words[CURRENT.filled] += 1
    if begins or active < words[CURRENT.lowest + slot]:
        words[CURRENT.lowest + slot] = active
    if begins or active > words[CURRENT.highest + slot]:
        words[CURRENT.highest + slot] = active


@rule
def _slot(words: Ints, back: int) -> int:
    place = words[CURRENT.newest] - back
    return int(place if place >= 0 else place + SLOTS)


@rule
def _extremes(words: Ints) -> tuple[int, int, int]:
    """Return lowest, highest and nominal current over all possible delays (units of 1/16384 current quantum)."""
    slot = _slot(words, words[CURRENT.first])
    # The delay is no whole number of ticks: extremes over whole ticks around half and twice of it.
    low, high = words[CURRENT.lowest + slot], words[CURRENT.highest + slot]
    for _ in range(words[CURRENT.last] - words[CURRENT.first]):
        slot = slot - 1 if slot > 0 else SLOTS - 1
        low, high = min(low, words[CURRENT.lowest + slot]), max(high, words[CURRENT.highest + slot])
    middle = _slot(words, words[CURRENT.middle])
    delayed = (words[CURRENT.lowest + middle] + words[CURRENT.highest + middle]) * (_UNIT // 2)
    return low * _UNIT, high * _UNIT, delayed


@rule
def _back_emf(words: Ints, count: int) -> int:
    """Return the current that the back-EMF takes at the present speed (units of 1/16384 current quantum)."""
    step = min(max(count - words[CURRENT.count], -_MOST_COUNTS), _MOST_COUNTS) * _COUNT
    words[CURRENT.count] = count
    # Smoothed over SPEED_LAG_S, or single counts would be large currents.
    change = _part(step - words[CURRENT.speed], words[CURRENT.speed_decay])
    words[CURRENT.speed] += change
    speed = words[CURRENT.speed] - _part(change, words[CURRENT.late])
    words[CURRENT.moved] += _part(speed - words[CURRENT.moved], words[CURRENT.decay])
    size = abs(words[CURRENT.moved]) * words[CURRENT.back_emf] // 256
    size = min(size, _MOST)
    return int(size if (words[CURRENT.moved] > 0) == (words[CURRENT.sign] > 0) else -size)


@rule
def _smooth(words: Ints, measured: int) -> None:
    left = measured * _UNIT - words[CURRENT.expected]
    # Of a tick's speed it is the middle that follows; in the first tick all of it comes behind the lag.
    share = words[CURRENT.late] if words[CURRENT.known] == 1 else _HALF
    middle = left - _part(left - words[CURRENT.before], share)
    words[CURRENT.before], words[CURRENT.known] = left, 2
    words[CURRENT.left] += _part(middle - words[CURRENT.left], words[CURRENT.speed_decay])
    words[CURRENT.smooth] += _part(
        words[CURRENT.expected] - words[CURRENT.smooth], words[CURRENT.speed_decay]
    )


@rule
def _outside(left: int, low: int, high: int) -> int:
    """Return how far (quanta) the residual current `left` is outside of the range that delay and lag explain."""
    return _size(left - min(max(left, low), high))


@rule
def _size(current: int) -> int:
    """Return a magnitude in units of 1/16384 current quantum as whole quanta, rounded."""
    return (abs(current) + _UNIT // 2) // _UNIT


@rule
def _part(difference: int, share: int) -> int:
    return difference * share >> 16


@rule
def _follow(words: Ints, place: int, before: int, share: int) -> int:
    """Move a lag's output ``words[place]`` towards the input `before` by `share`/65536 of their distance; return it."""
    words[place] += _part(before - words[place], share)
    return int(words[place])
