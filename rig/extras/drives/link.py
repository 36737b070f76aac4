"""Open ``moteus://`` and ``odrive://`` URLs: start a bridge in a process that begins and ends with its link.

The two processes are connected by a pair of sockets: if this end closes, also by kill -9, the bridge (firmware on this
computer in front of a drive) switches the drive off and ends.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import socket
import sys
from contextlib import ExitStack
from typing import Any

from rig.config import presets, rig_model
from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.core.process import start_announced
from rig.core.this_system import processors
from rig.devices.device import DeviceUrl
from rig.extras.drives.library import BridgeFacts, library

if sys.platform == "linux":
    from rig.devices.descriptor import CLOSED, DescriptorLink
    from rig.extras.drives.address import address_of
    from rig.extras.drives.serve import Found, serve

assert sys.platform == "linux"


def open_link(url: DeviceUrl, model: RigModel | None = None) -> BridgeLink:
    """Open a drive, like ``moteus:///dev/fdcanusb?id=1&rig=mine.toml``; raise `RigError` if it is not usable.

    The option `rig` names the rig, a preset or a file; it replaces `model`.
    """
    named = url.options.get("rig")
    plain = {name: text for name, text in url.options.items() if name != "rig"}
    asked = DeviceUrl(url.scheme, url.place, plain, url.text)
    # Raise errors of the address now, not in the process of the bridge.
    address_of(asked)
    if named is not None:
        model = rig_model(presets.load_named(named))
    if model is None:
        raise ConfigError(
            f"{url.text}: the URL names no rig", remedy="add ?rig=FILE to the URL, a preset or a file"
        )
    return BridgeLink(asked, model)


class BridgeLink(DescriptorLink):
    """Link to a device (`rig.devices.device.Link`) that is a bridge (firmware in front of a drive) in another process.

    `drive` is the drive that was found, `process` the id of the bridge's process, `cpu` the processor on which the
    bridge runs; the control loop may use the same.
    """

    bytes_per_second: float | None = None

    def __init__(self, url: DeviceUrl, model: RigModel) -> None:
        # Compile here, so that not both processes compile.
        library()
        self.cpu = max(processors())
        ours, theirs = socket.socketpair()
        self._running = ExitStack()
        with theirs, open(os.memfd_create("bridge-facts"), "r+b", buffering=0) as shared:
            shared.truncate(ctypes.sizeof(BridgeFacts))
            self.facts = _facts_in(shared.fileno())
            ends = theirs.fileno(), shared.fileno()
            try:
                found: Found = self._running.enter_context(
                    start_announced(
                        _serve,
                        url,
                        model,
                        *ends,
                        self.cpu,
                        name="rig-bridge",
                        by_hand=f"rig serve {url.scheme}",
                        descriptors=ends,
                    )
                )
            except BaseException:
                # The other end is the child's; without an error `super().__init__` takes this one over.
                ours.close()
                raise
        ours.setblocking(False)
        self.drive, self.messages, self.process = found.drive, found.messages, found.process
        super().__init__(url, ours.detach())

    def bus_facts(self) -> dict[str, float]:
        """Return the statistics of the bus: replies, losses, round-trip times (µs), temperature of the drive (°C).

        `cycle_us` is the period (µs) of the samples that the drive sends unrequested; 0 if the bridge (firmware on this
        computer in front of a drive) polls them.
        """
        return {**self.facts.as_mapping(), "cycle_us": self.drive.cycle_us}

    def close(self) -> None:
        """Close the link; the bridge then switches the drive off, and its process ends."""
        if self._descriptor != CLOSED:
            os.close(self._descriptor)
            self._descriptor = CLOSED
            self._running.close()


def _facts_in(descriptor: int) -> BridgeFacts:
    return BridgeFacts.from_buffer(mmap.mmap(descriptor, ctypes.sizeof(BridgeFacts)))


def _serve(announce: Any, url: DeviceUrl, model: RigModel, host: int, shared: int, cpu: int) -> None:
    serve(
        url,
        model,
        host=socket.socket(fileno=host),
        announce=lambda place, found: announce(found),
        facts=_facts_in(shared),
        cpu=cpu,
    )
