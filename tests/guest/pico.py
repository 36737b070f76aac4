"""The emulated Raspberry Pi Pico that a guest can plug in: a process outside of the guest.

The bytes of USB/IP pass through a virtio serial port, the state of its pins through a file in the shared directory.
"""

import contextlib
import json
import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rig import config
from rig.config import presets
from rig.core.model import RigModel
from tests.conformance.started import started
from tests.firmware.rp2040 import emulator
from tests.guest import hits
from tests.guest.absent import GuestAbsentError

RIG = "koul-rigid"
# A hit with the law on the board; its rate is one that the board's emulator keeps up with, if slowly.
CHANGES: dict[str, Any] = {
    **hits.CHANGES,
    "controller.loop": "device",
    "controller.estimator": "fdm-butterworth-fixed",
    "controller.position_rate": 4_000,
    "controller.velocity_rate": 1_000,
    "controller.supervise_lifetime_s": 0.1,
    "wall.stiffness": 50.0,
    "wall.damping": 0.05,
    "trial.duration_s": 0.2,
}
PORT = "rig.usb"  # name of the virtio port
FACTS, STATUS = "pico.json", "pico-status.json"  # in the shared directory
PACE = 0.25  # at most: the guest is slow too, and what a host must do in time it must do in the board's


def model() -> RigModel:
    """Return the rig that the board is built for and that its motor moves."""
    return config.rig_model(presets.load(RIG))


@contextlib.contextmanager
def emulated_pico(share: Path) -> Iterator[Path]:
    """Build the firmware, start the board, and yield the socket of its USB/IP server."""
    with tempfile.TemporaryDirectory(prefix="pico-") as scratch:
        place = Path(scratch)
        try:
            built = emulator.image(model())
            modules = emulator.modules()
        except pytest.skip.Exception as absent:
            raise GuestAbsentError(str(absent)) from None
        (share / FACTS).write_text(json.dumps({"serial": emulator.FLASH_ID.upper()}))
        with _server(place, built.bin, modules, share / STATUS) as socket:
            yield socket


@contextlib.contextmanager
def _server(place: Path, image: Path, modules: Path, status: Path) -> Iterator[Path]:
    settings = {
        "image": str(image),
        "pins": emulator.PINS,
        "motor": emulator.motor_of(model(), 0.0),
        "flash": emulator.FLASH_ID,
        "socket": str(place / "usb"),
        "status": str(status),
        "pace": PACE,
    }
    file = place / "settings.json"
    file.write_text(json.dumps(settings))
    command = ["node", str(emulator.HERE / "usb_server.js"), str(file)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    environment = {**os.environ, "NODE_PATH": str(modules)}
    with started(*command, text=True, env=environment, **pipes) as server:
        assert server.stdout is not None
        if server.stdout.readline() != "ready\n":
            raise RuntimeError("the emulated board does not start")
        yield place / "usb"
