"""A simulated drive as a process of its own, that ends with the one that started it."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

from rig.core.errors import ConfigError, DeviceNotFoundError
from rig.core.model import RigModel
from sim_backend.drives.bus import Adapter, Drive
from sim_backend.drives.can_simple import SocketCan
from sim_backend.drives.faults import Script
from sim_backend.drives.fdcanusb import Fdcanusb, Uart
from sim_backend.drives.moteus import MoteusOptions, SimulatedMoteus
from sim_backend.drives.odrive import OdriveOptions, SimulatedOdrive
from sim_backend.drives.outlets import CanBus, Terminal
from sim_backend.drives.serving import Serving

Kind = Literal["moteus", "odrive"]
START_TIMEOUT_S = 60.0  # the first start compiles the plant
STOP_TIMEOUT_S = 5.0
PR_SET_PDEATHSIG = 1  # linux/prctl.h


@dataclass(frozen=True, slots=True)
class Served:
    """A drive that is being served: what a host opens, and its process."""

    path: str
    process: Any


def serve(
    kind: Kind,
    model: RigModel,
    *,
    faults: Iterable[str] = (),
    settings: Mapping[str, str] | None = None,
    firmware: int | None = None,
    adapter: str = "uart",
    place: str | None = None,
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
        Of a moteus: ``uart``, the board's own port with checksums, or ``fdcanusb``.
    place
        Of the ODrive's CAN bus (`sim_backend.drives.outlets`).
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
    script, stop = Script.of(faults), stop or threading.Event()
    drive: Drive
    spoken: Adapter
    if kind == "odrive":
        drive, spoken, script = _odrive(model, settings, firmware), SocketCan(), script.on_a_can_bus()
        if place is None:
            raise ConfigError(
                "no CAN bus for the ODrive", remedy="give an interface, or the path of a socket"
            )
        opened: Terminal | CanBus = CanBus(place)
    else:
        drive, spoken = _moteus(model, settings, firmware), _adapter(adapter)
        opened = Terminal()
    with opened as port, _signals(stop):
        announce(port.place)
        Serving(drive, spoken, port, script, stop).run(duration_s)


def _moteus(model: RigModel, settings: Mapping[str, str] | None, firmware: int | None) -> SimulatedMoteus:
    options = MoteusOptions(settings=settings or {})
    return SimulatedMoteus(model, options if firmware is None else replace(options, firmware=firmware))


def _odrive(model: RigModel, settings: Mapping[str, str] | None, firmware: int | None) -> SimulatedOdrive:
    options = OdriveOptions(settings=settings or {})
    if firmware is not None:
        options = replace(options, firmware=(firmware >> 16 & 0xFF, firmware >> 8 & 0xFF, firmware & 0xFF))
    return SimulatedOdrive(model, options)


def _adapter(name: str) -> Adapter:
    adapters: dict[str, Callable[[], Adapter]] = {"uart": Uart, "fdcanusb": Fdcanusb}
    if name not in adapters:
        raise ConfigError(f"adapter = {name} is unknown", remedy=f"one of {', '.join(adapters)}")
    return adapters[name]()


@contextmanager
def simulated_drive(kind: Kind, model: RigModel, **options: Any) -> Iterator[Served]:
    """Start a process that serves a drive (see `serve`); it ends with the context, and with this process.

    Raises `DeviceNotFoundError` when it does not come up.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(
        target=_child, args=(kind, model, options, sender), name="rig-drive", daemon=True
    )
    process.start()
    sender.close()
    try:
        yield Served(_announced(receiver, kind), process)
    finally:
        process.terminate()
        process.join(STOP_TIMEOUT_S)
        if process.is_alive():
            process.kill()
            process.join(STOP_TIMEOUT_S)


def _child(kind: Kind, model: RigModel, options: Mapping[str, Any], pipe: Any) -> None:
    os.setsid()  # Ctrl-C is for the host
    die_with_parent()
    serve(kind, model, announce=pipe.send, **options)


def die_with_parent() -> None:
    """Ask Linux for SIGTERM when the parent dies, also of kill -9."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _announced(receiver: Any, kind: str) -> str:
    with suppress(EOFError):
        if receiver.poll(START_TIMEOUT_S):
            return str(receiver.recv())
    raise DeviceNotFoundError(
        f"the simulated {kind} did not start",
        remedy=f"start it by hand to see why: python -m sim_backend.drives {kind}",
    )


@contextmanager
def _signals(stop: threading.Event) -> Iterator[None]:
    """Let SIGINT and SIGTERM end it, where they can be caught."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: stop.set()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
