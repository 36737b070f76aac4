"""Keep the simulated device safe whatever its host sends: watchdog, limits, monitors, fault memory.

The file implements the "Safety duties of the device" of PROTOCOL.md in integer counts, current quanta and device time,
as the firmware does, and must not depend on frames, clocks or the plant.
"""

import math
from collections import namedtuple
from collections.abc import Mapping
from typing import Any

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol.faults import Fault, LimitFlag
from firmware_protocol.messages import TIME_UNIT_NS
from firmware_protocol.packing import FAULT_ENTRY_BYTES, data_limit, pack_fault_entries
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import BY_NAME
from rig.control import current as currents
from rig.control.current import DISAGREES, compare
from rig.core.board import current_sensor, moved_mechanics, over_current
from rig.core.model import RigModel
from rig.realtime.groups import Floats, Ints

UNITS_PER_SECOND = round(1e9 / TIME_UNIT_NS)  # units of device time (1/16 µs)
UNITS_PER_US = UNITS_PER_SECOND // 1_000_000
# Time in which a host must send its first command after ARM, and DISARM after STOP. There is no current meanwhile, so
# it may be long: threads start and files close on a busy machine. It ends because an amplifier should not stay enabled
# for a host that died.
IDLE_LIFETIME_S = 0.5
NO_SLEW_LIMIT = 65_535  # value of slew_limit that means none

# Speed is counted over this window. Shorter, and one count more or less is a large speed (1 count in a 50 µs
# tick is 20 000 counts/s); longer, and a runaway handle has gone far before it is seen.
SPEED_WINDOW_S = 5e-3
NEAR_SPEED = 0.9  # share of speed_limit from which STATE warns
NEAR_EDGE = 0.05  # share of the position window at each end in which STATE warns

FADES_A_SECOND = 2  # full efforts per second by which an effort without encoder motion fades

# A current up to the described friction plus a twentieth of the limit (for unknown friction) need not move an
# automated rig.
LARGEST_SHARE = 5
FRICTION_SHARE = 0.25  # 1/20, times LARGEST_SHARE
STALL_MARGIN = 3.0  # times the longest time in which the free rig passes STALL_COUNTS

# At the budget the current is reduced; heat well above it shows that the reduction does not help.
THERMAL_CUT = 1.25

# Order of faults found in one tick: the first is latched, the others are reported as `later` faults.
GRAVITY = (
    Fault.EMERGENCY_STOP,
    Fault.OVER_CURRENT,
    Fault.CURRENT_MISMATCH,
    Fault.RUNAWAY,
    Fault.OVER_SPEED,
    Fault.POSITION_WINDOW,
    Fault.THERMAL,
)

RING_TICKS = 256  # remembered before a fault

_Places = namedtuple(
    "_Places",
    # the last command, and its ramp to zero
    "wanted expires ramp ramp_from applied ramping lost "
    # limits: active current (quanta), `LimitFlag` bits since they were last cleared, …
    "current flags limit continuous slew confirm fade unmoved low "
    # monitors
    "sign peak peaks zero large stall_ticks driven still pushed ticks slot fastest near_fastest first last near_first "
    "near_last "
    # latched fault, and number of remembered ticks
    "fault remembered",
)
AT: Any = _Places(*range(len(_Places._fields)))  # indices into `Safety.rules`
HEAT, BUDGET, DECAY = range(3)  # indices into `Safety.heat`

_ENTRY_WORDS = 5  # integers of one remembered tick: the values of a `FaultEntry`
_PEAK = 32_767  # largest current in a message (quanta)
_LONGEST_WINDOW = round(BY_NAME["position_rate"].maximum * SPEED_WINDOW_S)
_NEVER = 1 << 62  # a number of ticks, or of quanta, that is not reached
_IDLE_LIFETIME = round(IDLE_LIFETIME_S * UNITS_PER_SECOND)
_PAGE_ENTRIES = data_limit(m.FaultLog) // FAULT_ENTRY_BYTES
_CURRENT, _SLEW, _THERMAL = (int(flag) for flag in (LimitFlag.CURRENT, LimitFlag.SLEW, LimitFlag.THERMAL))
_SPEED, _POSITION = int(LimitFlag.SPEED), int(LimitFlag.POSITION)
_NOT_CONFIRMED = int(LimitFlag.NOT_CONFIRMED)
_RUNAWAY, _OVER_SPEED, _OVER_CURRENT, _MISMATCH, _WINDOW, _TOO_HOT = (
    1 << fault
    for fault in (
        Fault.RUNAWAY,
        Fault.OVER_SPEED,
        Fault.OVER_CURRENT,
        Fault.CURRENT_MISMATCH,
        Fault.POSITION_WINDOW,
        Fault.THERMAL,
    )
)
# What the current sensor shows while the amplifier is off is its zero: a mean over so many ticks, as long as it is
# small. A larger one is a fault of the sensor, and shows as a mismatch once the device is armed.
ZERO_TICKS = 64
ZERO_SHARE = 16  # largest zero: the over-current limit divided by this
_ZERO_UNIT = 256  # parts of a quantum in which the zero is stored


