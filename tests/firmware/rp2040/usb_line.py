"""The USB port of the emulated board, with a host that has its pipes open, in the board's time."""

from types import SimpleNamespace
from typing import Any

from firmware_protocol import messages as m
from tests.firmware.rp2040.emulator import Pico
from tests.firmware.supervised import Supervisor

ANSWER_US = 3_000.0  # a request is answered within: its packet, a tick, an answer's packet, a frame's rest
WORD_US = 5_000.0
LIFETIME_US = 20_000


class UsbLine:
    """The bytes to and from an emulated board that is plugged in."""

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
    """A host that supervises the law of an emulated board."""

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
