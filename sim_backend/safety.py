"""What keeps the simulated device safe whatever its host does: watchdog, limits, monitors.

One object for each question of a tick. `Watchdog`: which current does the host want, now that it has been silent
for so long? `Limits`: how much of that may flow? `Monitor`: does the motion that follows mean that the motor must
be cut? `FaultMemory`: what was the first thing to go wrong, and what happened before it?

All of it is integer counts, current quanta and device time, as in a firmware; `device` calls it, and nothing
here knows a frame, a clock or the plant.

It mirrors the safety rules of DESIGN.md ("Safety on the device"), which hold for every device.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

from firmware_protocol import messages as m
from firmware_protocol.faults import Fault, LimitFlag
from firmware_protocol.messages import TIME_UNIT_NS
from firmware_protocol.packing import FAULT_ENTRY_BYTES, data_limit, pack_fault_entries
from firmware_protocol.parameter import Value
from rig.core.board import OVER_CURRENT_MARGIN, STALL_COUNTS
from rig.core.model import RigModel

UNITS_PER_SECOND = round(1e9 / TIME_UNIT_NS)  # of device time
UNITS_PER_US = UNITS_PER_SECOND // 1_000_000
# What a host has to send its first command after ARM, and to disarm after STOP. There is no current meanwhile, so it
# may be long: threads start and files close on a busy machine. It ends because an amplifier should not stay enabled
# for a host that died.
IDLE_LIFETIME_S = 0.5
NO_SLEW_LIMIT = 65_535  # value of slew_limit that means none

# Speed is counted over this window. Shorter, and one count more or less is a large speed (1 count in a 50 µs
# tick is 20 000 counts/s); longer, and a runaway handle has gone far before it is seen.
SPEED_WINDOW_S = 5e-3
NEAR_SPEED = 0.9  # share of speed_limit from which STATE warns
NEAR_EDGE = 0.05  # share of the position window at each end in which STATE warns

# A motor that follows its own sign error accelerates under most of its current. Below a fifth of the limit an
# automated rig may rest in friction, and a handle may be thrown along the effort by a person.
RUNAWAY_SHARE = 0.2
STALL_MARGIN = 3.0  # times the longest time in which the free rig passes STALL_COUNTS

# At the budget the current is reduced; heat well above it shows that the reduction does not help.
THERMAL_CUT = 1.25

# Faults found in one tick, gravest first: the first of them is latched, the others go into the mask.
GRAVITY = (
    Fault.EMERGENCY_STOP,
    Fault.OVER_CURRENT,
    Fault.RUNAWAY,
    Fault.OVER_SPEED,
    Fault.POSITION_WINDOW,
    Fault.THERMAL,
)

RING_TICKS = 256
Entry = tuple[int, int, int, int, int]  # sample index, count, current commanded, current measured, limits

_NEVER = 1 << 62
_IDLE_LIFETIME = round(IDLE_LIFETIME_S * UNITS_PER_SECOND)
_PAGE_ENTRIES = data_limit(m.FaultLog) // FAULT_ENTRY_BYTES
_CURRENT, _SLEW, _THERMAL = (int(flag) for flag in (LimitFlag.CURRENT, LimitFlag.SLEW, LimitFlag.THERMAL))
_SPEED, _POSITION = int(LimitFlag.SPEED), int(LimitFlag.POSITION)
_RUNAWAY, _OVER_SPEED, _OVER_CURRENT, _WINDOW, _TOO_HOT = (
    1 << fault
    for fault in (Fault.RUNAWAY, Fault.OVER_SPEED, Fault.OVER_CURRENT, Fault.POSITION_WINDOW, Fault.THERMAL)
)


class Watchdog:
    """The active command, and how it fades once its lifetime is over.

    Effort is held over a tick, so everything is judged at the tick's end: the current is exactly zero when the
    ramp ends, not a tick later.

    Attributes
    ----------
    ramping
        The lifetime is over and the current is being ramped.
    lost
        The ramp has ended: latch LINK_LOST.
    """

    __slots__ = ("_applied", "_current", "_expires", "_from", "_ramp", "lost", "ramping")

    def __init__(self) -> None:
        self._from = 0
        self.idle(0)

    def idle(self, now: int) -> None:
        """Want no current, and wait for the host's next command: after ARM, after STOP."""
        self.lost = False
        self.feed(now, 0, _IDLE_LIFETIME, 0)

    def feed(self, now: int, current: int, lifetime: int, ramp: int) -> None:
        """Take a valid command: current in quanta, times in device time."""
        self._current = current
        self._expires = now + lifetime
        self._ramp = ramp
        self._applied = self.ramping = False

    def wanted(self, until: int, active: int) -> int:
        """Return the current for a tick that ends at `until`, when `active` flowed in the last one.

        The ramp begins at what the limits left of the command, so that it falls in every tick.
        """
        if until <= self._expires:
            self._applied = True
            return self._current
        if not self.ramping:
            self.ramping = True
            self._from = active if self._applied else self._current
        left = self._expires + self._ramp - until
        if left <= 0:
            self.lost = True
            return 0
        return self._from * left // self._ramp if self._from > 0 else -(-self._from * left // self._ramp)


