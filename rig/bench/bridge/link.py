"""``moteus://``: a bridge as a process of the run, which begins and ends with its link.

The process speaks through a pair of sockets: when this end closes, by kill -9 too, it switches the drive off and ends.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import socket
import sys
from contextlib import suppress
from multiprocessing.context import SpawnProcess
from typing import Any

from rig.bench.bridge.library import Facts, library
from rig.config import presets, rig_model
from rig.core.errors import ConfigError, DeviceNotFoundError, RigError
from rig.core.model import RigModel
from rig.core.this_system import processors
from rig.devices.device import DeviceUrl
from rig.devices.local import die_with_parent, no_modules_from_here

if sys.platform == "linux":
    from rig.bench.bridge.serve import DRIVE_OPTIONS, Found, serve
    from rig.devices.descriptor import CLOSED, DescriptorLink

assert sys.platform == "linux"

START_S = 60.0  # the drive is asked some thirty questions, each three times at most
STOP_S = 5.0


def open_link(url: DeviceUrl, model: RigModel | None = None) -> BridgeLink:
    """Open ``moteus:///dev/fdcanusb?id=1&rig=mine.toml``; see `rig.devices.open_link` for what it raises.

    `rig` names the rig, a preset or a file, where no experiment does.
    """
    url.allow((*DRIVE_OPTIONS, "rig"))
    named = url.options.get("rig")
    if named is not None:
        model = rig_model(presets.load_named(named))
    if model is None:
        raise ConfigError(f"{url.text}: a bridge must know its rig", remedy="add ?rig=mine.toml to the URL")
    return BridgeLink(url, model)


class BridgeLink(DescriptorLink):
    """`rig.devices.device.Link` to a bridge.

    Attributes
    ----------
    drive
        The drive that was found.
    cpu
        Processor of the bridge, for the loop to share.
    """

    bytes_per_second: float | None = None

    def __init__(self, url: DeviceUrl, model: RigModel) -> None:
        library()  # compiled here, not by two processes
        context = multiprocessing.get_context("spawn")
        self._shared = context.RawArray(ctypes.c_byte, ctypes.sizeof(Facts))
        self.facts = Facts.from_buffer(self._shared)
        self.cpu = max(processors())
        ours, theirs = socket.socketpair()
        receiver, sender = context.Pipe(duplex=False)
        plain = {name: text for name, text in url.options.items() if name != "rig"}
        asked = DeviceUrl(url.scheme, url.place, plain, url.text)
        self._process: SpawnProcess = context.Process(
            target=_child,
            args=(asked, model, theirs, self._shared, self.cpu, sender),
            name="rig-bridge",
            daemon=True,
        )
        with no_modules_from_here():
            self._process.start()
        theirs.close()
        sender.close()
        try:
            found = self._announced(receiver)
        except BaseException:
            ours.close()
            self._end()
            raise
        ours.setblocking(False)
        self.drive, self.messages = found.drive, found.messages
        super().__init__(url, ours.detach())

    def _announced(self, receiver: Any) -> Found:
        with suppress(EOFError):
            if receiver.poll(START_S):
                said = receiver.recv()
                if isinstance(said, Found):
                    return said
                assert isinstance(said, RigError)
                raise said
        raise DeviceNotFoundError(
            "the bridge did not start", remedy="start it by hand to see why: rig bridge moteus"
        )

    def bus_facts(self) -> dict[str, float]:
        """What happened on the bus so far: replies, lost ones, round trips (µs), the drive's temperature (°C)."""
        return self.facts.as_mapping()

    def close(self) -> None:
        """End the process; the drive is off then."""
        if self._descriptor != CLOSED:
            os.close(self._descriptor)
            self._descriptor = CLOSED
            self._end()

    def _end(self) -> None:
        self._process.join(STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(STOP_S)


def _child(url: DeviceUrl, model: RigModel, host: socket.socket, shared: Any, cpu: int, pipe: Any) -> None:
    os.setsid()  # Ctrl-C is for the host, which brings the rig to rest
    die_with_parent()
    try:
        serve(
            url,
            model,
            host=host,
            announce=lambda place, found: pipe.send(found),
            facts=Facts.from_buffer(shared),
            cpu=cpu,
        )
    except RigError as error:
        pipe.send(error)
