"""Simulate a hand that is driven interactively during a run: with a mouse, with keys, by a program.

`sim_backend.board.hardware` requests short blocks of intended motion from the hand and plays them like a script. The
hand must not follow the mouse or program before the trial begins, and must stay within the travel and the force of a
person.
"""

import math
from collections.abc import Callable

import numpy as np

from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.realtime.hand import Wish
from sim_backend.mechanics.coupled_hand import INTENTIONS
from sim_backend.mechanics.operator import PRESS_HZ, REPEAT_S, OperatorScript, Rows, tremor

# A mouse moves in jerks and an arrow key in steps, a hand does not: it follows critically damped, without overshoot.
FOLLOW_HZ = 3.0  # chosen: a step of 10 mm then goes at 7 cm/s at most, about as fast as the scripted reach
BLOCK_S = 0.002  # length of a block: the largest delay of a command
# After this time without a new wish the hand stays where it is and presses no more: its page may have been closed.
SILENT_S = 1.0
REACH_M_S = 0.1  # at the handle, chosen: what a step of 14 mm reaches by itself; a longer one goes no faster
BACK_M = 0.05  # at the handle: travel of a hand behind its start
AHEAD_M, AHEAD_N = 0.05, 10.0  # travel and force beyond those of the scripted hand
PRESS_N = 10.0  # more than a firm grip's press


