"""What the arming gate found (`rig.doctor.gate`): data, which commands show and recordings keep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rig.core import check
from rig.core.check import Check, Outcome
from rig.core.operators import hand_text
from rig.core.present import Item, Row, reported
from rig.doctor.delay import ticks_text


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
        """Whether no check refuses."""
        return not self.refused

    @property
    def refused(self) -> tuple[Check, ...]:
        """The checks that refuse."""
        return check.refused(self.checks)

    @property
    def text(self) -> str:
        """All reasons against arming."""
        return "; ".join(one.text for one in self.refused)

    @property
    def remedy(self) -> str:
        """What to do, all of it."""
        return "; ".join(dict.fromkeys(one.remedy for one in self.refused))

    def items(self) -> list[Item]:
        """Return it for people."""
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
