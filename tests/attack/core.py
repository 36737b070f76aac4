"""Fuzz the firmware's C core under the sanitizers: `tests/firmware/fuzz.c` as its own process, with many seeds."""

import random
import shutil
import subprocess
from collections import Counter
from pathlib import Path

from tests.attack.area import Outcome, require
from tests.firmware import build

STEPS = 400_000
CASE_S = 120.0


class Core:
    """The area "core": each case is one run of the fuzzer with a drawn seed."""

    def __init__(self, place: Path) -> None:
        self._program: Path | None = None
        if shutil.which("gcc") is not None:
            flags = [*build.ADDRESS, f"-I{build.FIRMWARE / 'host'}"]
            source = Path(build.__file__).with_name("fuzz.c")
            self._program = build.kept_c("fuzz", [source, *build.SOURCES], flags)

    def attack(self, case: int, chance: random.Random) -> Outcome:
        """Run the fuzzer for `STEPS` steps."""
        if self._program is None:
            return Outcome(skipped=Counter({"core: no gcc": 1}))
        seed = chance.getrandbits(32)
        command = [str(self._program), str(seed), str(STEPS)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=CASE_S, check=False)
        require(done.returncode == 0, "fuzz", seed, STEPS, "ends with", done.returncode, done.stderr[-2000:])
        figures: Counter[str] = Counter(steps=STEPS)
        for what, which, times in (line.split() for line in done.stdout.splitlines()):
            if what == "sum":
                figures[which] += int(times)
        return Outcome(figures)
