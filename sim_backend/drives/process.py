"""A simulated drive as a process of its own, that ends with the one that started it."""

from __future__ import annotations

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
    """A drive that is being served, and what a host opens."""

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

    Parameters
    ----------
    kind
        Of drive.
    model
        The rig.
    faults
        What goes wrong (`sim_backend.drives.faults`).
    settings
        Its stored configuration where it differs from the maker's, by name.
    firmware
        Version, one byte each: 0x010203 is 1.2.3.
    adapter
        Of a moteus at a serial line: ``uart``, the board's own port with checksums, or ``fdcanusb``.
    place
        Of the CAN bus (`sim_backend.drives.outlets`): of an ODrive, classic; of a moteus, CAN FD, and without one it is
        behind a pseudo-terminal.
    realtime
        Scheduling, as ``host.realtime``: a drive's timer never waits. A process of its own tries it.
    announce
        Called once with what a host opens.
    stop
        Ends it when set; in the main thread SIGINT and SIGTERM end it too.
    duration_s
        Ends it after this time (s).

    Raises
    ------
    ConfigError
        A rig that cannot hang on a drive, or a setting or a fault that there is not.
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
    raise ConfigError(f"unknown adapter {name}", remedy="choose uart or fdcanusb")


@contextmanager
def simulated_drive(kind: Kind, model: RigModel, **options: Any) -> Iterator[ServedDrive]:
    """Start a process that serves a drive (see `serve`); it ends with the context, and with this process.

    Raises `DeviceNotFoundError` when it does not come up.
    """
    by_hand = f"python -m sim_backend.drives {kind}"
    with start_announced(_child, kind, model, options, name=f"simulated {kind}", by_hand=by_hand) as path:
        yield ServedDrive(path)


def _child(announce: Callable[[str], None], kind: Kind, model: RigModel, options: Mapping[str, Any]) -> None:
    serve(kind, model, announce=announce, **{"realtime": "try", **options})
