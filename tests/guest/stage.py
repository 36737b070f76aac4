"""``python -m tests.guest.stage [pytest arguments]`` boots a guest and runs the tests of this directory in it.

Kernels (for the simplest CPU) and Python files are compiled here, because an emulated machine takes minutes; the files
read meanwhile are copied to a disk for the guest. ``--prepare`` alone compiles the kernels, which are kept, and ends.
"""

import os
import shlex
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from tests.guest import image
from tests.guest.absent import GuestAbsentError
from tests.guest.boot import UDEV, WATCHDOG_S, GuestEnd, check_tools, run_in_guest
from tests.guest.kernel_files import unpacked_kernel
from tests.guest.pico import PORT, emulated_pico

HERE = Path(__file__).resolve().parents[2]
MODULES = ("vhci_hcd", "dummy_hcd", "usb_f_acm", "cdc_acm", "virtio_console", "vcan", "can_raw")
SKIPPED = 77  # the exit status for "not run", as in automake
PREPARE_TIMEOUT_S = 600.0
ONE_CPU_FOR_ALL = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
PYTEST = ("-rs", "-o", "addopts=", "--import-mode=importlib", "-p", "no:cacheprovider", "-p", "no:xdist")
TEST_TIMEOUT_S = 150


def main() -> int:
    cache = Path(os.environ.get("HAPTIC_RIG_GUEST_CACHE") or Path(tempfile.gettempdir()) / "haptic-rig-guest")
    kernels = cache / "kernels"
    started = time.monotonic()
    if sys.argv[1:] == ["--prepare"]:
        _prepare(kernels)
        return 0
    try:
        check_tools()
        unpacked_kernel(cache)
        files = _prepare(kernels)
        prepared = time.monotonic()
        end = _run(cache, kernels, files, sys.argv[1:])
    except GuestAbsentError as error:
        print(f"SKIPPED: no guest on this machine: {error}")
        return SKIPPED
    print(f"guest: {prepared - started:.0f} s to prepare, {end.wall_s:.0f} s from start to end")
    if end.timed_out:
        print("guest: killed by its watchdog")
    elif end.status is None:
        print("guest: it died before the tests were done")
    return 1 if end.status is None else end.status


def _run(cache: Path, kernels: Path, files: list[Path], arguments: list[str]) -> GuestEnd:
    """Boot the guest with the emulated board, or without it and print the reason."""
    watchdog_s = float(os.environ.get("HAPTIC_RIG_GUEST_WATCHDOG_S", WATCHDOG_S))
    with tempfile.TemporaryDirectory(prefix="guest-") as scratch, ExitStack() as board:
        share = Path(scratch, "share")
        share.mkdir()
        try:
            channel, absent = (PORT, board.enter_context(emulated_pico(share))), ""
        except GuestAbsentError as error:
            channel, absent = None, f"no emulated board: {error}"
            print(f"SKIPPED: {absent}")
        disk = Path(scratch, "disk")
        image.make(disk, files)
        script = _script(kernels, arguments, absent)
        return run_in_guest(
            script, cache, modules=MODULES, share=share, channel=channel, disk=disk, watchdog_s=watchdog_s
        )


def _prepare(kernels: Path) -> list[Path]:
    environment = {**os.environ, **ONE_CPU_FOR_ALL, "HAPTIC_RIG_CACHE": str(kernels)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, (str(HERE), os.environ.get("PYTHONPATH"))))
    done = subprocess.run(
        [sys.executable, "-m", "tests.guest.prepare"], cwd=HERE, env=environment, capture_output=True,
        text=True, timeout=PREPARE_TIMEOUT_S, check=False,
    )  # fmt: skip
    if done.returncode != 0:
        raise RuntimeError(f"the tests of the guest do not load here, before any guest:\n{done.stderr}")
    compiled = [file for file in kernels.rglob("*") if file.is_file()]
    return [*map(Path, done.stdout.splitlines()), *compiled]


def _script(kernels: Path, arguments: list[str], no_pico: str) -> str:
    environment = {
        **ONE_CPU_FOR_ALL,
        "HAPTIC_RIG_CACHE": str(kernels),  # what is written there stays in the guest's memory
        "PYTHONPATH": str(HERE),
        "PYTHONDONTWRITEBYTECODE": "1",
        "MPLBACKEND": "Agg",
        "HOME": "/root",
        "HAPTIC_RIG_NO_PICO": no_pico,
        "PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
    }
    exports = "\n".join(f"export {name}={shlex.quote(value)}" for name, value in environment.items())
    options = f"-v --strict-markers -rs --durations=0 --durations-min=1 -o timeout={TEST_TIMEOUT_S}"
    pytest = [
        sys.executable, "-m", "pytest", *PYTEST, *options.split(), *(arguments or ["tests/guest"]),
    ]  # fmt: skip
    return f"""
{exports}
mount -t configfs none /sys/kernel/config
{UDEV} --daemon
udevadm trigger --subsystem-match=usb --subsystem-match=tty
udevadm settle
cd {shlex.quote(str(HERE))}
echo "guest: up after $(cut -d' ' -f1 /proc/uptime) s"
{shlex.join(pytest)}
status=$?
compiled=$(find {shlex.quote(str(kernels))} -name '*.nbi' -newer /run/guest/start -printf '%f ')
echo "guest: done after $(cut -d' ' -f1 /proc/uptime) s; kernels compiled here: ${{compiled:-none}}"
exit $status
"""


if __name__ == "__main__":
    sys.exit(main())
