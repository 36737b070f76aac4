"""A host that supervises a law on the device tick by tick, and unpacks every BATCH."""

import ctypes
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

from firmware_protocol import messages as m
from firmware_protocol.connection import Connection, Received
from firmware_protocol.faults import Status
from firmware_protocol.messages import BATCH_LAYOUTS, Message, Mode, Role
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import encode_block
from firmware_protocol.transfer import set_parameters
from firmware_protocol.wire import FORMATS
from rig.core.model import RigModel
from sim_backend.board.firmware import Core, FirmwareDevice
from sim_backend.board.safety import UNITS_PER_SECOND
from tests.conformance.host import RUN_PARAMETERS
from tests.conformance.rigs import rotary_rig, unmeasured

RATE = 2_000
SUPERVISED_HZ = 200
_U32 = 2**32 - 1


class Sample(NamedTuple):
    """One tick of a BATCH; `measured` is None in a layout without it."""

    index: int
    count: int
    commanded: int
    measured: int | None


@dataclass
class Frame:
    message: m.Batch
    sequence: int
    samples: list[Sample]


def samples_of(batch: m.Batch) -> list[Sample]:
    """Unpack a BATCH as PROTOCOL.md defines it, without the receiver's code."""
    kinds = BATCH_LAYOUTS[batch.layout]
    packer = struct.Struct("<" + "".join(FORMATS[kind] for kind in kinds))
    assert len(batch.data) % packer.size == 0
    samples, count = [], batch.base_count
    for n, (moved, commanded, *measured) in enumerate(packer.iter_unpack(batch.data)):
        count = (count + moved + 2**31) % 2**32 - 2**31
        samples.append(
            Sample((batch.first_index + n) & _U32, count, commanded, measured[0] if measured else None)
        )
    return samples


class Supervisor:
    """The host of a device that runs a law: stores its messages, sends SUPERVISE every 5 ms; `core` is the device."""

    core: Core

    def __init__(self) -> None:
        self.host = Connection(Role.HOST)
        self.states: list[m.State] = []
        self.frames: list[Frame] = []
        self.nonce, self.session, self.crc, self.rate = 0, 0, 0, 0
        self.since = 0  # ticks until the next SUPERVISE

    def receive(self, data: bytes) -> bytes:
        raise NotImplementedError

    def tick(self) -> None:
        raise NotImplementedError

    # ------------------------------------------------------------------ the conversation

    def take(self, data: bytes) -> list[Message]:
        """Store STATE and BATCH; return the other messages."""
        answers = []
        self.host.receive_data(data)
        while (event := self.host.next_event()) is not None:
            assert isinstance(event, Received)
            if isinstance(event.message, m.State):
                self.states.append(event.message)
            elif isinstance(event.message, m.Batch):
                self.frames.append(Frame(event.message, event.sequence, samples_of(event.message)))
            else:
                answers.append(event.message)
        counted = self.host.statistics
        assert counted.malformed + counted.crc_errors + counted.cobs_errors + counted.stale_session == 0
        return answers

    def ask(self, message: Message, session: int | None = None) -> m.Ack:
        (answer,) = self.take(self.receive(self.host.send(message, session=session)))
        assert isinstance(answer, m.Ack)
        return answer

    def identify(self) -> None:
        self.take(self.receive(self.host.send(m.Identify(1, 0))))

    def configure(self, **values: Value) -> m.Ack:
        self.nonce += 1
        for message in set_parameters(encode_block(values), self.nonce):
            ack = self.ask(message)
            if ack.status:
                break
        return ack

    def arm(self) -> m.Ack:
        self.nonce, self.session, self.since = self.nonce + 1, self.session + 1, 0
        return self.ask(m.Arm(self.nonce, self.core.hash, self.crc), self.session)

    def prepare(self, **values: Value) -> None:
        self.identify()
        given = {**RUN_PARAMETERS, "position_rate": RATE, **values}
        self.rate = int(given["position_rate"])
        ack = self.configure(**given)
        assert ack.status == Status.OK, ack
        self.crc = ack.crc

    def begin(self, **values: Value) -> Self:
        self.prepare(**values)
        assert self.arm().status == Status.OK
        return self

    def disarm(self, flags: int = 0) -> m.Ack:
        self.nonce += 1
        return self.ask(m.Disarm(self.nonce, flags))

    def command(self, mode: Mode = Mode.SUPERVISE, current: int = 0, lifetime_us: int = 20_000) -> None:
        self.take(
            self.receive(self.host.send(m.Command(self.host.answered, lifetime_us, int(mode), 0, current)))
        )

    def supervise(self) -> None:
        """Run one tick, after a SUPERVISE if it is due."""
        if self.since == 0:
            self.command()
            self.since = max(1, self.rate // SUPERVISED_HZ)
        self.since -= 1
        self.tick()

    @property
    def samples(self) -> list[Sample]:
        return [sample for frame in self.frames for sample in frame.samples]


class Board(Supervisor):
    """A board with a timer; `count`, `measured` and `inputs` are the values that it samples."""

    def __init__(
        self, library: ctypes.CDLL, model: RigModel | None = None, *, law_maximum: int = 2, **options: int
    ) -> None:
        super().__init__()
        self.library = library
        self.core = Core(
            library, unmeasured(model or rotary_rig(effort_limit=10.0)), law_maximum=law_maximum, **options
        )
        self.count, self.edge_time, self.measured, self.inputs, self.late = 0, 0, 0, 0, 0
        self.missed = 0  # ticks before the next one
        self.fed: list[Sample] = []  # input and active current of each tick
        self.core.start()

    def receive(self, data: bytes) -> bytes:
        return self.core.receive(data)

    def tick(self) -> None:
        status = self.core.status
        time = status.due + self.late + self.missed * UNITS_PER_SECOND // status.rate
        self.missed = 0
        world = (time, self.count, self.edge_time, self.measured, self.inputs)
        self.library.host_set_world(self.core.address, *world)
        self.strike()
        self.fed.append(Sample(self.core.status.sample_index, self.count, status.current, self.measured))
        self.take(self.core.take())

    def strike(self) -> None:
        """Run the tick of the core, then its main loop."""
        self.library.host_tick(self.core.address)

    def run(self, counts: Iterable[int]) -> None:
        for self.count in counts:
            self.supervise()


class Rig(Supervisor):
    def __init__(self, library: ctypes.CDLL, model: RigModel, **options: Any) -> None:
        super().__init__()
        self.device = FirmwareDevice(model, library=library, **options)
        self.core = self.device.core

    def receive(self, data: bytes) -> bytes:
        return self.device.receive(data)

    def tick(self) -> None:
        self.take(self.device.tick())
