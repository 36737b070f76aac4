"""Load pylsl on first use, with an error that says how to install it, and compare LSL's clock with the host's.

`serve` and `streams` use it; no other file may import pylsl.
"""

import os
import time
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from rig.core.errors import ConfigError

# The narrowest of many readings counts: one that was interrupted between the two clocks is wide.
TRIES = 101
_QUIET = "[log]\nlevel = -2\n"  # log errors only: the terminal shows other things
_CONFIGURATIONS = (
    Path("lsl_api.cfg"),
    Path.home() / "lsl_api" / "lsl_api.cfg",
    Path("/etc/lsl_api/lsl_api.cfg"),
)


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """LSL's clock minus CLOCK_MONOTONIC, the clock of a loop's times (s), and the uncertainty of this offset (s).

    liblsl uses CLOCK_MONOTONIC on Linux: an offset that is not significant is set to zero.
    """

    offset_s: float
    uncertainty_s: float


def load() -> Any:
    """Import pylsl; let liblsl log errors only, unless the user has configured it.

    Raises `ConfigError` if pylsl is not installed, or finds no liblsl.
    """
    try:
        pylsl = import_module("pylsl")
    except ImportError as error:
        raise ConfigError("pylsl is not installed", remedy="pip install 'haptic-rig[lsl]'") from error
    except (RuntimeError, OSError) as error:
        raise ConfigError(
            "pylsl finds no liblsl: its package has one for Linux on x86-64 with glibc 2.35 or newer only",
            remedy="install liblsl from github.com/sccn/liblsl and set PYLSL_LIB to its path",
        ) from error
    if "LSLAPICFG" not in os.environ and not any(path.exists() for path in _CONFIGURATIONS):
        pylsl.set_config_content(_QUIET)
    return pylsl


def clock_offset(pylsl: Any) -> ClockOffset:
    """Measure LSL's clock minus the host's: read LSL's between two readings of the host's clock, `TRIES` times."""
    best: tuple[int, float] | None = None
    for _ in range(TRIES):
        before = time.monotonic_ns()
        theirs = pylsl.local_clock()
        width = time.monotonic_ns() - before
        if best is None or width < best[0]:
            best = width, theirs - (before + 0.5 * width) * 1e-9
    assert best is not None
    uncertainty_s = 0.5e-9 * best[0] + 1e-9
    offset_s = best[1] if abs(best[1]) > uncertainty_s else 0.0
    return ClockOffset(offset_s, uncertainty_s)
