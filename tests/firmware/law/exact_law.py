"""The whole fixed-point law of a device (`law.h`) in exact arithmetic, with the integers of its parameters.

Filter and wall are those of `tests.conformance.fixed_law`; homing, release and slew limit are defined here.
"""

import math
from fractions import Fraction
from typing import Any

from rig.control._fixed_point import Biquad, Format
from rig.core.sample import Phase, RowFlag
from tests.conformance.fixed_law import ExactFilter, clipped, difference

HALF = Fraction(1, 2)
ENDS = RowFlag.NONFINITE | RowFlag.OUT_OF_WINDOW | RowFlag.HOMING_FAILED


def clamp(value: Any, limit: Any) -> Any:
    return sorted((-limit, value, limit))[1]


class ExactLaw:
    """One run of the law: call `tick` with a count and the elapsed ticks."""

    def __init__(self, parameters: Any) -> None:
        self.p, self.w = parameters, parameters.fixed_wall
        b = parameters.biquad
        self.filter = ExactFilter(
            Biquad(
                b.b0, b.b1, b.b2, b.a1, b.a2, b.coefficient_bits, Format(b.word_bits, b.state_bits), b.rounding,
                dc_gain=1.0, dead_zone=0.0,
            )
        )  # fmt: skip
        self.index = self.period = -1
        self.velocity = self.phase_ticks = self.rest_ticks = self.setpoint = self.contact_ticks = 0
        self.limited = Fraction(0)  # quanta, in steps of 2^-15
        self.phase, self.flags = Phase.WAIT, RowFlag(0)

    def tick(self, count: int, elapsed: int = 1) -> tuple[int, int, int]:
        """Return current (quanta), flags and phase."""
        p, w = self.p, self.w
        self.flags = RowFlag(0)
        self.index += elapsed
        travel = p.sense * difference(count, p.reference)
        depth = clipped(w.side * travel * 256 - w.surface, 32)
        if depth > 0:
            self.flags |= RowFlag.INSIDE
        slow = abs(self.velocity) < w.slow_speed and self.period >= 0
        if self.index >= (self.period + (p.slow_multiple if slow else 1)) * p.velocity_divider:
            periods = self.index // p.velocity_divider - self.period
            self.period += periods
            self.velocity = self.filter.velocity(count, periods)
            self.flags |= RowFlag.VELOCITY_UPDATED
        self._advance(travel, depth, elapsed)
        wanted = self._unlimited_effort(travel, depth, elapsed)
        out = not p.window_minimum <= travel <= p.window_maximum or abs(self.velocity) > w.speed_limit
        if out:
            self.flags |= RowFlag.OUT_OF_WINDOW
        if self.flags & ENDS:
            self.phase, self.limited = Phase.DONE, Fraction(0)
            return 0, int(self.flags), int(self.phase)
        wanted = Fraction(clipped(math.floor(wanted * 2**15), 32), 2**15)
        if abs(wanted) > p.current_limit:
            wanted = clamp(wanted, Fraction(p.current_limit))
            self.flags |= RowFlag.SATURATED
        slew = w.homing_slew if self.phase in (Phase.HOMING, Phase.SETTLE) else w.trial_slew
        step = Fraction(min(slew * elapsed, 2**31 - 1), 2**15)
        bound = self.limited + clamp(wanted - self.limited, step)
        if bound != wanted:
            self.flags |= RowFlag.SLEW_BOUND
        self.limited = bound
        return clamp(math.floor(bound + HALF), p.current_limit), int(self.flags), int(self.phase)

    def _enter(self, phase: Phase) -> None:
        self.phase, self.phase_ticks = phase, 0

    def _advance(self, travel: int, depth: int, elapsed: int) -> None:
        p = self.p
        self.phase_ticks += elapsed
        if self.phase is Phase.WAIT:
            self.setpoint = travel * 2**24
            self._enter(Phase.HOMING)
        elif self.phase in (Phase.HOMING, Phase.SETTLE):
            there = p.home_minimum <= travel <= p.home_maximum and self.setpoint == p.home_target
            self.rest_ticks = self.rest_ticks + elapsed if there else 0
            self.phase = Phase.SETTLE if there else Phase.HOMING
            if there and self.rest_ticks >= p.settle_ticks:
                self._enter(Phase.FREE if p.free_ticks else Phase.TRIAL)
            elif self.phase_ticks > p.home_timeout_ticks:
                self.flags |= RowFlag.HOMING_FAILED
                self._enter(Phase.DONE)
        elif self.phase is Phase.FREE:
            if not p.free_minimum <= travel <= p.free_maximum:
                self._enter(Phase.DONE)
            elif self.phase_ticks >= p.free_ticks:
                self._enter(Phase.TRIAL)
        elif self.phase is Phase.TRIAL:
            if p.hold_ticks and not self.contact_ticks and depth > 0:
                self.contact_ticks = self.phase_ticks
            end = self.contact_ticks + p.hold_ticks if self.contact_ticks else p.trial_ticks
            if self.phase_ticks >= end:
                self._enter(Phase.RELEASE)
        elif self.phase is Phase.RELEASE and self.phase_ticks >= p.release_ticks:
            self._enter(Phase.DONE)

    def _unlimited_effort(self, travel: int, depth: int, elapsed: int) -> Fraction:
        p, w = self.p, self.w
        if self.phase in (Phase.HOMING, Phase.SETTLE):
            self.setpoint += clamp(p.home_target - self.setpoint, p.home_step * min(elapsed, 65535))
            error = clipped(math.floor(Fraction(self.setpoint - travel * 2**24, 2**16)), 32)
            effort = w.home_stiffness * error - w.home_damping * p.sense * self.velocity
            return Fraction(clamp(effort, w.home_effort), 2**w.home_shift)
        if self.phase not in (Phase.TRIAL, Phase.RELEASE):
            return Fraction(0)
        total = w.constant - w.side * self._reaction(depth)
        if self.phase is Phase.RELEASE:
            share = (p.release_ticks - self.phase_ticks) * 2**15 // p.release_ticks
            total = total * share // 2**15
        return Fraction(total, 2**w.shift)

    def _reaction(self, depth: int) -> int:
        p, w = self.p, self.w
        inwards = w.direction * self.velocity
        if not p.bilateral and depth <= 0:
            return 0
        if not p.bilateral and p.entry_only:
            inwards = max(inwards, 0)
        total = w.stiffness * depth + w.damping * inwards
        if total < 0 and not p.may_pull and not p.bilateral:
            self.flags |= RowFlag.CLAMPED
            return 0
        return int(total)
