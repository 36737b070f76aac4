"""Convert input from mouse or arrow keys to an intention of the simulated hand: position and press.

The left edge of the screen is a little behind the start, the right edge inside the wall, for walls on either side.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Protocol

BEHIND, INSIDE = 0.25, 0.75  # of the way from start to wall: what the screen's ends mean
STEPS = 40  # of an arrow key over the whole way
CLOSE = 5  # such steps for a large one
KEYS = {"right": 1, "left": -1, "up": CLOSE, "down": -CLOSE, "home": -STEPS, "end": STEPS}  # steps of each
START_SHARE = BEHIND / (BEHIND + 1.0 + INSIDE)
WALL_SHARE = (BEHIND + 1.0) / (BEHIND + 1.0 + INSIDE)

HandKind = Literal["mouse", "keyboard"]


class PointerTarget(Protocol):
    """Receiver of the intentions of a hand (`rig.realtime.hand.SharedHand`)."""

    def move(self, position: float, press: float) -> None:
        """Move the hand towards a position of the link (rad or m), and press with a force (N)."""

    def close(self) -> None:
        """Release the hand, which then rests."""


class Pointer:
    """Position of the hand as a share of the screen's width, from 0 to 1.

    Parameters
    ----------
    press
        Force of a full press (N).
    """

    def __init__(self, press: float) -> None:
        self._press = press
        self._share = START_SHARE
        self._held = False
        self._scale: Mapping[str, Any] = {}

    def scale(self, scale: Mapping[str, Any]) -> None:
        """Set the positions of start and wall from the `scale` of a view."""
        if scale:
            self._scale = dict(scale)

    def point(self, share: float, *, held: bool) -> None:
        """Move the hand to a share of the screen's width; if `held`, press with full force."""
        self._share, self._held = min(1.0, max(0.0, share)), held

    def key(self, name: str) -> bool:
        """Move the hand by an arrow key; return False for any other key."""
        steps = KEYS.get(name)
        if steps is None:
            return False
        self.point(self._share + steps / STEPS, held=False)
        return True

    @property
    def share(self) -> float:
        """Return the position between start and wall as a share."""
        return self._share

    @property
    def intention(self) -> tuple[float, float] | None:
        """Return position (rad or m) and press (N); None before the first view with start and wall."""
        if "start" not in self._scale or "wall" not in self._scale:
            return None
        start, wall = float(self._scale["start"]), float(self._scale["wall"])
        left, right = start - BEHIND * (wall - start), wall + INSIDE * (wall - start)
        # Beyond the wall the hand presses harder the further it reaches, as a person pushes against a rigid object; a
        # held button presses with full force.
        depth = max(0.0, (self._share - WALL_SHARE) / (1.0 - WALL_SHARE))
        return left + (right - left) * self._share, self._press * (1.0 if self._held else depth)
