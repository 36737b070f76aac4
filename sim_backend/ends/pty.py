"""Run the simulated rig as a process of its own, in real time, behind a pseudo-terminal or a socket (`line`).

The device is the firmware under the clock of `board_time`, or the readable device under that of `real_time` where
nothing compiles it. It mirrors a USB serial device.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.realtime.hand import HandMotion, SharedHand
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.board.make_device import make_device
from sim_backend.ends.board_time import BoardTime
from sim_backend.ends.real_time import RealTime
from sim_backend.ends.stopping import stopped_by_signals
from sim_backend.mechanics.driven_hand import DrivenHand

if sys.platform == "linux":
    from sim_backend.ends.line import PseudoTerminal, Socket

assert sys.platform == "linux"

POSITION_RATE_DEFAULT = 1_000
POSITION_RATE_MAXIMUM = 4_000  # that a host answers tick by tick, as an ordinary kernel wakes it
FIRMWARE_RATE_MAXIMUM = 20_000  # of a law on the device; beyond, a line of 3 Mbaud is full


def serve(
    model: RigModel,
    *,
    rate: int = POSITION_RATE_DEFAULT,
    seed: int = 0,
    name: str | None = None,
    firmware: bool | None = None,
    hand: str | Path | None = None,
    socket: str | Path | None = None,
    announce: Callable[[str], None] = print,
    stop_event: threading.Event | None = None,
    link_path: str | Path | None = None,
    duration_s: float | None = None,
) -> None:
    """Run a simulated rig behind a port until it is stopped.

    Parameters
    ----------
    model
        The physics.
    rate
        Ticks a second (Hz) that the device advertises and runs until it is configured.
    seed
        Of the sensor noise.
    name
        What the device calls itself; the model's name unless given.
    firmware
        True: the firmware itself, compiled for this machine, which can run the law. False: the readable device. Unless
        given, the firmware without its laws where this machine can compile it, else the readable device.
    hand
        File through which a person drives the hand at the handle (`rig.realtime.hand`); without one it plays its
        script.
    socket
        Path of a Unix socket to be made and removed at the end; a pseudo-terminal unless given.
    announce
        Called once with the path of the port, when a host can open it.
    stop_event
        Ends the run when it is set.
    link_path
        A symbolic link to make to the port, for a name that stays; removed at the end.
    duration_s
        Ends the run after this time (s).

    Notes
    -----
    Called in the main thread it also ends, cleanly, on SIGINT (Ctrl-C) and SIGTERM.

    Raises
    ------
    ConfigError
        A rate that the port cannot carry, `link_path` exists and is no symbolic link, or the firmware cannot be made;
        no such hand, or a rig that is not held by a person.
    """
    maximum = FIRMWARE_RATE_MAXIMUM if firmware else POSITION_RATE_MAXIMUM
    if not 50 <= rate <= maximum:
        raise ConfigError(
            f"rate = {rate} Hz is outside 50 … {maximum}",
            remedy="run faster in virtual time (sim://)"
            + ("" if firmware else f", or with the law on the device, up to {FIRMWARE_RATE_MAXIMUM} Hz"),
        )
    stop = stop_event or threading.Event()
    device, messages = make_device(
        model,
        firmware,
        name=name,
        position_rate_default=rate,
        position_rate_maximum=maximum,
        seed=seed,
        keep_truth=False,  # it would grow without bound, and could not be read
    )
    for message in messages:
        print(message, file=sys.stderr)
    with PseudoTerminal() if socket is None else Socket(Path(socket)) as port:
        body = (
            BoardTime(device, port.loop_port(), stop, hung_up=port.next_host)
            if isinstance(device, FirmwareDevice)
            else RealTime(device, port, stop)
        )
        with _drive_hand(device, model, hand), _link(link_path, port.place), stopped_by_signals(stop):
            announce(str(link_path) if link_path is not None else port.place)
            body.run(duration_s)


@contextlib.contextmanager
def _drive_hand(
    device: SimulatedDevice | FirmwareDevice, model: RigModel, hand: str | Path | None
) -> Iterator[None]:
    """Let a person drive the hand, if there is a file for it."""
    if hand is None:
        yield
        return
    with SharedHand.open(hand) as shared:

        def tell(hand: float, handle: float, velocity: float) -> None:
            shared.tell(HandMotion(device.time_ns, hand, handle, velocity))

        device.hardware.drive_hand(DrivenHand(model, shared.read, tell))
        yield


@contextlib.contextmanager
def _link(link_path: str | Path | None, target: str) -> Iterator[None]:
    """Keep a symbolic link to the port while it is open."""
    if link_path is None:
        yield
        return
    link = Path(link_path)
    if link.exists() and not link.is_symlink():
        raise ConfigError(f"{link} exists and is not a symbolic link", remedy="choose another path")
    try:
        link.unlink(missing_ok=True)
        link.symlink_to(target)
    except OSError as error:
        raise ConfigError(
            f"the link {link} cannot be created: {error}", remedy="choose another path"
        ) from error
    try:
        yield
    finally:
        if link.is_symlink() and os.readlink(link) == target:
            link.unlink()