class Thermal:
    """I²t: the winding's temperature rise as a first-order lag of the squared current, in units of quanta².

    `continuous_current` squared, the rise that this current gives in the end, is the budget. A motor does not cool
    by being configured: only the budget changes then.
    """

    __slots__ = ("_decay", "budget", "heat")

    def __init__(self) -> None:
        self.heat = 0.0
        self.budget = 0.0
        self._decay = 0.0

    def configure(self, continuous_current: float, time_constant_s: float, rate: float) -> None:
        """Set the budget, and the lag for `rate` ticks a second."""
        self.budget = float(continuous_current) ** 2
        self._decay = -math.expm1(-1.0 / (rate * time_constant_s))

    def update(self, measured: int) -> None:
        """Let one tick of the measured current pass."""
        self.heat += (measured * measured - self.heat) * self._decay

    @property
    def overheated(self) -> bool:
        """Whether the heat is so far above the budget that reducing the current has failed."""
        return self.heat > THERMAL_CUT * self.budget > 0.0


class Limits:
    """How much of a wanted current may flow: current limit, thermal model, slew limit, in this order.

    Attributes
    ----------
    current
        Active current (quanta).
    flags
        `LimitFlag` bits that acted since they were last cleared.
    """

    __slots__ = ("_continuous", "_limit", "_slew", "_thermal", "current", "flags")

    def __init__(self, thermal: Thermal) -> None:
        self.current = 0
        self.flags = 0
        self._thermal = thermal
        self._limit = self._continuous = self._slew = 0

    def configure(self, values: Mapping[str, Value]) -> None:
        """Take the limits out of a parameter block."""
        self._limit = int(values["current_limit"])
        self._continuous = int(values["continuous_current"])
        slew = int(values["slew_limit"])
        self._slew = _NEVER if slew == NO_SLEW_LIMIT else slew

    def apply(self, wanted: int) -> int:
        """Put into force what is allowed of a current, and return it."""
        limit = self._limit
        current = wanted
        if not -limit <= current <= limit:
            current = limit if current > 0 else -limit
            self.flags |= _CURRENT
        thermal = self._thermal
        if thermal.heat >= thermal.budget and abs(current) > self._continuous:
            current = self._continuous if current > 0 else -self._continuous
            self.flags |= _THERMAL
        change = current - self.current
        if not -self._slew <= change <= self._slew:
            current = self.current + (self._slew if change > 0 else -self._slew)
            self.flags |= _SLEW
        self.current = current
        return current

    def cut(self) -> None:
        """Zero at once, regardless of the slew limit."""
        self.current = 0


