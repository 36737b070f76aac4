"""Detect keys that were already held down before the open question; they must not answer it until released."""

import math

# Longest delay before a held key repeats that is a default: X.Org 0.66 s, KDE 0.6 s, GNOME 0.5 s, macOS 0.5 s, Windows
# 0.5 s (1 s at most). A longer delay set by hand lets the first repetition of a key that was held through pass.
RELEASED_S = 1.0


class HeldKeys:
    """Key presses of the last second, to detect keys that are held down; all times are on one monotonic clock (s)."""

    def __init__(self) -> None:
        # Begin and last arrival (s) of the current press of each key.
        self._presses: dict[str, tuple[float, float]] = {}
        self._asked_s = -math.inf

    def ask(self, now_s: float) -> None:
        """Store the time `now_s` at which a question was opened: keys that are down at this time do not answer it."""
        self._asked_s = now_s

    def ask_again(self) -> None:
        """Open a further question that the newest key press caused; that key press must not answer it."""
        self._asked_s = max((last_s for _, last_s in self._presses.values()), default=self._asked_s)

    def arrive(self, key: str, now_s: float) -> bool:
        """Store that a key arrived at `now_s`; return True if this key press began after the question was opened."""
        # A terminal reports no release: a key that is down arrives again and again, at first after the delay of its
        # repetition. Arrivals closer than `RELEASED_S` are one press, also those of a pedal that taps by itself.
        known = self._presses = {
            name: (began_s, last_s)
            for name, (began_s, last_s) in self._presses.items()
            if now_s - last_s < RELEASED_S
        }
        began_s, _ = known.get(key.lower(), (now_s, now_s))
        known[key.lower()] = began_s, now_s
        return began_s > self._asked_s
