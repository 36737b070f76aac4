"""The USB port of the emulated board in the board's time: its pipes, and a link of `rig` over them."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from firmware_protocol import messages as m
from rig.devices.device import DeviceUrl
from rig.realtime.clock import VirtualClock
from sim_backend.ends.far_end import ARRIVED, PROGRESS
from sim_backend.ends.link import BUFFER_BYTES, MemoryLink
from tests.firmware.rp2040.emulator import Pico
from tests.firmware.supervised import Supervisor

ANSWER_US = 3_000.0  # a request is answered within: its packet, a tick, an answer's packet, a frame's rest
WORD_US = 5_000.0
LIFETIME_US = 20_000
URL = DeviceUrl("usb", "1209:0001", {}, "usb://1209:0001")


class UsbLine:
    def __init__(self, pico: Pico, endpoint: int = 1) -> None:
        self.pico = pico
        self.plugged = pico.ask("usb_plug", endpoint=endpoint)
        self.now_ns = round(pico.look()["now"])  # of the board

    def send(self, data: bytes, endpoint: int | None = None) -> None:
        self.pico.ask("usb_send", hex=data.hex(), **({} if endpoint is None else {"endpoint": endpoint}))

    def run(self, us: float, *, first: bool = False) -> bytes:
        """Advance time (with `first` only until bytes arrive); return the bytes."""
        answer = self.pico.ask("usb_run", us=us, first=first)
        assert not answer["broken"], answer
        self.now_ns = round(answer["now"])
        return bytes.fromhex(answer["hex"])

    def control(
        self, kind: int, request: int, value: int = 0, index: int = 0, length: int = 255
    ) -> tuple[int, bytes]:
        """Send a request on endpoint 0; return its status (0 or a negative errno) and its data."""
        answer = self.pico.ask(
            "usb_control", kind=kind, request=request, value=value, index=index, length=length
        )
        return answer["status"], bytes.fromhex(answer["hex"])

    def look(self) -> dict[str, Any]:
        return self.pico.ask("usb_look")


class UsbSupervisor(Supervisor):
    def __init__(self, line: UsbLine, dictionary_hash: int) -> None:
        super().__init__()
        self.line = line
        self.core: Any = SimpleNamespace(hash=dictionary_hash)  # the only member that a supervisor uses

    def receive(self, data: bytes) -> bytes:
        self.line.send(data)
        return self.line.run(ANSWER_US)

    def watch(self, us: float) -> None:
        """Supervise for `us` microseconds, once every 5 ms."""
        while us > 0.0:
            self.line.send(
                self.host.send(m.Command(self.host.answered, LIFETIME_US, int(m.Mode.SUPERVISE), 0, 0))
            )
            self.take(self.line.run(min(us, WORD_US)))
            us -= WORD_US


class EmulatedUsb(MemoryLink):
    """Link in virtual time to the emulated RP2040.

    The emulator advances only while the host writes or waits; bytes arrive when the emulated bus delivers them.
    """

    # Not super().__init__, which requires a simulated device in this process: it sets the fields that the inherited
    # methods read. Keep in step with MemoryLink.
    def __init__(self, line: UsbLine) -> None:
        self.url = URL
        self.clock = VirtualClock()
        self.line = None  # no script of faults
        self._usb = line
        self._began_ns = line.now_ns
        self._progress = np.zeros(PROGRESS, np.int64)
        self._arrived = np.zeros(BUFFER_BYTES, np.uint8)
        self._compiled = None
        self._failure: BaseException | None = None
        self._closed = False
        self._port = None

    def write(self, data: bytes) -> None:
        self._check_open()
        self._catch_up()
        self._usb.send(data)

    def truth(self) -> None:  # type: ignore[override]  # the emulated board has no plant
        return None

    def _catch_up(self) -> None:
        self._run(self.clock.now_ns(), first=False)

    def _wait(self, deadline_ns: int) -> bool:
        self._check_open()
        self._catch_up()
        if not self._progress[ARRIVED]:
            self._run(deadline_ns, first=True)
            self.clock.sleep_until(max(self.clock.now_ns(), min(deadline_ns, self._now_ns)))
        return bool(self._progress[ARRIVED])

    @property
    def _now_ns(self) -> int:
        return self._usb.now_ns - self._began_ns

    def _run(self, until_ns: int, *, first: bool) -> None:
        if until_ns > self._now_ns:
            microseconds = (until_ns - self._now_ns) * 1e-3
            self._buffer_for_host(self._usb.run(microseconds, first=first))
