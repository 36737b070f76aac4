"""What the arming gate found (`rig.doctor.gate`), and the delay of a loop in ticks, in which it is stated.

Admission, hits, commands and pages read it; recordings keep it. It must not measure anything, nor import the gate: a
hit that was admitted earlier loads neither the gate nor what measures a link.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from rig.core import check
from rig.core.check import Check, Outcome
from rig.core.operators import hand_text
from rig.core.present import Item, Row, reported


def ticks_late(late_s: float, rate: float, pacing: str = "device") -> int:
    """Return the ticks from a sample to its command, which is so late (s), at a rate (Hz): one at least in real time.

    A command that arrives in the course of a tick is active from the next one on, hence whole ticks. A loop that the
    host paces lets a sample wait for its own tick, one more at most.
    """
    return max(1, math.ceil(late_s * rate - 1e-9)) + (1 if pacing == "host" else 0)


def ticks_text(number: int) -> str:
    """Return a number of ticks in words: ``1 tick``, ``2 ticks``."""
    return f"{number} tick{'' if number == 1 else 's'}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate:
    """What the gate found.

    Attributes
    ----------
    checks
        Delay, losses, stability and what else is worth knowing; one that refuses forbids arming.
    rate_hz, delay_ticks
        Rate of the loop, and the delay that the link gives it.
    travel_s
        Upper bound of the link's time there and back in 99.9 % of all cases, or the longest one measured (s).
    lifetime_s
        Of a command (s).
    loss_share
        Share of questions that were lost.
    stiffness, damping
        The wall.
    spectral_radius
        By hand; empty where nothing is computed.
    k_max
        By hand: the largest stable stiffness at this damping and delay.
    passive_stiffness
        The largest one that is passive there, or None.
    simulated, forced
        The device is a simulated one; the user arms anyway. Neither is refused.
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
        """Return True if no check refuses."""
        return not self.refused

    @property
    def refused(self) -> tuple[Check, ...]:
        """Return the checks that refuse to arm the wall."""
        return check.refused(self.checks)

    @property
    def text(self) -> str:
        """Return the texts of all refusing checks, joined."""
        return "; ".join(one.text for one in self.refused)

    @property
    def remedy(self) -> str:
        """Return all remedies in one text."""
        return "; ".join(dict.fromkeys(one.remedy for one in self.refused))

    def items(self) -> list[Item]:
        """Return the checks of the gate as items to print."""
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