class DrivenHand:
    """A simulated hand at a rig's handle that follows commands (position, pressing force) of a program or a mouse.

    Raise `ConfigError` if no person holds the rig's handle.

    Parameters
    ----------
    model
        Rig that a person holds; it has an operator and a reach.
    wish
        Returns the newest command (`rig.realtime.hand.SharedHand.read`), or None before the first.
    tell
        Called at the start of each block of ticks with hand position, handle position (rad or m) and handle velocity
        (rad/s or m/s).
    """

    def __init__(
        self,
        model: RigModel,
        wish: Callable[[], Wish | None],
        tell: Callable[[float, float, float], None] = lambda *motion: None,
    ) -> None:
        if model.operator is None or model.reach is None:
            raise ConfigError(
                f"no person holds the handle of {model.name}, so there is no hand to drive",
                remedy='set trial.kind = "human"',
            )
        self._operator, self._reach = model.operator, model.reach
        self._radius = model.mechanics.handle_radius
        self._side = math.copysign(1.0, model.reach.target - model.reach.start)
        self._wish = wish
        self.tell = tell
        self._follows_commands = False

    def begin(self, position: float, tick_s: float, session: int = 0) -> None:
        """Begin a session: handle at `position` (rad or m), ticks of `tick_s` (s); `session` selects the tremor."""
        reach = self._reach
        self._tick_s = tick_s
        self._position, self._rate = reach.start, 0.0
        self._press, self._press_rate = 0.0, 0.0
        self._tick = 0
        # A command from before the session may be years old: only a new one shows that a person is present.
        self._newest_wish = self._wish() or Wish(0, reach.start, 0.0)
        self._silent_s, self._is_silent, self._commanded_position = SILENT_S, True, reach.start
        self._moving_target = reach.start  # with limited speed; the hand follows it
        self._times: Rows = np.arange(1.0, 1.5 + round(BLOCK_S / tick_s), dtype=np.float64) * tick_s
        around: Rows = (np.arange(round(REPEAT_S / tick_s), dtype=np.float64) + 0.5) * tick_s
        generator = np.random.default_rng([reach.seed, session])
        self._tremor = np.stack(tremor(around, self._operator.tremor / self._radius, generator))
        self._start_position = position
        self._follows_commands = False

    def next(self, hand: float) -> OperatorScript:
        """Return the hand's intended motion for the next block of ticks; `hand` is its present position (rad or m)."""
        if not self._follows_commands:
            self._follows_commands = True
            # While the rig homes, the hand follows the handle and ignores commands: pulling elsewhere, it would keep
            # the handle from its start.
            return OperatorScript(rows=self._follow_homing())
        times = self._times
        places = (self._tick + np.arange(len(times))) % self._tremor.shape[1]
        self._tick += len(times)
        wanted, press = self._read_wish(hand)
        # The target that the hand follows has this highest speed, so the hand has it too.
        most = REACH_M_S / self._radius * float(times[-1])
        goal = self._moving_target = self._moving_target + min(max(wanted - self._moving_target, -most), most)
        at, rate = follow(self._position - goal, self._rate, times)
        pressed, press_rate = follow(self._press - press, self._press_rate, times)
        at, pressed = at + goal, pressed + press
        self._position, self._rate = float(at[-1]), float(rate[-1])
        self._press, self._press_rate = float(pressed[-1]), float(press_rate[-1])
        # Tremor grows with the effort, as in the script (Sutton and Sykes 1967).
        scale = self._tremor_scale()
        swell = 1.0 + self._operator.press_modulation * np.sin(
            2.0 * math.pi * PRESS_HZ * self._tick_s * places
        )
        rows = np.empty((len(times), INTENTIONS))
        rows[:, 0] = at + scale * self._tremor[0, places]
        rows[:, 1] = rate + scale * self._tremor[1, places]
        rows[:, 2] = self._side * self._radius * pressed * swell
        return OperatorScript(rows=rows)

    def _follow_homing(self) -> Rows:
        """Return rows of intended motion that follow the handle while the rig homes, then rest until the trial."""
        reach = self._reach
        along_s = abs(reach.start - self._start_position) / reach.pace
        ticks = max(1, math.ceil((along_s + reach.wait_s - reach.free_s) / self._tick_s))
        t = (np.arange(ticks) + 0.5) * self._tick_s
        left = np.clip(1.0 - t / along_s, 0.0, 1.0) if along_s > 0.0 else np.zeros(ticks)
        rows = np.zeros((ticks, INTENTIONS))
        rows[:, 0] = reach.start + (self._start_position - reach.start) * left
        rows[:, 1] = np.where(left > 0.0, math.copysign(reach.pace, reach.start - self._start_position), 0.0)
        return rows

    def _read_wish(self, hand: float) -> tuple[float, float]:
        """Return the hand's commanded position (rad or m) and pressing force (N), limited to what a person can do.

        Without a new command for `SILENT_S` (1 s), the hand stays where it was (`hand`, rad or m) and does not press.
        """
        wish = self._wish()
        self._silent_s += len(self._times) * self._tick_s
        if wish is not None and wish.sequence != self._newest_wish.sequence:
            self._newest_wish, self._silent_s = wish, 0.0
        if self._silent_s >= SILENT_S:
            if not self._is_silent:
                self._is_silent, self._commanded_position = True, hand
            return self._commanded_position, 0.0
        self._is_silent = False
        reach, operator = self._reach, self._operator
        stiff = operator.hand_stiffness
        # A stiff hand that is far ahead of the handle would press through its own spring, beyond `PRESS_N`.
        ahead = AHEAD_M if stiff == 0.0 else min(AHEAD_M, AHEAD_N / stiff)
        ends = (
            reach.start - self._side * BACK_M / self._radius,
            reach.target + self._side * ahead / self._radius,
        )
        self._commanded_position = min(max(self._newest_wish.position, min(ends)), max(ends))
        return self._commanded_position, min(max(self._newest_wish.press, 0.0), PRESS_N)

    def _tremor_scale(self) -> float:
        """Return the factor of the tremor: the hand's force divided by that of the scripted hand, at most 1."""
        operator = self._operator
        wall = self._reach.target - self._side * operator.depth / self._radius
        inside = max(0.0, self._side * (self._position - wall)) * self._radius
        whole = operator.press + operator.hand_stiffness * operator.depth
        made = self._press + operator.hand_stiffness * inside
        return min(1.0, made / whole) if whole > 0.0 else 0.0


def follow(distance: float, rate: float, times: Rows) -> tuple[Rows, Rows]:
    """Return the distance (rad or m) to a fixed target, and its rate, at `times` (s from now).

    `distance` and `rate` are the present values. The hand approaches like a critically damped second-order system.
    """
    omega = 2.0 * math.pi * FOLLOW_HZ
    pull = rate + omega * distance
    fade = np.exp(-omega * times)
    left = (distance + pull * times) * fade
    return left, pull * fade - omega * left
