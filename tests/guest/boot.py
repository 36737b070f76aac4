"""Boot a Linux guest whose root is this machine's own, run one script in it, and say how it ended.

The guest sees the host's files read-only over 9p, under a layer in memory: the same interpreter, the same virtual
environment, the same checkout, and it can spoil none of them. One directory is shared for writing. What it will read
for sure may be given to it on a disk as well: a file over 9p costs a dozen questions. It has no network. Emulated by
TCG: needs no rights and no nested virtualisation, and is ten to twenty times slower than the machine.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from tests.conformance.started import started
from tests.guest import image, initramfs, kernel_files
from tests.guest.absent import GuestAbsentError

ROOT_MODULES = ("virtio_pci", "9pnet_virtio", "9p", "virtio_blk", "crc32c_generic", "ext4", "overlay")
EMULATOR = "qemu-system-x86_64"
BUSYBOX = "/bin/busybox"
UDEV = "/lib/systemd/systemd-udevd"
TOOLS = {EMULATOR: "qemu-system-x86", BUSYBOX: "busybox-static", UDEV: "udev", image.TOOL: "e2fsprogs"}
MEMORY_MB = 3072
PROCESSOR = (
    "Nehalem"  # x86-64-v2, the least that numpy and pyarrow run on: wider vectors take longer to emulate
)
PROCESSORS = 2
WATCHDOG_S = 480.0
INIT = Path(__file__).with_name("init.sh")
KERNEL_LINE = (
    "console=ttyS0 quiet loglevel=4 panic=-1 nokaslr mitigations=off clocksource=hpet random.trust_cpu=on"
)


@dataclass(frozen=True, slots=True)
class GuestEnd:
    """How a guest ended.

    Attributes
    ----------
    status
        Exit status of the script, None when the guest died before it was done.
    timed_out
        Whether the watchdog killed it.
    wall_s
        From the start of the emulator to its end (s).
    """

    status: int | None
    timed_out: bool
    wall_s: float


def run_in_guest(
    script: str,
    cache: Path,
    *,
    modules: Iterable[str] = (),
    share: Path | None = None,
    channel: tuple[str, Path] | None = None,
    disk: Path | None = None,
    watchdog_s: float = WATCHDOG_S,
) -> GuestEnd:
    """Boot a guest, run a bash script in it as root, and pass its console on to standard output.

    Parameters
    ----------
    script
        Text of the script. Its standard output is the console.
    cache
        Directory that keeps the kernel between calls.
    modules
        Kernel modules to load before the script, besides those that the root needs.
    share
        Directory that the guest sees as ``/run/guest`` and may write into; a temporary one unless given.
    channel
        Name of a virtio serial port of the guest, and the socket of this machine that it is connected to.
    disk
        Image of an ext4 file system whose files the guest reads there instead of over 9p.
    watchdog_s
        Time after which the emulator is killed (s).

    Raises
    ------
    GuestAbsentError
        This machine cannot have a guest: a package, the kernel or the architecture is missing.
    """
    check_tools()
    kernel = kernel_files.unpacked_kernel(cache)
    files = kernel_files.with_dependencies(kernel, (*ROOT_MODULES, *modules))
    with tempfile.TemporaryDirectory(prefix="guest-") as temporary:
        first = Path(temporary, "initramfs")
        first.write_bytes(initramfs.archive(INIT.read_text(), Path(BUSYBOX), files))
        place = share or Path(temporary, "share")
        place.mkdir(parents=True, exist_ok=True)
        (place / "start").write_text(script)
        (place / "status").unlink(missing_ok=True)
        started = time.monotonic()
        timed_out = _emulate(
            [*_command(kernel.image, first, place), *_port(channel), *_drive(disk)], watchdog_s
        )
        wall_s = time.monotonic() - started
        return GuestEnd(_status(place / "status"), timed_out, wall_s)


def check_tools() -> None:
    """Raise `GuestAbsentError` when a program is missing, here or in the guest, which has this machine's files."""
    for tool, package in TOOLS.items():
        if shutil.which(tool) is None:
            raise GuestAbsentError(f"{tool} is not installed (package {package})")


def _command(image: Path, first: Path, share: Path) -> list[str]:
    root = "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap"
    return [
        EMULATOR, "-accel", "tcg,thread=multi", "-cpu", PROCESSOR, "-smp", str(PROCESSORS), "-m", str(MEMORY_MB),
        "-nodefaults", "-display", "none", "-nic", "none", "-no-reboot", "-serial", "stdio",
        "-kernel", str(image), "-initrd", str(first), "-append", KERNEL_LINE,
        "-virtfs", root,
        "-virtfs", f"local,path={share},mount_tag=share,security_model=none",
    ]  # fmt: skip


def _port(channel: tuple[str, Path] | None) -> list[str]:
    """What the emulator must be told for a virtio serial port."""
    if channel is None:
        return []
    name, socket = channel
    return [
        "-device", "virtio-serial-pci", "-chardev", f"socket,id=port,path={socket}",
        "-device", f"virtserialport,chardev=port,name={name}",
    ]  # fmt: skip


def _drive(disk: Path | None) -> list[str]:
    """What the emulator must be told for a disk."""
    return [] if disk is None else ["-drive", f"file={disk},format=raw,if=virtio,readonly=on"]


def _emulate(command: list[str], watchdog_s: float) -> bool:
    """Run the emulator, its console to standard output; return whether it had to be killed."""
    environment = {**os.environ, "LC_ALL": "C"}
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with started(*command, env=environment, **pipes) as guest:
        killed = threading.Event()

        def kill() -> None:
            killed.set()
            guest.kill()

        watchdog = threading.Timer(watchdog_s, kill)
        watchdog.start()
        try:
            assert guest.stdout is not None
            for line in guest.stdout:
                sys.stdout.write(line.decode(errors="replace").replace("\r", ""))
                sys.stdout.flush()
        finally:
            watchdog.cancel()
    return killed.is_set()


def _status(file: Path) -> int | None:
    try:
        return int(file.read_text())
    except (OSError, ValueError):
        return None
