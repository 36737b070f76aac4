"""Convert input from mouse or arrow keys to the target position and press of the simulated hand.

The left edge of the screen is a little behind the start position, the right edge inside the wall, for walls on either
side. The terminal and the page use it. It must not read the stiffness of a wall.
"""

from collections.abc import Mapping
from typing import Any, Literal, Protocol

BEHIND, INSIDE = (
    0.25,
    0.75,
)  # screen edges, behind the start and inside the wall, over the way from start to wall
STEPS = 40  # presses of an arrow key over the whole width of the screen
CLOSE = 5  # such steps in a large step
KEYS = {"right": 1, "left": -1, "up": CLOSE, "down": -CLOSE, "home": -STEPS, "end": STEPS}  # steps of each
START_SHARE = BEHIND / (BEHIND + 1.0 + INSIDE)
WALL_SHARE = (BEHIND + 1.0) / (BEHIND + 1.0 + INSIDE)

HandKind = Literal["mouse", "keyboard"]


class PointerTarget(Protocol):
    """Receiver of the simulated hand's target position and press (`rig.realtime.hand.SharedHand`)."""

    def move(self, position: float, press: float) -> None:
        """Move the simulated hand towards a position of the link (rad or m), and press with a force (N)."""

    def close(self) -> None:
        """Release the simulated hand, which then rests."""


class Pointer:
    """Position of the simulated hand as a fraction of the screen's width (0 to 1), and force of a full press (N)."""

    def __init__(self, press: float) -> None:
        self._press = press
        self._share = START_SHARE
        self._held = False
        self._scale: Mapping[str, Any] = {}

    def scale(self, scale: Mapping[str, Any]) -> None:
        """Set the positions of start and wall (rad or m) from `DeskView.scale`; an empty scale changes nothing."""
        if scale:
            self._scale = dict(scale)

    def point(self, share: float, *, held: bool) -> None:
        """Move the simulated hand to a fraction of the screen's width (0 … 1); if `held`, press with full force."""
        self._share, self._held = min(1.0, max(0.0, share)), held

    def key(self, name: str) -> bool:
        """Move the simulated hand by an arrow key and return True; return False for any other key."""
        steps = KEYS.get(name)
        if steps is None:
            return False
        self.point(self._share + steps / STEPS, held=False)
        return True

    @property
    def share(self) -> float:
        """Position of the simulated hand as a fraction of the screen's width (0 … 1)."""
        return self._share

    @property
    def intention(self) -> tuple[float, float] | None:
        """Target position (rad or m) and press (N) of the simulated hand; None before start and wall are known."""
        if "start" not in self._scale or "wall" not in self._scale:
            return None
        start, wall = float(self._scale["start"]), float(self._scale["wall"])
        left, right = start - BEHIND * (wall - start), wall + INSIDE * (wall - start)
        # Beyond the wall the hand presses harder the further it reaches, as a person pushes against a rigid object; a
        # held button presses with full force.
        depth = max(0.0, (self._share - WALL_SHARE) / (1.0 - WALL_SHARE))
        return left + (right - left) * self._share, self._press * (1.0 if self._held else depth)
