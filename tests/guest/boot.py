"""Boot a Linux guest on this machine's root, run one script in it, and return how it ended.

The guest reads this machine's files over 9p, under a layer in memory, and writes into one shared directory. It has no
network. Emulation by TCG needs no rights, and is ten to twenty times slower than the machine.
"""

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
PROCESSOR = "Nehalem"  # x86-64-v2, the least for numpy and pyarrow: wider vectors take longer to emulate
PROCESSORS = 2
WATCHDOG_S = 480.0
INIT = Path(__file__).with_name("init.sh")
KERNEL_LINE = (
    "console=ttyS0 quiet loglevel=4 panic=-1 nokaslr mitigations=off clocksource=hpet random.trust_cpu=on"
)


@dataclass(frozen=True, slots=True)
class GuestEnd:
    """The end of a guest: its status, and how long it ran."""

    status: int | None  # of the script; None if the guest ended before it
    timed_out: bool  # killed by the watchdog
    wall_s: float


def run_in_guest(
    script: str, cache: Path, *, modules: Iterable[str], share: Path, channel: tuple[str, Path] | None, disk: Path,
    watchdog_s: float,
) -> GuestEnd:  # fmt: skip
    """Boot a guest, run a bash script in it as root, and copy its console to standard output.

    `cache` stores the kernel between calls. The guest has `share` as ``/run/guest``, reads the files of `disk` (ext4)
    there instead of over 9p, and has a virtio serial port for `channel`: its name and a socket of this machine.
    """
    check_tools()
    kernel = kernel_files.unpacked_kernel(cache)
    files = kernel_files.with_dependencies(kernel, (*ROOT_MODULES, *modules))
    with tempfile.TemporaryDirectory(prefix="guest-") as temporary:
        first = Path(temporary, "initramfs")
        first.write_bytes(initramfs.archive(INIT.read_text(), Path(BUSYBOX), files))
        (share / "start").write_text(script)
        began = time.monotonic()
        drive = ["-drive", f"file={disk},format=raw,if=virtio,readonly=on"]
        timed_out = _emulate([*_command(kernel.image, first, share), *_port(channel), *drive], watchdog_s)
        return GuestEnd(_status(share / "status"), timed_out, time.monotonic() - began)


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
    if channel is None:
        return []
    name, socket = channel
    return [
        "-device", "virtio-serial-pci", "-chardev", f"socket,id=port,path={socket}",
        "-device", f"virtserialport,chardev=port,name={name}",
    ]  # fmt: skip


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
