"""``python -m tests.guest.prepare`` compiles the kernels, Python files and tests that a guest will use.

It prints the files that it read, one a line: the guest will read them.
"""

import compileall
import importlib
import sys
import sysconfig
import tempfile
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from rig import cli
from rig.extras.drives.library import library
from rig.realtime.kernel import prepare
from tests.guest.pico import RIG
from tests.guest.stage import PYTEST

# Modules of which the tests in the guest enter kernels that a hit does not.
ENTERED = (
    *("rig.devices._usb_transfers", "sim_backend.board.hardware", "sim_backend.mechanics.sensors"),
    *("sim_backend.drives.motor", "sim_backend.drives.moteus_law", "sim_backend.drives.odrive_law"),
)
# Where the package is installed pytest would rewrite its plug-in, which this process has imported.
ALREADY = ("-W", "ignore:Module already imported:pytest.PytestAssertRewriteWarning")
HIT = ("hit", "--realtime", "--no-plot", "--duration", "0.5")
ON_BOARD = (
    *("--rig", RIG, "--loop", "device", "--estimator", "fdm-butterworth-fixed"),
    *("--rate", "4k/1k", "-K", "50"),
)
# On a busy machine a hit may lose its device or its handle: what counts is that it compiled.
HIT_STATUSES = (0, 6, 7, 10)


def main() -> None:
    """Compile and print the files; the exit status is not 0 if the tests or a hit cannot be loaded here."""
    with tempfile.TemporaryDirectory() as place, redirect_stdout(sys.stderr):
        for room in ("firmware_protocol", "rig", "sim_backend"):
            compileall.compile_dir(room, quiet=1)
        if pytest.main([*PYTEST, *ALREADY, "--collect-only", "-q", "tests/guest"]) != pytest.ExitCode.OK:
            sys.exit(1)
        library()
        for name in ENTERED:
            prepare(*vars(importlib.import_module(name)).values())
        for more in ((), ON_BOARD):
            status = cli.run([*HIT, *more, "-o", place])
            if status not in HIT_STATUSES:
                sys.exit(status)
    for file in sorted({file.resolve() for file in _read() if file.is_file()}):
        print(file)


def _read() -> Iterator[Path]:
    """Yield imported files, source and compiled, mapped libraries and names of plug-ins."""
    for module in list(sys.modules.values()):
        if source := getattr(module, "__file__", None):
            path = Path(source)
            yield path
            yield from path.parent.glob(f"__pycache__/{path.stem}.{sys.implementation.cache_tag}*.pyc")
    for line in Path("/proc/self/maps").read_text().splitlines():
        if "/" in line and ".so" in line:
            yield Path(line[line.index("/") :])
    yield from Path(sysconfig.get_path("purelib")).glob("*.dist-info/entry_points.txt")


if __name__ == "__main__":
    main()
