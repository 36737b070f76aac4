"""A device that sends given counts as if its own law ran: BATCH frames, and a STATE now and then.

It has a script instead of a plant and a list of currents instead of a law, so that a test can compute what must arrive.
Its sent frames can be changed one by one.
"""

from collections.abc import Callable, Sequence
from zlib import crc32

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Status
from firmware_protocol.framing import decode_frame, encode_frame
from firmware_protocol.packing import pack, pack_batch_samples, type_id_of, unpack
from firmware_protocol.transfer import Assembler
from rig.devices.port import LoopPort
from rig.realtime.callbacks import callback_plugs
from rig.realtime.clock import VirtualClock

U32 = 1 << 32
Mangle = Callable[[int, bytes], Sequence[bytes]]  # number of a BATCH, its bytes → what arrives instead


class BatchDevice:
    """A scripted device in virtual time.

    Parameters
    ----------
    counts
        Of each tick under supervision.
    currents
        What its law gives for each of them; none: zero.
    period_ns, samples, layout, states_every
        Length of a tick, samples in a frame, their layout, ticks between two STATEs.
    first_index
        Sample index of the first supervised tick.
    mangle
        What becomes of each BATCH.
    missing
        Ticks that the device itself misses.
    """

    def __init__(
        self,
        counts: Sequence[int],
        currents: Sequence[int] = (),
        *,
        session: int = 7,
        period_ns: int = 1_000_000,
        samples: int = 5,
        layout: int = 0,
        states_every: int = 5,
        first_index: int = 100,
        mangle: Mangle = lambda number, frame: [frame],
        missing: Sequence[int] = (),
    ) -> None:
        self.clock = VirtualClock(0)
        self.counts, self.currents = counts, currents
        self.session, self.period_ns, self.samples, self.layout = session, period_ns, samples, layout
        self.states_every, self.mangle, self.missing = states_every, mangle, set(missing)
        self.index = first_index - 1
        self.supervised = False
        self.played = 0
        self.state = State.ARMED
        self.fault = 0
        self.limits = 0
        self.phase = 3
        self.time_error = 0  # of the device's clock (device ticks)
        self.inputs = 2
        self.faults_at: dict[int, int] = {}  # played tick → fault
        self.at: dict[int, Callable[[], None]] = {}  # played tick → what happens then
        self.command_sequence = 0
        self.received: list[tuple[int, m.Message]] = []
        self.arrived = b""
        self.error = 0
        self.write_error = 0
        self._assembler = Assembler()
        self.block_crc = 0
        self.commit = lambda: Status.OK
        self.commits: list[tuple[int, bytes]] = []  # sample index, block
        self._replies: dict[tuple[int, int], bytes] = {}
        self._pending: list[tuple[int, ...]] = []
        self._head = (0, 0, 0)
        self._count = counts[0] if len(counts) else 0
        self._batches = self._states = 0
        self._next_ns = period_ns
        self._current = 0
        self.silent = False

    # ------------------------------------------------------------------ the device

    def _time(self) -> int:
        return self._next_ns * 16 // 1000 + self.time_error

    def _tick(self) -> None:
        self.index += 1
        happens = self.at.pop(self.played, None)
        if happens is not None:
            happens()
        if self.supervised and self.state is State.RUNNING:
            self._sample()
        if self.index % self.states_every == 0 or self.played in self.faults_at:
            self._send_state()
        self._next_ns += self.period_ns

    def _sample(self) -> None:
        k = self.played
        self.played += 1
        count = self.counts[min(k, len(self.counts) - 1)]
        fault = self.faults_at.pop(k, 0)
        if k in self.missing:
            self._flush()
        else:
            moved = count - self._count
            if not self._pending:
                self._head = (self.index % U32, self._time() % U32, self._count)
            sample = (moved, self._current, 7)
            self._pending.append(sample[:2] if self.layout == 1 else sample)
            self._count = count
            self._current = self.currents[k] if k < len(self.currents) else 0
        if len(self._pending) == self.samples:
            self._flush()
        if fault:
            self.fault, self.state = fault, State.FAULT
            self._flush()
            self._send_state()

    def _flush(self) -> None:
        if not self._pending:
            return
        first, time, base = self._head
        batch = m.Batch(first, time, base, self.layout, pack_batch_samples(self.layout, self._pending))
        frame = encode_frame(pack(batch, session=self.session, sequence=self._batches % 65536))
        number = self._batches
        self._batches += 1
        self._pending = []
        for piece in self.mangle(number, frame):
            self._arrive(piece)

    def _send_state(self) -> None:
        state = m.State(
            command_sequence=self.command_sequence, command_age=1, sample_index=self.index % U32,
            device_time=self._time() % U32, count=self._count, edge_time=self._time() % U32, current_measured=0,
            current_commanded=self._current, limits=self.limits, fault=self.fault, execution_time=160,
            missed_ticks=0, state=int(self.state), inputs=self.inputs, phase=self.phase, sync_time=0,
        )  # fmt: skip
        self._arrive(encode_frame(pack(state, session=self.session, sequence=self._states % 65536)))
        self._states += 1
        self.limits = 0

    def _arrive(self, data: bytes) -> None:
        if not self.silent:
            self.arrived += data

    # ------------------------------------------------------------------ the link

    def _wait(self, deadline_ns: int) -> bool:
        while not self.arrived and not self.error and self._next_ns <= deadline_ns:
            self.clock.sleep_until(self._next_ns)
            self._tick()
        if not self.arrived:
            self._check(self.error)
            self.clock.sleep_until(deadline_ns)
        return bool(self.arrived)

    def _read(self, size: int) -> bytes:
        data, self.arrived = self.arrived[:size], self.arrived[size:]
        if not data:
            self._check(self.error)
        return data

    def _write(self, data: bytes) -> None:
        self._check(self.write_error)
        header, message = unpack(decode_frame(data[:-1]))
        assert header.session == self.session
        self.received.append((self.clock.now_ns(), message))
        if isinstance(message, m.Command):
            self._command(header.sequence, message)
        else:
            self._answer(message)

    @staticmethod
    def _check(error: int) -> None:
        if error:
            raise OSError(-error, "as the test asks")

    def _command(self, sequence: int, command: m.Command) -> None:
        if self.state is State.FAULT:
            return
        self.command_sequence = sequence
        self.state = State.RUNNING
        if command.mode == m.Mode.SUPERVISE:
            self.supervised = True
        elif self.supervised:
            self._flush()
            self.supervised = False

    def _answer(self, message: m.Message) -> None:
        if isinstance(message, m.GetTime):
            time = m.Time(message.nonce, message.host_sent, self._time(), self._time())
            self._arrive(encode_frame(pack(time, session=self.session)))
            return
        key = type_id_of(type(message)), message.nonce  # type: ignore[attr-defined]
        if isinstance(message, m.SetCommit) and key in self._replies:
            self._arrive(self._replies[key])
            return
        status, detail, crc = Status.OK, 0, 0
        if isinstance(message, m.SetBegin):
            status = self._assembler.begin(message)
        elif isinstance(message, m.SetChunk):
            status, detail = self._assembler.chunk(message), message.offset
        elif isinstance(message, m.SetCommit):
            status, block = self._assembler.commit(message)
            if status is Status.OK:
                status = self.commit()
            if status is Status.OK:
                self.commits.append((self.index + 1, block))
                crc = crc32(block)
        ack = m.Ack(message.nonce, key[0], int(status), detail, (self.index + 1) % U32, crc)  # type: ignore[attr-defined]
        reply = encode_frame(pack(ack, session=self.session))
        if isinstance(message, m.SetCommit):
            self._replies[key] = reply
        self._arrive(reply)

    def commands(self) -> list[m.Command]:
        return [message for _, message in self.received if isinstance(message, m.Command)]

    def failure(self) -> None:
        """Implement `rig.devices.device.Link.failure`: this link never fails."""

    def port(self) -> LoopPort:
        plugs = callback_plugs(read=self._read, write=self._write, wait=self._wait)
        return LoopPort.on(self.clock, **plugs._asdict())
