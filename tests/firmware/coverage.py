"""Which branches of the firmware the tests take: python -m tests.firmware.coverage [pytest arguments].

Builds the library with gcov's counters, runs the tests of this directory on it in a process of its own, and prints one
line for each file: lines and branches taken at least once, of those that there are. The law has a test of its own for
that (law/test_law_sanitised.py); what is printed of it here is what a running device takes.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.firmware.build import FIRMWARE, LIBRARY_VARIABLE, SOURCES, compile_c

HERE = Path(__file__).parent
TESTS_S = 600.0
_FILE = re.compile(r"^File '(?P<file>.*)'$", re.MULTILINE)
_SHARE = re.compile(
    r"^(?P<what>Lines executed|Taken at least once):(?P<percent>[\d.]+)% of (?P<total>\d+)$", re.MULTILINE
)


def measure(directory: Path, arguments: list[str]) -> str:
    """Run the tests and return gcov's summary of every file."""
    objects = []
    for source in SOURCES:
        built = directory / f"{source.stem}.o"
        objects.append(compile_c(built, [source], ["-c", "-O0", "-fPIC", "--coverage"]))
    library = compile_c(directory / "libfirmware.so", objects, ["-shared", "--coverage"])
    environment = {**os.environ, LIBRARY_VARIABLE: str(library)}
    tests = [sys.executable, "-m", "pytest", "-n", "0", str(HERE), *arguments]
    subprocess.run(tests, env=environment, check=True, timeout=TESTS_S)
    gcov = ["gcov", "-b", "-n", *(str(built.with_suffix(".gcda")) for built in objects)]
    return subprocess.run(gcov, cwd=directory, capture_output=True, text=True, check=True).stdout


def table(summary: str) -> list[tuple[str, dict[str, tuple[float, int]]]]:
    """File name and its shares: what → (percent, of how many)."""
    starts = [*_FILE.finditer(summary)]
    ends = [*(match.start() for match in starts[1:]), len(summary)]
    rows = []
    for match, end in zip(starts, ends, strict=True):
        shares = {
            share["what"]: (float(share["percent"]), int(share["total"]))
            for share in _SHARE.finditer(summary, match.end(), end)
        }
        rows.append((Path(match["file"]).name, shares))
    return rows


def main() -> int:
    with tempfile.TemporaryDirectory() as directory:
        rows = table(measure(Path(directory), sys.argv[1:]))
    taken = total = 0.0
    for name, shares in sorted(rows):
        lines, branches = (
            shares.get("Lines executed", (0.0, 0)),
            shares.get("Taken at least once", (100.0, 0)),
        )
        print(
            f"{name:20} lines {lines[0]:6.1f} % of {lines[1]:3}   branches {branches[0]:6.1f} % of {branches[1]:3}"
        )
        if (FIRMWARE / "core" / name).exists():
            taken += branches[0] * branches[1] / 100
            total += branches[1]
    print(f"{'core':20} branches {100 * taken / total:.1f} % of {total:.0f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
