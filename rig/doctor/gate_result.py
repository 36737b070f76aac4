"""Result of the arming gate (`rig.doctor.gate`, the check before the motor may move), and conversion of delays.

Hits, commands and pages read the result; recordings store it. This file must not measure a link nor import the gate,
because a hit that was admitted earlier must not load them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from rig.core import check
from rig.core.check import Check, Outcome
from rig.core.operators import hand_text
from rig.core.present import Item, Row, reported


def ticks_late(late_s: float, rate: float, pacing: str = "device") -> int:
    """Return the number of ticks (at least 1) from a sample to the tick in which its command acts.

    `late_s` is the delay of the link (s), `rate` the loop rate (Hz), and `pacing` the side whose clock starts each
    tick, ``device`` or ``host``.
    """
    return max(1, math.ceil(late_s * rate - 1e-9)) + (1 if pacing == "host" else 0)


def ticks_text(number: int) -> str:
    """Return a number of ticks with the word "tick" in the right form: ``1 tick``, ``2 ticks``."""
    return f"{number} tick{'' if number == 1 else 's'}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate:
    """Decision whether the motor may be armed to render one wall over one link (the arming gate), and its numbers.

    Attributes
    ----------
    checks
        Checks of delay, losses, stability and others; a check that refuses forbids arming.
    rate_hz, delay_ticks
        Rate of the loop (Hz), and the delay that the link causes (ticks).
    travel_s
        Round trip on the link that 99.9 % of all exchanges do not exceed: its upper bound, or the longest measured
        round trip if too few were measured for a bound (s).
    lifetime_s
        Time after which the device drops a command that is not renewed (s).
    loss_share
        Share of lost requests, 0 to 1.
    stiffness, damping
        Stiffness (N/m or N·m/rad) and damping (N·s/m or N·m·s/rad) of the wall.
    spectral_radius
        Spectral radius of the closed loop for each modelled hand (1 or more: unstable); empty if it was not computed.
    k_max
        Largest stable stiffness (N/m or N·m/rad) for each modelled hand, at the wall's damping and the measured delay.
    passive_stiffness
        Largest passive stiffness (N/m or N·m/rad) at the wall's damping and the measured delay; None if not computed.
    simulated, forced
        True if the device is simulated; True if the user arms in spite of refusals. In both cases nothing is refused.
    """

    checks: tuple[Check, ...]
    rate_hz: float
    delay_ticks: int
    travel_s: float
    lifetime_s: float
    loss_share: float
    stiffness: float
    damping: float
    spectral_radius: Mapping[str, float]
    k_max: Mapping[str, float]
    passive_stiffness: float | None
    simulated: bool
    forced: bool = False

    @reported
    def armable(self) -> bool:
        """Return True if no check refuses to arm the motor for the wall."""
        return not self.refused

    @property
    def refused(self) -> tuple[Check, ...]:
        """Return the checks that refuse to arm the motor for the wall."""
        return check.refused(self.checks)

    @property
    def text(self) -> str:
        """Return the reasons why the motor must not be armed, separated by semicolons."""
        return "; ".join(one.text for one in self.refused)

    @property
    def remedy(self) -> str:
        """Return what to do so that the motor may be armed: one remedy per refusal, separated by semicolons."""
        return "; ".join(dict.fromkeys(one.remedy for one in self.refused))

    def items(self) -> list[Item]:
        """Return for printing whether the wall may be armed, all checks and the loop's spectral radii."""
        verdict = Check("arming", Outcome.OK, "this wall may be armed")
        if not self.armable:
            verdict = Check("arming", Outcome.REFUSED, "this wall must not be armed")
            if self.simulated:
                verdict = Check(
                    "arming", Outcome.WARNING, "a real rig would be refused; this one is simulated"
                )
        radius = ", ".join(f"{hand_text(hand)} {value:.4g}" for hand, value in self.spectral_radius.items())
        rows = (
            [Row("spectral radius", radius, note=f"delay {ticks_text(self.delay_ticks)}")] if radius else []
        )
        return [verdict, *self.checks, *rows]
