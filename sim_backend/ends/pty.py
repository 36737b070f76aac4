"""Run the simulated rig as a separate process in real time, behind a pseudo-terminal or a Unix socket (`line`).

The rig behaves like a USB serial device. The device is the compiled firmware, timed by `board_time`, or, without a C
compiler, the device in Python, timed by `real_time`. `rig.devices` loads it.
"""

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

POSITION_RATE_MINIMUM, POSITION_RATE_DEFAULT = 50, 1_000  # Hz
POSITION_RATE_MAXIMUM = 4_000  # Hz; faster, an ordinary kernel wakes a host too late to reply in each tick
FIRMWARE_RATE_MAXIMUM = 20_000  # Hz, with the law on the device; faster, a line of 3 Mbaud is full


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

    Raise `ConfigError` if the rate is out of range, `link_path` exists and is not a symbolic link, the firmware cannot
    be compiled, the file `hand` does not exist, or no person holds the rig's handle.

    Parameters
    ----------
    model
        Rig to simulate.
    rate
        Tick rate of the device until the host configures one (Hz).
    seed
        Seed of the sensor noise.
    name
        Name of the device; by default the name of the model.
    firmware
        True: compiled firmware that can run the law. False: device in Python. None: compiled firmware without a law, or
        the device in Python if this computer cannot compile the firmware.
    hand
        File through which a person drives the hand (`rig.realtime.hand`); without it the hand plays its script.
    socket
        Path of a Unix socket to create, removed at the end; by default a pseudo-terminal is used.
    announce
        Called once with the path of the port, when a host can open it.
    stop_event
        Ends the run when it is set.
    link_path
        Path of a symbolic link to the port, for a fixed name; removed at the end.
    duration_s
        Ends the run after this time (s).

    Notes
    -----
    In the main thread, SIGINT (Ctrl-C) and SIGTERM also end the run, cleanly.
    """
    maximum = FIRMWARE_RATE_MAXIMUM if firmware else POSITION_RATE_MAXIMUM
    if not POSITION_RATE_MINIMUM <= rate <= maximum:
        raise ConfigError(
            f"rate = {rate} Hz is outside {POSITION_RATE_MINIMUM} … {maximum} Hz",
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
        keep_truth=False,  # the record would grow without bound, and no caller could read it
    )
    for message in messages:
        print(message, file=sys.stderr)
    with PseudoTerminal() if socket is None else Socket(Path(socket)) as port:
        body = (
            BoardTime(device, port.loop_port(), stop, hung_up=port.next_host)
            if isinstance(device, FirmwareDevice)
            else RealTime(device, port, stop)
        )
        with (
            _drive_hand(device, model, hand),
            _symbolic_link(link_path, port.place),
            stopped_by_signals(stop),
        ):
            announce(str(link_path) if link_path is not None else port.place)
            body.run(duration_s)


@contextlib.contextmanager
def _drive_hand(
    device: SimulatedDevice | FirmwareDevice, model: RigModel, hand: str | Path | None
) -> Iterator[None]:
    """Return a context in which a person moves the rig's hand through the file `hand`; without a file, do nothing."""
    if hand is None:
        yield
        return
    with SharedHand.open(hand) as shared:

        def tell(hand: float, handle: float, velocity: float) -> None:
            shared.tell(HandMotion(device.time_ns, hand, handle, velocity))

        device.hardware.drive_hand(DrivenHand(model, shared.read, tell))
        yield


@contextlib.contextmanager
def _symbolic_link(link_path: str | Path | None, target: str) -> Iterator[None]:
    if link_path is None:
        yield
        return
    link = Path(link_path)
    if link.exists() and not link.is_symlink():
        raise ConfigError(
            f"{link} exists and is not a symbolic link", remedy="remove it, or give another path for the link"
        )
    try:
        link.unlink(missing_ok=True)
        link.symlink_to(target)
    except OSError as error:
        raise ConfigError(
            f"the link {link} cannot be created: {error}",
            remedy="give a path in an existing directory with write permission",
        ) from error
    try:
        yield
    finally:
        if link.is_symlink() and os.readlink(link) == target:
            link.unlink()