def flat(kind: type, size: int) -> Any:
    """Return `size` zeros of a numpy type as a memory view, which Python reads and writes faster than an array."""
    return memoryview(np.zeros(size, kind))  # type: ignore[arg-type]


# ---------------------------------------------------------------------- which current does the host want?


def idle(rules: Ints, now: int) -> None:
    """Set the wanted current to zero and restart the watchdog with its longer time, as after ARM and after STOP.

    `now` is the device time (1/16 µs), `rules` the memory of watchdog, limits and monitors.
    """
    rules[AT.lost] = 0
    feed(rules, now, 0, _IDLE_LIFETIME, 0)


def feed(rules: Ints, now: int, current: int, lifetime: int, ramp: int) -> None:
    """Store a command's current (quanta); after `lifetime` it falls to zero within `ramp` (all times in 1/16 µs)."""
    rules[AT.wanted] = current
    rules[AT.expires] = now + lifetime
    rules[AT.ramp] = ramp
    rules[AT.applied] = rules[AT.ramping] = 0


def compute_wanted(rules: Ints, until: int) -> int:
    """Return the wanted current (quanta) for a tick that ends at device time `until` (1/16 µs).

    The wanted current is that of the last command while the command is valid; then it falls to zero along a ramp.
    """
    # Effort is held over a tick, so judge at the tick's end: the current is exactly zero when the ramp ends, not a tick
    # later.
    if until <= rules[AT.expires]:
        rules[AT.applied] = 1
        return int(rules[AT.wanted])
    if not rules[AT.ramping]:
        rules[AT.ramping] = 1
        # The ramp begins at the limited current, not at the command: else it would not fall until it reached the limit.
        rules[AT.ramp_from] = rules[AT.current] if rules[AT.applied] else rules[AT.wanted]
    begin, ramp = rules[AT.ramp_from], rules[AT.ramp]
    left = rules[AT.expires] + ramp - until
    if left <= 0:
        rules[AT.lost] = 1
        return 0
    # Rounds towards zero on both sides; Python's // alone rounds a negative current to a larger one.
    return int(begin * left // ramp if begin > 0 else -(-begin * left // ramp))


# ---------------------------------------------------------------------- how much of it may flow?


def warm(heat: Floats, measured: int) -> None:
    """Update the thermal model (I²t) by one tick: a first-order lag of the square of `measured` (current quanta)."""
    heat[HEAT] += (measured * measured - heat[HEAT]) * heat[DECAY]


def is_overheated(heat: Floats) -> bool:
    """Return True if the heat is above 1.25 times its budget (`THERMAL_CUT`): reducing the current did not help."""
    return bool(heat[HEAT] > THERMAL_CUT * heat[BUDGET] > 0.0)


def configure_heat(heat: Floats, continuous_current: float, time_constant_s: float, rate: float) -> None:
    """Set the thermal model's heat budget and decay per tick, for `rate` ticks in a second.

    The budget is the square of `continuous_current` (quanta), the decay follows from the winding's time constant (s).
    """
    # Only the budget changes: a motor does not cool by being configured. The budget is the steady rise under the
    # continuous current, which is its square in these units.
    heat[BUDGET] = float(continuous_current) ** 2
    heat[DECAY] = -math.expm1(-1.0 / (rate * time_constant_s))


def _fade_unconfirmed(rules: Ints, wanted: int) -> int:
    """Return the wanted current (quanta), faded to zero if the encoder shows no motion for longer than `confirm_ms`."""
    # A dead encoder and a hand that holds still look alike on two channels; with one channel dead the other one toggles
    # the count between two neighbours, whatever the handle does. The effort returns after a wanted effort of zero.
    if wanted == 0 or rules[AT.confirm] == 0:
        rules[AT.unmoved] = 0
    faded = rules[AT.unmoved] - rules[AT.confirm]
    if faded <= 0:
        return wanted
    rules[AT.flags] |= _NOT_CONFIRMED
    left = rules[AT.fade] - faded
    if left <= 0:
        return 0
    return int(wanted * left // rules[AT.fade] if wanted > 0 else -(-wanted * left // rules[AT.fade]))


def limit_current(rules: Ints, heat: Floats, wanted: int) -> int:
    """Limit the wanted current, make the result the active current, and return it (quanta).

    Limits act in this order: fade without encoder motion, current limit, thermal model, slew limit.
    """
    limit, continuous, slew = rules[AT.limit], rules[AT.continuous], rules[AT.slew]
    current = _fade_unconfirmed(rules, wanted)
    if not -limit <= current <= limit:
        current = limit if current > 0 else -limit
        rules[AT.flags] |= _CURRENT
    if heat[HEAT] >= heat[BUDGET] and abs(current) > continuous:
        current = continuous if current > 0 else -continuous
        rules[AT.flags] |= _THERMAL
    # Last, so that the current never jumps, whichever limit acted before.
    change = current - rules[AT.current]
    if not -slew <= change <= slew:
        current = rules[AT.current] + (slew if change > 0 else -slew)
        rules[AT.flags] |= _SLEW
    rules[AT.current] = current
    return current


# ---------------------------------------------------------------------- must the motor be cut?


def remove_zero(rules: Ints, measured: int, off: bool) -> int:
    """Return the measured current minus the sensor's zero (quanta); adapt the zero while the amplifier is `off`."""
    if off:
        step = measured * _ZERO_UNIT - rules[AT.zero]
        step = step // ZERO_TICKS if step > 0 else -(-step // ZERO_TICKS)
        most = rules[AT.peak] * _ZERO_UNIT // ZERO_SHARE
        rules[AT.zero] = min(max(rules[AT.zero] + step, -most), most)
    size = (abs(rules[AT.zero]) + _ZERO_UNIT // 2) // _ZERO_UNIT
    current = measured - (size if rules[AT.zero] > 0 else -size)
    return int(min(max(current, -_PEAK), _PEAK))


def check(
    rules: Ints, heat: Floats, counts: Ints, currents: Ints, count: int, current: int, measured: int
) -> int:
    """Run the safety monitors on one tick; return the detected faults as bits ``1 << code``.

    `count` is the encoder count at the end of the tick, `current` and `measured` are active and measured current
    (quanta).
    """
    slot, ticks = rules[AT.slot], rules[AT.ticks]
    moved = count - counts[slot]
    counts[slot] = count
    left = not 0 <= count - rules[AT.low] <= 1  # outside of the two neighbouring counts
    if left:
        rules[AT.low] = count if count < rules[AT.low] else count - 1
    rules[AT.unmoved] = 0 if left and rules[AT.unmoved] <= rules[AT.confirm] else rules[AT.unmoved] + 1
    rules[AT.slot] = slot + 1 if slot + 1 < ticks else 0
    faults = _runaway(rules, current, moved, not left)
    if abs(moved) > rules[AT.near_fastest]:
        rules[AT.flags] |= _SPEED
        if abs(moved) > rules[AT.fastest]:
            faults |= _OVER_SPEED
            # Too fast after a whole window of effort along the motion: the motor drives it. Else a hand does.
            if rules[AT.driven] >= ticks:
                faults |= _RUNAWAY
    if not rules[AT.near_first] <= count <= rules[AT.near_last]:
        rules[AT.flags] |= _POSITION
        if not is_in_window(rules, count):
            faults |= _WINDOW
    high = 1 if abs(measured) > rules[AT.peak] else 0
    # Two of three samples: a single one is a spike of the converter.
    if high + (rules[AT.peaks] & 1) + (rules[AT.peaks] >> 1) >= 2:
        faults |= _OVER_CURRENT
    rules[AT.peaks] = (rules[AT.peaks] << 1 | high) & 3
    if compare(currents, count, current, measured) == DISAGREES:
        faults |= _MISMATCH
    if is_overheated(heat):
        faults |= _TOO_HOT
    return faults


def is_in_window(rules: Ints, count: int) -> bool:
    """Return True if an encoder count lies in the position window."""
    return bool(rules[AT.first] <= count <= rules[AT.last])


def _runaway(rules: Ints, current: int, moved: int, stood: bool) -> int:
    """Return the fault bit of a runaway motor if a large effort has lasted too long without encoder motion, else 0.

    `current` is the active current (quanta), `moved` the change of the count in the window of the speed check, and
    `stood` is True if the count stayed on two neighbouring values.
    """
    # LARGEST_SHARE times the threshold in whole quanta: no rounding, as in the firmware.
    if LARGEST_SHARE * abs(current) <= rules[AT.large]:
        rules[AT.driven] = rules[AT.still] = 0
        return 0
    push = 1 if current > 0 else -1
    # For the speed check: ticks of large effort in the direction of motion.
    rules[AT.driven] = rules[AT.driven] + 1 if push * rules[AT.sign] * moved > 0 else 0
    # Two neighbouring counts, not one: an encoder with a dead channel shows any motion as that.
    # A push whose sign alternates drives the handle nowhere: counting begins anew.
    rules[AT.still] = rules[AT.still] + 1 if stood and push == rules[AT.pushed] else 0
    rules[AT.pushed] = push
    return _RUNAWAY if rules[AT.still] > rules[AT.stall_ticks] else 0


class Safety:
    """Memory and settings of the device's watchdog, limits and monitors.

    Parameters
    ----------
    model
        Rig to monitor: direction of counting, peak current of the amplifier, mechanics.

    Attributes
    ----------
    rules
        Integers of watchdog, limits and monitors, at the indices that the named tuple `AT` contains.
    heat
        Thermal model: heat and budget (quanta²), and decay for each tick (a ratio), at `HEAT`, `BUDGET`, `DECAY`.
    counts
        Encoder counts in the window of the speed check, a ring buffer.
    currents
        Memory of the comparison of commanded and measured current (`rig.control.current`).
    """

    def __init__(self, model: RigModel) -> None:
        self.rules, self.heat = flat(np.int64, len(AT)), flat(np.float64, 3)
        self.counts = flat(np.int64, _LONGEST_WINDOW)
        self.currents = flat(np.int64, currents.WORDS)
        self._model = model
        self.rules[AT.sign], self.rules[AT.peak] = model.encoder.sign, over_current(model)
        self.rules[AT.ticks] = 1

    def configure(self, values: Mapping[str, Value], count: int) -> None:
        """Set limits and thresholds from parameters by name; the speed check begins at the encoder count `count`."""
        rules, rate = self.rules, int(values["position_rate"])
        configure_heat(self.heat, values["continuous_current"], values["thermal_time_constant"], rate)
        rules[AT.limit] = int(values["current_limit"])
        rules[AT.continuous] = int(values["continuous_current"])
        slew = int(values["slew_limit"])
        rules[AT.slew] = _NEVER if slew == NO_SLEW_LIMIT else slew
        rules[AT.confirm] = int(values["confirm_ms"]) * rate // 1000
        rules[AT.fade] = rate // FADES_A_SECOND
        ticks = rules[AT.ticks] = max(1, round(rate * SPEED_WINDOW_S))
        travel = values["speed_limit"] * ticks / rate
        rules[AT.fastest] = math.floor(travel + 1.0)  # the ends of the window may lie anywhere in their cells
        rules[AT.near_fastest] = math.floor(NEAR_SPEED * travel + 1.0)
        first, last = int(values["window_minimum"]), int(values["window_maximum"])
        margin = NEAR_EDGE * (last - first)
        rules[AT.first], rules[AT.last] = first, last
        rules[AT.near_first], rules[AT.near_last] = math.ceil(first + margin), math.floor(last - margin)
        rules[AT.large] = large_effort(self._model, int(values["current_limit"]))
        stall_s = (
            math.inf if values["hold_to_run"] else stall_time(self._model, rules[AT.large] / LARGEST_SHARE)
        )
        rules[AT.stall_ticks] = math.ceil(stall_s * rate) if stall_s < math.inf else _NEVER
        for slot in range(ticks):
            self.counts[slot] = count
        rules[AT.slot] = 0
        currents.configure(self.currents, current_sensor(self._model), rate, self._model.encoder.sign)
        self.forget()

    def forget(self) -> None:
        """Restart the checks of motion and currents for a new session."""
        rules = self.rules
        rules[AT.driven] = rules[AT.still] = rules[AT.pushed] = rules[AT.peaks] = rules[AT.unmoved] = 0
        currents.forget(self.currents)


# ---------------------------------------------------------------------- what went wrong first, and before it?


def remember(
    rules: Ints, ring: Ints, index: int, count: int, current: int, measured: int, flags: int
) -> None:
    """Append a tick (the values of a `FaultEntry`) to the ring buffer, unless a latched fault has frozen the buffer."""
    # Frozen at the first fault: what came before it is worth more than what followed.
    if rules[AT.fault] == 0:
        at = rules[AT.remembered] % RING_TICKS * _ENTRY_WORDS
        ring[at], ring[at + 1], ring[at + 2] = index, count, current
        ring[at + 3], ring[at + 4] = measured, flags
        rules[AT.remembered] += 1


class FaultMemory:
    """Memory of the latched fault, of later faults, and of the last ticks before the first fault.

    Parameters
    ----------
    rules
        Integers of all limits and monitors (`Safety.rules`); they contain the latched fault, which each tick reads.
    """

    def __init__(self, rules: Ints) -> None:
        self.ring = flat(np.int64, RING_TICKS * _ENTRY_WORDS)
        self._rules = rules
        self.forget()

    def forget(self) -> None:
        """Clear all faults and remembered ticks, as after a reset of the device."""
        self.clear()
        self._rules[AT.remembered] = 0
        self._first = Fault.NONE
        self._later = 0
        self._time = 0
        self._frozen: list[m.FaultEntry] = []

    @property
    def latched(self) -> Fault:
        """Return the first fault since the last clear, or NONE."""
        return Fault(self._rules[AT.fault])

    def latch(self, faults: int, time: int) -> None:
        """Record faults (bits ``1 << code``) at device time `time` (1/16 µs).

        If no fault was latched, latch the gravest and store the ticks before it for the fault log.
        """
        if not self.latched:
            self._first = _gravest(faults)
            self._rules[AT.fault] = self._first
            self._later = 0
            self._time = time
            end = self._rules[AT.remembered]
            ring = np.asarray(self.ring).reshape(RING_TICKS, _ENTRY_WORDS)
            rows = np.arange(max(0, end - RING_TICKS), end) % RING_TICKS
            self._frozen = [m.FaultEntry(*entry) for entry in ring[rows].tolist()]
        self._later |= faults & ~(1 << self._first)

    def clear(self) -> None:
        """Clear the latched fault. Its log can still be read until the next fault."""
        self._rules[AT.fault] = Fault.NONE

    def page(self, request: m.GetFaultLog) -> m.FaultLog:
        """Return the reply to a GET_FAULT_LOG: the requested page of the fault log."""
        entries = self._frozen[request.first : request.first + _PAGE_ENTRIES]
        return m.FaultLog(
            request.nonce,
            self._first,
            self._later,
            self._time,
            len(self._frozen),
            request.first,
            pack_fault_entries(entries),
        )


def _gravest(faults: int) -> Fault:
    """Return the gravest of the faults (bits ``1 << code``) by `GRAVITY`, else the fault with the lowest code."""
    for fault in GRAVITY:
        if faults & 1 << fault:
            return fault
    return Fault((faults & -faults).bit_length() - 1)


def large_effort(model: RigModel, limit: int) -> int:
    """Return the current (quanta) above which a rig must show motion, times 5 (`LARGEST_SHARE`) to avoid rounding.

    `limit` is the parameter `current_limit` (quanta).
    """
    mechanics = moved_mechanics(model)
    large = LARGEST_SHARE * mechanics.friction / mechanics.effort_quantum + FRICTION_SHARE * limit
    return min(int(large), LARGEST_SHARE * limit)


def stall_time(model: RigModel, current: float) -> float:
    """Return the time (s) within which a steady current (quanta) must move a free rig by one encoder edge; ∞ if never.

    The effort minus friction and weight moves the whole inertia by two counts; viscous damping and electrical lag add
    to the time. Do not use the result with `hold_to_run`: a person may hold the handle still.
    """
    mechanics = moved_mechanics(model)
    effort = min(current * mechanics.effort_quantum, mechanics.effort_limit) - mechanics.friction
    if effort <= 0.0:
        return math.inf
    without_damping_s = math.sqrt(2.0 * mechanics.inertia * mechanics.travel / effort)
    moving_s = without_damping_s + mechanics.travel * mechanics.damping / effort + mechanics.lag_s
    return max(STALL_MARGIN * moving_s, SPEED_WINDOW_S)
