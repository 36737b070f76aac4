"""Serve a simulated drive in real time, also in a separate process, which ends with the process that started it.

``python -m sim_backend.drives`` and tests use it.
"""

import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal

from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.core.process import start_announced
from rig.realtime.scheduling import BoardScheduling, obtained
from sim_backend.drives.bus import DriveModel, SimulatedAdapter
from sim_backend.drives.faults import DriveScript
from sim_backend.drives.fdcanusb import Fdcanusb, Uart
from sim_backend.drives.moteus import MoteusOptions, SimulatedMoteus
from sim_backend.drives.multiplex import NOP
from sim_backend.drives.odrive import OdriveOptions, SimulatedOdrive
from sim_backend.drives.serving import Serving
from sim_backend.drives.socket_can import SocketCan
from sim_backend.ends.stopping import stopped_by_signals

if sys.platform == "linux":
    from sim_backend.drives.outlets import DriveSockets, UnpluggableTerminal

assert sys.platform == "linux"

Kind = Literal["moteus", "odrive"]


@dataclass(frozen=True, slots=True)
class ServedDrive:
    """A simulated drive that is being served; `path` is the port or bus that a host opens."""

    path: str


def serve(
    kind: Kind,
    model: RigModel,
    *,
    faults: Iterable[str] = (),
    settings: Mapping[str, str] | None = None,
    firmware: int | None = None,
    adapter: str = "uart",
    place: str | None = None,
    realtime: str = "off",
    announce: Callable[[str], None] = print,
    stop: threading.Event | None = None,
    duration_s: float | None = None,
) -> None:
    """Serve a simulated drive until it is stopped.

    Raise `ConfigError` if the rig does not fit the drive, a setting, fault or adapter does not exist, or an ODrive has
    no bus.

    Parameters
    ----------
    kind
        Kind of drive: ``moteus`` or ``odrive``.
    model
        Rig to simulate.
    faults
        Scripted faults of the run (`sim_backend.drives.faults`).
    settings
        Stored settings of the drive, by name, that differ from the maker's.
    firmware
        Firmware version, one byte for each number: 0x010203 is 1.2.3.
    adapter
        Protocol of a moteus without a CAN bus: ``uart``, the port on its board, or ``fdcanusb``, the USB adapter.
    place
        CAN bus to use (`sim_backend.drives.outlets`): classic CAN for an ODrive, CAN FD for a moteus. Without a bus, a
        moteus is served at a pseudo-terminal; an ODrive needs a bus.
    realtime
        Scheduling: a value of ``host.realtime``.
    announce
        Called once with the port or bus that a host opens.
    stop
        Ends the run when it is set; in the main thread SIGINT and SIGTERM end it too.
    duration_s
        Ends the run after this time (s).
    """
    script, stop = DriveScript.of(faults), stop or threading.Event()
    drive: DriveModel
    spoken: SimulatedAdapter
    if kind == "odrive":
        drive, spoken = _odrive(model, settings, firmware), SocketCan()
        if place is None:
            raise ConfigError(
                "an ODrive needs a CAN bus", remedy="give an interface, or the path of a socket, with --bus"
            )
    else:
        drive = _moteus(model, settings, firmware)
        spoken = _adapter(adapter, drive) if place is None else SocketCan(fd=True, padding=NOP)
    script.check(drive.events)
    script = script if place is None else script.on_a_can_bus()
    with (
        UnpluggableTerminal() if place is None else DriveSockets(place) as port,
        stopped_by_signals(stop),
        obtained(BoardScheduling(realtime)) as granted,
    ):
        granted.enter_thread()
        try:
            announce(port.place)
            Serving(drive, spoken, port, script, stop).run(duration_s)
        finally:
            granted.leave_thread()


def _moteus(model: RigModel, settings: Mapping[str, str] | None, firmware: int | None) -> SimulatedMoteus:
    options = MoteusOptions(settings=settings or {})
    return SimulatedMoteus(model, options if firmware is None else replace(options, firmware=firmware))


def _odrive(model: RigModel, settings: Mapping[str, str] | None, firmware: int | None) -> SimulatedOdrive:
    options = OdriveOptions(settings=settings or {})
    if firmware is not None:
        options = replace(options, firmware=(firmware >> 16 & 0xFF, firmware >> 8 & 0xFF, firmware & 0xFF))
    return SimulatedOdrive(model, options)


def _adapter(name: str, drive: SimulatedMoteus) -> SimulatedAdapter:
    if name == "uart":
        return Uart(prefix=int(drive.settings.values["can.prefix"]))
    if name == "fdcanusb":
        return Fdcanusb()
    raise ConfigError(f"unknown adapter {name!r} for a moteus", remedy="choose uart or fdcanusb")


@contextmanager
def simulated_drive(kind: Kind, model: RigModel, **options: Any) -> Iterator[ServedDrive]:
    """Return a context that serves a drive from a new process; the process ends with the context or with this process.

    `options` are keyword arguments of `serve` (faults, settings, place, …). Raise `DeviceNotFoundError` if the process
    does not start.
    """
    by_hand = f"python -m sim_backend.drives {kind}"
    with start_announced(_child, kind, model, options, name=f"simulated {kind}", by_hand=by_hand) as path:
        yield ServedDrive(path)


def _child(announce: Callable[[str], None], kind: Kind, model: RigModel, options: Mapping[str, Any]) -> None:
    serve(kind, model, announce=announce, **{"realtime": "try", **options})
