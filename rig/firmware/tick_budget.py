"""Compute the highest rate at which a board's processor can run the control law, from the cycles of a whole tick.

The cycles are those of `rig.firmware._cortex`: estimates for memory without wait states, not measured on a board.

Plans and designs call it. It must not load a toolchain.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from firmware_protocol.dictionary import SettingValue
from rig.core.errors import ConfigError
from rig.firmware._boards import Board, load, settings_of
from rig.firmware._cortex import CORES, CortexCore

BOARD = "rp2040"  # default board: this package contains its firmware
# Largest part of a period that a tick may take; link and host need the rest.
SHARE = 0.4
INTEGERS = "fdm-butterworth-fixed"

# Most cycles of a call of the estimator, and of the whole tick of a hit at uniform sampling, with that call. Measured
# with gcc 12.2: calls by rig estimators export NAME --json on 2026-11-29 (M4F: 2026-11-26), ticks by the harness of
# tests/firmware/test_core_cortex.py on 2026-11-30. Both windowings with 16 periods, the longest of a design's list.
CALLS: Mapping[str, Mapping[str, int]] = {
    "M0+": {
        "fdm": 245,
        "fdm-butterworth": 1644,
        INTEGERS: 197,
        "foaw-end": 8888,
        "foaw-best": 43_183,
        "levant": 2790,
        "kalman": 1560,
        "tracking": 1355,
        "disturbance": 1701,
        "disturbance-two-mass": 3529,
    },
    "M4F": {
        "fdm": 26,
        "fdm-butterworth": 57,
        INTEGERS: 118,
        "foaw-end": 2410,
        "foaw-best": 7471,
        "levant": 108,
        "kalman": 57,
        "tracking": 57,
        "disturbance": 60,
        "disturbance-two-mass": 91,
    },
}
TICKS: Mapping[str, Mapping[str, int]] = {
    "M0+": {
        "fdm": 5589,
        "fdm-butterworth": 7103,
        INTEGERS: 2690,
        "foaw-end": 14_337,
        "foaw-best": 51_016,
        "levant": 8335,
        "kalman": 7208,
        "tracking": 6976,
        "disturbance": 8734,
        "disturbance-two-mass": 10_497,
    },
    "M4F": {
        "fdm": 1658,
        "fdm-butterworth": 1709,
        INTEGERS: 1712,
        "foaw-end": 4442,
        "foaw-best": 12_363,
        "levant": 1757,
        "kalman": 1710,
        "tracking": 1710,
        "disturbance": 1770,
        "disturbance-two-mass": 1785,
    },
}


@dataclass(frozen=True, slots=True)
class TickBudget:
    """A board's processor and its clock, which determine how long a tick of the law takes.

    Attributes
    ----------
    board
        Name of the board.
    core
        Core of the board's processor.
    clock_hz
        Clock frequency of the processor, from the board's settings (Hz).
    """

    board: str
    core: CortexCore
    clock_hz: float

    def call_cycles(self, estimator: str) -> int | None:
        """Return the largest number of cycles of one call of an estimator; None if it was not counted on this core."""
        return CALLS[self.core.name].get(estimator)

    def rate_maximum(self, estimator: str) -> float:
        """Return the highest rate (Hz) at which a tick with this estimator fits; 0 if no board can run it."""
        cycles = TICKS[self.core.name].get(estimator)
        return 0.0 if cycles is None else SHARE * self.clock_hz / cycles

    @property
    def has_float_unit(self) -> bool:
        """Return True if the processor computes float32 in hardware."""
        return "-mfloat-abi=hard" in self.core.flags

    def text(self, estimator: str) -> str:
        """Return a sentence with the cycles of a tick with this estimator, and the highest tick rate."""
        unit = "" if self.has_float_unit or estimator == INTEGERS else ", no floating-point unit"
        cycles = TICKS[self.core.name].get(estimator)
        if cycles is None:
            return f"no supported board can run {estimator}"
        return (
            f"{cycles} cycles a tick on {self.board} (Cortex-{self.core.name}, "
            f"{self.clock_hz / 1e6:g} MHz{unit}): at most {self.rate_maximum(estimator) / 1e3:.3g} kHz"
        )


def tick_budget(board: Board, settings: Mapping[str, SettingValue] | None = None) -> TickBudget | None:
    """Return the processor and clock of a board with `settings`, or with its default settings.

    Return None if the cycles of the board's processor are not known.
    """
    known = [
        core for core in CORES.values() if core.name in TICKS and set(core.flags) <= set(board.processor)
    ]
    if not known:
        return None
    clock = (settings_of(board, {}) if settings is None else settings).get("clock", "")
    mhz = re.fullmatch(r"(\d+)mhz", str(clock))
    return TickBudget(board.name, known[0], 1e6 * float(mhz[1]) if mhz else known[0].clock_hz)


def named_budget(name: str) -> TickBudget:
    """Return the processor and clock of the board `name`.

    Raise `ConfigError` if the board is unknown, or the CPU cycles of a control tick were not counted on its processor.
    """
    found = tick_budget(load(name))
    if found is None:
        raise ConfigError(
            f"the time of a control tick on board {name} cannot be estimated: CPU cycles were counted only on "
            f"Cortex-{' and Cortex-'.join(TICKS)} processors",
            remedy=f"choose a board with one of these processors, such as {BOARD}",
        )
    return found
