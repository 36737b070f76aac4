"""The guest's first file system: busybox, modules and one script, as an archive that the kernel unpacks.

The format is the "newc" of Documentation/driver-api/early-userspace/buffer-format.rst: a header of hexadecimal
numbers, the name, the content, each padded to four bytes.
"""

import stat
from collections.abc import Iterable
from pathlib import Path

DIRECTORY, EXECUTABLE, PLAIN = stat.S_IFDIR | 0o755, stat.S_IFREG | 0o755, stat.S_IFREG | 0o644
MOUNT_POINTS = ("bin", "dev", "disk", "lower", "modules", "new", "proc", "sys", "upper")


def archive(init: str, busybox: Path, modules: Iterable[Path]) -> bytes:
    """Return an archive with `init`, busybox and the modules, and their order in ``/modules/order``."""
    content = b"".join(_entry(name, DIRECTORY, b"") for name in MOUNT_POINTS)
    content += _entry("init", EXECUTABLE, init.encode())
    content += _entry("bin/busybox", EXECUTABLE, busybox.read_bytes())
    order = ""
    for module in modules:
        content += _entry(f"modules/{module.name}", PLAIN, module.read_bytes())
        order += f"{module.name}\n"
    content += _entry("modules/order", PLAIN, order.encode())
    return content + _entry("TRAILER!!!", 0, b"")


def _entry(name: str, mode: int, content: bytes) -> bytes:
    """Return the archive entry of one file; inode, owner, times and devices are not used."""
    numbers = (0, mode, 0, 0, 1, 0, len(content), 0, 0, 0, 0, len(name) + 1, 0)
    head = b"070701" + b"".join(b"%08X" % number for number in numbers) + name.encode() + b"\0"
    return _pad(head) + _pad(content)


def _pad(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)