class Monitor:
    """Faults that the motion shows: over-speed, position window, runaway, over-current, heat.

    Parameters
    ----------
    model
        What the board knows of its rig: direction of counting, the amplifier's peak, and what must move how fast.
    thermal
        The motor's heat.
    """

    def __init__(self, model: RigModel, thermal: Thermal) -> None:
        self.flags = 0
        self._model = model
        self._sign = model.encoder.sign
        self._peak = OVER_CURRENT_MARGIN * model.amplifier.effort_limit / model.amplifier.effort_quantum
        self._thermal = thermal
        self._counts = [0]
        self._slot = 0
        self._driven = self._still = self._pushed = 0
        self._fastest = self._near_fastest = self._large = 0.0
        self._stall_ticks = _NEVER
        self._first = self._last = 0
        self._near_first = self._near_last = 0.0

    def configure(self, values: Mapping[str, Value], count: int) -> None:
        """Take the limits out of a parameter block and begin to watch at `count`."""
        rate = int(values["position_rate"])
        ticks = max(1, round(rate * SPEED_WINDOW_S))
        travel = values["speed_limit"] * ticks / rate
        self._fastest = travel + 1.0  # the ends of the window may each lie anywhere in their cells
        self._near_fastest = NEAR_SPEED * travel + 1.0
        self._first, self._last = int(values["window_minimum"]), int(values["window_maximum"])
        margin = NEAR_EDGE * (self._last - self._first)
        self._near_first, self._near_last = self._first + margin, self._last - margin
        self._large = RUNAWAY_SHARE * values["current_limit"]
        stall_s = math.inf if values["hold_to_run"] else stall_time(self._model, self._large)
        self._stall_ticks = math.ceil(stall_s * rate) if stall_s < math.inf else _NEVER
        self._counts = [count] * ticks
        self._slot = 0
        self.forget()

    def forget(self) -> None:
        """Restart the runaway check: another session."""
        self._driven = self._still = self._pushed = 0

    def in_window(self, count: int) -> bool:
        """Whether a count lies in the position window."""
        return self._first <= count <= self._last

    def check(self, count: int, current: int, measured: int) -> int:
        """Judge one tick: the count at its end, active current and measured. Return the faults as bits 1 << code."""
        counts, slot = self._counts, self._slot
        moved = count - counts[slot]
        stood = count == counts[slot - 1]
        counts[slot] = count
        self._slot = slot + 1 if slot + 1 < len(counts) else 0
        faults = self._runaway(current, moved, stood)
        if not -self._near_fastest <= moved <= self._near_fastest:
            self.flags |= _SPEED
            if abs(moved) > self._fastest:
                faults |= _OVER_SPEED
                if self._driven >= len(counts):
                    faults |= _RUNAWAY
        if not self._near_first <= count <= self._near_last:
            self.flags |= _POSITION
            if not self._first <= count <= self._last:
                faults |= _WINDOW
        if not -self._peak <= measured <= self._peak:
            faults |= _OVER_CURRENT
        if self._thermal.overheated:
            faults |= _TOO_HOT
        return faults

    def _runaway(self, current: int, moved: int, stood: bool) -> int:
        """Count the ticks of large effort along the motion, and those without any; say when the latter are too many."""
        if -self._large <= current <= self._large:
            self._driven = self._still = 0
            return 0
        push = 1 if current > 0 else -1
        self._driven = self._driven + 1 if push * self._sign * moved > 0 else 0
        self._still = self._still + 1 if stood and push == self._pushed else 0
        self._pushed = push
        return _RUNAWAY if self._still > self._stall_ticks else 0


class FaultMemory:
    """The fault that is latched, those that came later, and the ticks before the first.

    Attributes
    ----------
    latched
        First fault since the last clear, or NONE.
    """

    def __init__(self) -> None:
        self.latched = Fault.NONE
        self._first = Fault.NONE
        self._later = 0
        self._time = 0
        self._ring: deque[Entry] = deque(maxlen=RING_TICKS)
        self._frozen: list[Entry] = []

    def remember(self, entry: Entry) -> None:
        """Put a tick (the values of a `FaultEntry`) into the ring, unless it is frozen."""
        if not self.latched:
            self._ring.append(entry)

    def latch(self, faults: int, time: int) -> None:
        """Take faults as bits ``1 << code``. The gravest is the first, if there is none yet: the ring freezes."""
        if not self.latched:
            self.latched = self._first = _gravest(faults)
            self._later = 0
            self._time = time
            self._frozen = list(self._ring)
        self._later |= faults & ~(1 << self._first)

    def clear(self) -> None:
        """Let go of the fault; what was frozen can still be read, until the next one."""
        self.latched = Fault.NONE

    def page(self, request: m.GetFaultLog) -> m.FaultLog:
        """Answer a request for the log."""
        entries = [
            m.FaultEntry(*entry) for entry in self._frozen[request.first : request.first + _PAGE_ENTRIES]
        ]
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
    """Return the first of the faults in `GRAVITY`, else the one with the lowest code."""
    for fault in GRAVITY:
        if faults & 1 << fault:
            return fault
    return Fault((faults & -faults).bit_length() - 1)


def stall_time(model: RigModel, current: float) -> float:
    """Time (s) after which a free rig under a steady current (quanta) must have shown an encoder edge; ∞ if never.

    Friction and weight are taken off the effort, then the whole inertia is moved by `STALL_COUNTS`; viscous and
    electrical lag add their times. With `hold_to_run` a person has the handle and can hold it still, so the device
    asks no such question then.
    """
    mechanics, amplifier = model.mechanics, model.amplifier
    friction = mechanics.motor_coulomb + mechanics.link_coulomb + abs(mechanics.gravity_effort)
    effort = min(current * amplifier.effort_quantum, amplifier.effort_limit) - friction
    if effort <= 0.0:
        return math.inf
    travel = STALL_COUNTS * model.encoder.resolution
    inertia = mechanics.motor_inertia + mechanics.loaded_link_inertia
    damping = mechanics.motor_damping + mechanics.link_damping + amplifier.back_emf_damping
    moving_s = math.sqrt(2.0 * inertia * travel / effort) + travel * damping / effort + amplifier.lag_s
    return max(STALL_MARGIN * moving_s, SPEED_WINDOW_S)
