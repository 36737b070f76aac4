"""Describe the wall that a moteus renders itself, by its mode 13, "stay within", and check the required settings.

Beyond a bound: torque = −kp_scale·kp·(position − bound) − kd_scale·kd·velocity + feed-forward, limited by the command's
maximum torque. The torque is not clamped to pushing, so it pulls a handle that leaves. Source: mjbots/moteus db1a762,
docs/protocol/registers.md 0x000, 0x023, 0x024 and 0x040 to 0x048; docs/protocol/diagnostic.md "d within";
docs/reference/configuration.md servo.pid_position, servo.pwm_rate_hz, pll_filter_hz; fw/bldc_servo_control.h
ISR_DoStayWithinBounds and ISR_DoPositionCommon; fw/pid.h.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

# With a faster PWM the drive runs its control only in every second period (RateConfig of the firmware).
MOST_HZ = 30_000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveLaw:
    """Settings that decide how a moteus renders a wall by itself.

    Attributes
    ----------
    kp, kd
        Gains at the drive's output (N·m/turn, N·m·s/turn).
    pwm_rate_hz
        Frequency of the PWM; the law runs once in each period, or in every second one above 30 kHz.
    filter_hz
        3 dB frequency of the tracking loop (Hz) that computes position and velocity from the encoder.
    sign
        Sign of the drive's controller, which must be 1.
    threshold
        Velocity below which there is no damping (turns/s).
    position_slip, velocity_slip
        Largest distance of the set point from the handle (turns, turns/s); NaN: no limit.
    """

    kp: float
    kd: float
    pwm_rate_hz: float
    filter_hz: float
    sign: float
    threshold: float
    position_slip: float
    velocity_slip: float

    @classmethod
    def read(cls, setting: Callable[[str], float], source: str) -> Self:
        """Read the settings; `setting` returns a value by dotted name, `source` is the encoder's prefix of names."""
        pid = "servo.pid_position"
        return cls(
            kp=setting(f"{pid}.kp"),
            kd=setting(f"{pid}.kd"),
            sign=setting(f"{pid}.sign"),
            pwm_rate_hz=setting("servo.pwm_rate_hz"),
            filter_hz=setting(f"{source}.pll_filter_hz"),
            threshold=setting("servo.velocity_threshold"),
            position_slip=setting("servo.max_position_slip"),
            velocity_slip=setting("servo.max_velocity_slip"),
        )

    @property
    def rate_hz(self) -> float:
        """Rate of the drive's control cycles (Hz)."""
        return self.pwm_rate_hz if self.pwm_rate_hz <= MOST_HZ else self.pwm_rate_hz / 2.0

    @property
    def objection(self) -> str:
        """Reason why the drive would not render the commanded wall; empty if it would."""
        if not (self.kp > 0.0 and self.kd > 0.0):
            return (
                f"servo.pid_position.kp = {self.kp:g} and kd = {self.kd:g}; both must be above 0, "
                "since a wall is a fraction of these gains"
            )
        if self.sign != 1:
            return f"servo.pid_position.sign = {self.sign:g}; it must be 1"
        if not self.filter_hz > 0.0:
            return f"pll_filter_hz = {self.filter_hz:g}; it must be above 0, or the encoder gives no velocity"
        if self.threshold != 0.0:
            return (
                f"servo.velocity_threshold = {self.threshold:g}; it must be 0, or slow motion is not damped"
            )
        if not (math.isnan(self.position_slip) and math.isnan(self.velocity_slip)):
            return "servo.max_position_slip and max_velocity_slip must be nan, or the wall's surface follows the handle"
        return ""

    @property
    def gains(self) -> tuple[float, float] | None:
        """Largest stiffness, damping (N·m/turn, N·m·s/turn) of the drive's own wall; None if it cannot render walls."""
        return None if self.objection else (self.kp, self.kd)

    def describe(self, transmission: float) -> dict[str, int | float | str]:
        """Return the settings that the device reports to a host.

        `transmission` is the angle of the output (rad) for 1 rad or 1 m of the rig.
        """
        scale = transmission**2 / (2.0 * math.pi)
        facts: dict[str, int | float | str] = {"drive_kp": self.kp, "drive_kd": self.kd}
        facts |= {"drive_law_hz": self.rate_hz, "drive_filter_hz": self.filter_hz}
        if self.objection:
            return facts | {"drive_wall": self.objection}
        return facts | {"drive_wall_stiffness": self.kp * scale, "drive_wall_damping": self.kd * scale}
