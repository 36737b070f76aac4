"""Facts about a serial port: its driver, its USB adapter, and its settings.

`rig.doctor` and the links to serial ports use it. `port_facts` reads sysfs and, for an open port, the line itself; it
must not open or change a port: opening moves the modem lines and may reset the board.
"""

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

from serial.tools import list_ports

from rig.core.check import Check, Outcome

if sys.platform == "linux":
    from rig.devices import _tty as tty

FTDI_VENDOR = "0403"
# An FTDI adapter holds received bytes for its latency timer (16 ms by default) to pass on more at once.
LONGEST_LATENCY_MS = 1
NO_TIMER_DRIVERS = frozenset({"cdc_acm"})  # the board itself decides when a packet leaves
WHY = "a port that delays bytes delays every command; a port that other programs can open loses bytes"
_PSEUDO = ("/dev/pts/", "/dev/pty")


@dataclass(frozen=True, slots=True, kw_only=True)
class PortFacts:
    """Facts about one serial port.

    Attributes
    ----------
    port, device
        Given name of the port, and its device node with symbolic links resolved.
    driver
        Kernel driver: ``ftdi_sio``, ``cdc_acm``, …; None for a pseudo-terminal, or if sysfs does not name one.
    vid_pid, serial_number, product
        Vendor and product id, serial number and product name of the USB device; None without a USB device.
    by_id
        Names in ``/dev/serial/by-id`` that stay the same wherever the device is plugged in.
    ftdi
        True for an FTDI adapter, which delays received bytes until its latency timer expires.
    latency_timer_ms
        Latency timer of an FTDI adapter (ms); None on all other ports.
    low_latency
        Low-latency mode as the driver reports it; None if the driver has none, or if the port is not open here.
    exclusive, hangs_up, dtr
        True if other programs are refused the port, if closing it drops DTR, and if DTR is asserted; None if the line
        does not report this, or if the port is not open here.
    """

    port: str
    device: str
    driver: str | None = None
    vid_pid: str | None = None
    serial_number: str | None = None
    product: str | None = None
    by_id: tuple[str, ...] = ()
    ftdi: bool = False
    latency_timer_ms: int | None = None
    low_latency: bool | None = None
    exclusive: bool | None = None
    hangs_up: bool | None = None
    dtr: bool | None = None

    def problems(self) -> list[Check]:
        """Return a failed check for each setting of the port that is slow or unsafe, with a command to correct it."""
        found = []
        if self.latency_timer_ms is not None and self.latency_timer_ms > LONGEST_LATENCY_MS:
            found.append(
                self._problem(
                    f"the FTDI adapter delays received bytes by up to {self.latency_timer_ms} ms",
                    f"echo {LONGEST_LATENCY_MS} | sudo tee {quote(str(latency_timer_path(self.device)))}; permanently: "
                    "rig doctor --print-udev",
                )
            )
        elif self.low_latency is False and self.driver is not None and self.driver.startswith("serial"):
            text = f"the driver {self.driver} refused the low-latency mode"
            found.append(self._problem(text, f"sudo setserial {quote(self.device)} low_latency"))
        if self.exclusive is False and not is_pseudo(self.device):
            text = "other programs can open the port and take bytes away"
            found.append(
                self._problem(text, f"close the programs that this lists: fuser -v {quote(self.device)}")
            )
        if self.hangs_up:
            text = "closing the port will drop DTR, which resets many boards"
            found.append(self._problem(text, f"stty -F {quote(self.device)} -hupcl"))
        return found

    def _problem(self, text: str, remedy: str) -> Check:
        return Check("port", Outcome.REFUSED, f"{self.port}: {text}", remedy, WHY)


def port_facts(port: str, descriptor: int | None = None, *, root: Path = Path("/")) -> PortFacts:
    """Return the facts about a serial port, without opening or changing it.

    Parameters
    ----------
    port
        Name of the port, or of a symbolic link to it. If it does not exist, all facts are None.
    descriptor
        Descriptor of the open port, to read the facts that only the line itself reports.
    root
        Directory that contains ``sys`` and ``dev`` (for tests).
    """
    device = os.path.realpath(port)
    usb = _usb_device(device, root)
    vendor, product_id = _read(usb, "idVendor"), _read(usb, "idProduct")
    driver = _driver(device, root)
    return PortFacts(
        port=port,
        device=device,
        driver=driver,
        vid_pid=f"{vendor}:{product_id}" if vendor and product_id else None,
        serial_number=_read(usb, "serial"),
        product=_read(usb, "product"),
        by_id=_by_id(device, root),
        ftdi=driver == "ftdi_sio" or vendor == FTDI_VENDOR,
        latency_timer_ms=_latency_timer(device, root),
        **(_line_facts(descriptor, driver) if descriptor is not None else {}),
    )


def available_ports() -> list[tuple[str, str]]:
    """Return name and description of every serial port with hardware that pyserial finds."""
    return [(p.device, p.description) for p in sorted(list_ports.comports()) if p.hwid != "n/a"]


def ports_in_words() -> str:
    """Return the names of the available serial ports as text, for a message's remedy."""
    found = [name for name, _ in available_ports()]
    return f"available ports: {', '.join(found)}" if found else "no serial port was found"


def is_pseudo(device: str) -> bool:
    """Return True if a device node such as ``/dev/pts/3`` is a pseudo-terminal."""
    return device.startswith(_PSEUDO)


def latency_timer_path(device: str, root: Path = Path("/")) -> Path:
    """Return the path of the file with the latency timer (ms) of an FTDI adapter; it may not exist."""
    return root / "sys/bus/usb-serial/devices" / os.path.basename(device) / "latency_timer"


def _line_facts(descriptor: int, driver: str | None) -> dict[str, bool | None]:
    if sys.platform == "linux":
        return {
            "low_latency": None if driver in NO_TIMER_DRIVERS else tty.low_latency(descriptor),
            "exclusive": tty.is_exclusive(descriptor),
            "hangs_up": tty.hangs_up(descriptor),
            "dtr": tty.dtr(descriptor),
        }
    else:
        return {}


def _sysfs_directory(device: str, root: Path) -> Path | None:
    """Return the sysfs directory of a serial port's device; None if it is missing, as for pseudo-terminals."""
    if is_pseudo(device):
        return None
    node = root / "sys/class/tty" / os.path.basename(device) / "device"
    return node.resolve() if node.exists() else None


def _driver(device: str, root: Path) -> str | None:
    node = _sysfs_directory(device, root)
    if node is None or not (node / "driver").exists():
        return None
    return (node / "driver").resolve().name


def _usb_device(device: str, root: Path) -> Path | None:
    """Return the sysfs directory of a port's USB device (the nearest parent directory with a vendor id), else None."""
    node = _sysfs_directory(device, root)
    while node is not None and node != node.parent:
        if (node / "idVendor").exists():
            return node
        node = node.parent
    return None


def _read(directory: Path | None, name: str) -> str | None:
    if directory is None:
        return None
    try:
        return (directory / name).read_text("utf-8", "replace").strip() or None
    except OSError:
        return None


def _latency_timer(device: str, root: Path) -> int | None:
    path = latency_timer_path(device, root)
    text = _read(path.parent, path.name)
    return int(text) if text is not None and text.isdecimal() else None


def _by_id(device: str, root: Path) -> tuple[str, ...]:
    return tuple(sorted(_names_of(device, root / "dev/serial/by-id")))


def _names_of(device: str, directory: Path) -> Iterator[str]:
    try:
        names = os.listdir(directory)
    except OSError:
        return
    for name in names:
        if os.path.realpath(directory / name) == device:
            yield str(directory / name)
