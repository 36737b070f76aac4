"""Host side of the protocol with a device: transactions with retries, arming, and reports of faults.

`firmware_protocol.connection` decides what may be sent; this file waits for replies: a request is repeated after 20, 40
and 80 ms, and then a typed error is raised. While the compiled loop (`rig.loop`) runs, it owns the streams COMMAND and
STATE; afterwards `take_back` continues from their counters.

`rig.doctor`, `rig.experiments`, self tests of `rig.firmware`, sessions and `rig.testing` use it. It must not decide
whether a wall may be armed: `rig.doctor.gate` and `rig.experiments.hits.admission` do, before they let a caller arm.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import dictionary as dictionaries
from firmware_protocol import messages as m
from firmware_protocol.connection import Connection, Received, State
from firmware_protocol.errors import IncompatibleMajorError, LocalProtocolError, RemoteProtocolError
from firmware_protocol.faults import Fault, Status
from firmware_protocol.packing import unpack_fault_entries
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import ParameterError, block_crc, decode_block, encode_block
from firmware_protocol.transaction import UNANSWERED
from firmware_protocol.transfer import PageReader, set_parameters
from rig.core.clock_fit import EXCHANGE, ClockFit, fit_clock
from rig.core.errors import DeviceRefusedError, IncompatibleDeviceError, LinkLostError
from rig.devices.device import Link

# A quarter of the time that a law on the device continues without a command: single losses do not end it.
SUPERVISE_EVERY_S = 0.005
MOST_NS = (1 << 63) - 1  # largest time stamp: 292 years
EXCHANGES = 8  # of time stamps, by default
DRIFT_EXCHANGES, DRIFT_S = 20, 1.0  # exchanges, and their duration, to measure the drift between the clocks
DRIFT_VIRTUAL_S = 0.1  # in virtual time, where nothing disturbs an exchange
GOLDEN = 0.6180339887498949  # golden ratio − 1
COUNT_TIMEOUT_S = 0.5
# A small processor computes the table of a long excitation in seconds.
READY_S, READY_AGAIN_S = 60.0, 0.05
FAULT_LOG_S = 2.0
DICTIONARY_LIMIT = BLOCK_LIMIT = 0xFFFF  # bytes: replies give the total length in 16 bits

# Dictionaries that this process has read, by their hash: a device that is opened again sends only the hash.
DICTIONARIES_KEPT = 16
_dictionaries: dict[int, dictionaries.Dictionary] = {}


@dataclass(frozen=True, slots=True)
class Echo:
    """Reply to a change of parameters: all active values, their CRC, and the first sample to which they apply."""

    values: dict[str, Value]
    crc: int
    sample_index: int


@dataclass(frozen=True, slots=True)
class FaultReport:
    """The fault that the device has stored, with text, remedy and device time (ns), and its last ticks, oldest first.

    The device stores the first fault until it is cleared. `later` is a bit set of the codes of faults that followed.
    """

    code: int
    name: str
    text: str
    remedy: str
    later: int
    device_time_ns: int
    entries: list[dict[str, int]]

    def has(self, fault: Fault) -> bool:
        """Return True if `fault` is the stored fault or occurred after it."""
        return self.code == fault or bool(self.later >> fault & 1)


class FramedDevice:
    """A device as the host uses it: identify, configure, arm, read and stop it by requests of the protocol.

    Parameters
    ----------
    link
        Open link; this object closes it.
    """

    def __init__(self, link: Link) -> None:
        self.link = link
        self.connection = Connection(m.Role.HOST)
        self._nonce = link.clock.now_ns() // 1_000_000 % 0xFFFF
        self._dictionary: dictionaries.Dictionary | None = None
        self._dictionary_hash = 0
        self._crc: int | None = None  # of the active parameters; None: set by another host, or unknown
        self._known: dict[str, Value] = {}  # the last known active values
        self.cleared_fault: FaultReport | None = None  # the latched fault of an earlier run
        self.moved_as_described = False  # under the last torque pulse (`rig.experiments.motion.pulse`)
        # position zero by its index (`rig.experiments.motion.reference`)
        self.reference_count: int | None = None
        self._session = 0  # number of the last session
        self._device_replies = True  # False after a transaction without a reply
        # host time of the last request's first frame, and of the last bytes read
        self._sent_ns = self._received_ns = 0

    # ------------------------------------------------------------------ identification

    @property
    def dictionary(self) -> dictionaries.Dictionary:
        """Return the device's dictionary (its description of its parameters, constants and faults), read only once."""
        if self._dictionary is None:
            self._dictionary = self.identify()
        return self._dictionary

    def identify(self) -> dictionaries.Dictionary:
        """Read the device's dictionary; if this process has read the same dictionary before, request only its hash.

        Raise `LinkLostError` if the device does not reply, and `IncompatibleDeviceError` if the device has another
        major version of the protocol, or its reply is invalid.
        """
        reader = PageReader(DICTIONARY_LIMIT)
        while not reader.complete:
            reply = self._ask(m.Identify(self._next_nonce(), reader.offset), m.Identity)
            self._dictionary_hash = reply.dictionary_hash
            if reply.dictionary_hash in _dictionaries:
                return _dictionaries[reply.dictionary_hash]
            self._add_page(reader, reply, reply.dictionary_hash)
        with self._translate_errors():
            if dictionaries.dictionary_hash(reader.content) != self._dictionary_hash:
                raise RemoteProtocolError(
                    "the device's dictionary (its description of itself) was not received correctly: its "
                    "hash differs from the hash that the device reported; connect again"
                )
            read = dictionaries.decode(reader.content)
        while len(_dictionaries) >= DICTIONARIES_KEPT:
            _dictionaries.pop(next(iter(_dictionaries)), None)
        _dictionaries[self._dictionary_hash] = read
        return read

    @property
    def dictionary_hash(self) -> int:
        """Return the 64-bit hash of the device's dictionary, as the device reports it."""
        self.dictionary  # noqa: B018
        return self._dictionary_hash

    # ------------------------------------------------------------------ configuration

    def configure(self, values: Mapping[str, Value]) -> Echo:
        """Set parameters of the device, either all of `values` or none, and return all active parameters.

        Raises
        ------
        DeviceRefusedError
            The device does not accept a value; then nothing has changed. Or a real device has restarted or lost encoder
            counts since this object first read its dictionary: its position zero is no longer valid.
        """
        self._make_configurable()
        before, self._crc = self._crc, None
        try:
            ack = self._command(*set_parameters(encode_block(values), self._next_nonce()))
        except DeviceRefusedError:
            self._crc = before
            raise
        # The reply has the CRC of all active parameters. Where it is that of the expected ones, nothing is read; else
        # another host was connected, or the device has values of its own, and they are read page by page.
        block = self._expected_block(values)
        if block is None or block_crc(block) != ack.crc:
            block = self._read_parameters()
        with self._translate_errors():
            active = decode_block(block)
        if block_crc(block) != ack.crc:
            raise DeviceRefusedError(
                "the device's active parameters differ from those that were sent",
                remedy="report this as a fault of the firmware",
            )
        self._crc, self._known = ack.crc, active
        return Echo(dict(active), ack.crc, ack.sample_index)

    def _expected_block(self, values: Mapping[str, Value]) -> bytes | None:
        """Return the bytes of all parameters after `values` are set; None if the device has unknown parameters."""
        known = self._known or {info.name: info.default for info in self.dictionary.parameters}
        try:
            return encode_block({**known, "verified": 0, **values})
        except ParameterError:  # a device that has parameters of its own
            return None

    def _make_configurable(self) -> None:
        """Bring a faulty, restarted or still armed device into a state in which it accepts parameters."""
        met_real = self._dictionary is not None and not self._dictionary.simulated
        # IDENTIFY reports the state, and takes the device out of BOOT.
        about = self._ask(m.Identify(self._next_nonce(), 0), m.Identity)
        if met_real and self._has_forgotten(about):
            raise self._lost_zero_error("the device has restarted")
        if self._dictionary is None or about.dictionary_hash != self._dictionary_hash:
            self._dictionary = self.identify()
        if self.connection.state == State.FAULT:
            self.cleared_fault = self.fault_report()
            if met_real and self._crc is not None and self.cleared_fault.has(Fault.ENCODER):
                raise self._lost_zero_error("the device has lost counts of its encoder")
        if self.connection.state >= State.ARMED:
            self.disarm(clear_fault=True)

    def _lost_zero_error(self, what_happened: str) -> DeviceRefusedError:
        return DeviceRefusedError(
            f"{what_happened} during the session ({self.link.url.text}): its position zero is no longer valid",
            remedy="check its power and cables, put the handle at position zero, and start the command again",
            status=Status.NOT_HOMED,
        )

    def has_restarted(self) -> bool:
        """Return True if the device has restarted and no IDENTIFY request has arrived since."""
        about = self._ask(m.Identify(self._next_nonce(), 0), m.Identity)
        return bool(about.state == State.BOOT)

    def _has_forgotten(self, about: m.Identity) -> bool:
        """Return True if the device has restarted, or another host has configured it, since this object did."""
        if about.state == State.BOOT:
            return True
        if self._crc is None:
            return False
        return bool(
            about.state < State.CONFIGURED
            or self._ask(m.GetParameters(self._next_nonce(), 0), m.Parameters).crc != self._crc
        )

    def count(self) -> int:
        """Return the encoder count that an unarmed device sends; raise `DeviceRefusedError` if none comes in 0.5 s."""
        self.dictionary  # noqa: B018  (a device in BOOT sends nothing)
        for event in self._events(COUNT_TIMEOUT_S):
            if isinstance(event.message, m.State):
                return event.message.count
        raise DeviceRefusedError(
            f"the device sent no encoder count within {COUNT_TIMEOUT_S:g} s",
            remedy="update the device's firmware",
        )

    def active_parameters(self) -> dict[str, Value]:
        """Read all active parameters from the device, by name, without changing them."""
        self.dictionary  # noqa: B018  (a device in BOOT answers nothing else)
        block = self._read_parameters()
        with self._translate_errors():
            return decode_block(block)

    def _read_parameters(self) -> bytes:
        reader = PageReader(BLOCK_LIMIT)
        while not reader.complete:
            reply = self._ask(m.GetParameters(self._next_nonce(), reader.offset), m.Parameters)
            self._add_page(reader, reply, reply.crc)
        return reader.content

    def _add_page(self, reader: PageReader, reply: m.Identity | m.Parameters, fingerprint: int) -> None:
        """Add a page of the device's reply to `reader`; raise an error if its offset is not the requested one."""
        with self._translate_errors():
            if reply.offset != reader.offset:
                raise RemoteProtocolError(
                    f"the device sent its reply from byte {reply.offset} on, not from byte {reader.offset} as requested"
                )
            reader.add(total=reply.total, fingerprint=fingerprint, offset=reply.offset, data=reply.data)

    # ------------------------------------------------------------------ armed operation

    def arm(self) -> int:
        """Arm the device and return the number of the new session; it then sends STATE messages, with zero effort.

        ARM is repeated for at most `READY_S` (60 s) while the device computes its excitation or switches its amplifier
        on. Raise `DeviceRefusedError` if position zero is not set, the signs of motor and encoder are not verified, the
        parameters are not those of this host, or the device detects a fault.
        """
        # From the nonce, which begins with the clock, so that a restarted host seldom takes the number of the run
        # before: the device refuses that one (STALE_SESSION).
        session, used_before = self._next_session(self._next_nonce() % 0xFF, self._session), False
        deadline_ns = self.link.clock.now_ns() + round(READY_S * 1e9)
        while True:
            try:
                self._arm(session)
            except DeviceRefusedError as error:
                if error.status == Status.STALE_SESSION and not used_before:
                    session, used_before = self._next_session(session, self._session), True
                elif error.status == Status.NOT_READY and self.link.clock.now_ns() < deadline_ns:
                    self._listen_until(self.link.clock.now_ns() + round(READY_AGAIN_S * 1e9))
                elif self.connection.state == State.FAULT:  # found while its amplifier was being switched on
                    found = self.fault_report()
                    raise DeviceRefusedError(found.text, remedy=found.remedy, status=error.status) from None
                else:
                    raise
            else:
                self._session = session
                return session

    def _arm(self, session: int) -> None:
        self._command(m.Arm(self._next_nonce(), self._dictionary_hash, self._crc or 0), session=session)

    @staticmethod
    def _next_session(previous: int, used: int) -> int:
        """Return the session number (1 … 255, cyclic) that follows `previous`, skipping `used`."""
        session = 1 + previous % 0xFF
        return session if session != used else 1 + session % 0xFF

    @property
    def nonce(self) -> int:
        """Return the number of the last transaction with the device; the compiled loop continues to count from it."""
        return self._nonce

    def take_back(
        self,
        *,
        next_command: int,
        newest_state: int,
        state: int,
        nonce: int,
        parameters_crc: int | None = None,
    ) -> None:
        """Continue the protocol with the device after the compiled loop has ended.

        The counters come from the loop: the next COMMAND, the newest STATE, and the last transaction (`nonce`). An
        unknown `state` is treated as RUNNING, so that the host can still stop the device. `parameters_crc` is the CRC
        of the active parameters if the loop has changed some, else None.
        """
        self._nonce = nonce
        if parameters_crc is not None:
            self._crc = parameters_crc
        known = State(state) if state in set(State) else State.RUNNING
        self.connection.resume(next_command=next_command, newest_state=newest_state, state=known)

    def supervise(self, seconds: float, lifetime_us: int) -> list[m.Message]:
        """Keep the law of an armed device running for `seconds` (s); return the received messages STATE and BATCH.

        Each command keeps the law running for `lifetime_us` (µs). Return early if the device reports a fault. Use it
        only for checks: in a run, the compiled loop sends these commands.
        """
        received: list[m.Message] = []
        end_ns = self.link.clock.now_ns() + math.ceil(seconds * 1e9)
        while (left_ns := end_ns - self.link.clock.now_ns()) > 0 and self.connection.state != State.FAULT:
            answered = self.connection.answered
            command = m.Command(answered, lifetime_us, int(m.Mode.SUPERVISE), 0, 0)
            self.link.write(self.connection.send(command))
            received += [event.message for event in self._events(min(SUPERVISE_EVERY_S, left_ns * 1e-9))]
        return [message for message in received if isinstance(message, m.State | m.Batch)]

    def stop(self) -> None:
        """Send STOP (zero effort) to the device several times. Never raise: the next call reports a lost link."""
        for _ in range(m.STOP_FRAMES):
            with suppress(Exception):
                self.link.write(self.connection.send(m.Command(0, 1000, int(m.Mode.STOP), 0, 0)))

    def disarm(self, *, clear_fault: bool = False) -> None:
        """End the device's session: zero effort, amplifier off; with `clear_fault` also clear its stored fault."""
        flags = int(m.DisarmFlag.CLEAR_FAULT) if clear_fault else 0
        self._command(m.Disarm(self._next_nonce(), flags))

    def enter_bootloader(self) -> None:
        """Request a reset of the device into its boot loader, in 50 ms; `DeviceRefusedError` if it is armed."""
        self.dictionary  # noqa: B018  (a device in BOOT knows IDENTIFY alone)
        self._command(m.EnterBootloader(self._next_nonce()))

    # ------------------------------------------------------------------ clock and reports

    def exchange_clock(self, exchanges: int = EXCHANGES, *, over_s: float = 0.0) -> NDArray[np.void]:
        """Exchange time stamps with the device; return four (ns) per exchange: sent and received by host and by device.

        The exchanges (dtype `rig.core.clock_fit.EXCHANGE`) follow each other at once, or irregularly over `over_s` (s).
        Raise `LinkLostError` if the device does not reply.
        """
        stamps = np.zeros(exchanges, EXCHANGE)
        tick_ps = round(self.dictionary.time_unit_ns * 1000)
        start_ns = self.link.clock.now_ns()
        for number, row in enumerate(stamps):
            # At odd distances: multiples of the golden ratio modulo 1 meet ticks and bus frames at every phase.
            place = (number + number * GOLDEN % 1.0) / max(1, exchanges - 1)
            self._listen_until(start_ns + round(min(1.0, place) * over_s * 1e9))
            reply = self._ask(m.GetTime(self._next_nonce(), self.link.clock.now_ns()), m.Time)
            row["host_sent"], row["host_received"] = self._sent_ns, self._received_ns
            row["device_received"] = self._counted_ns(reply.device_received, tick_ps)
            row["device_sent"] = self._counted_ns(reply.device_sent, tick_ps)
        return stamps

    def _counted_ns(self, stamp: int, tick_ps: int) -> int:
        """Convert a device time stamp in units of `tick_ps` (ps) to ns; `IncompatibleDeviceError` above 292 years."""
        time_ns = stamp * tick_ps // 1000
        with self._translate_errors():
            if time_ns > MOST_NS:
                raise RemoteProtocolError(
                    f"a device time of {time_ns * 1e-9:.3g} s is above the largest possible {MOST_NS * 1e-9:.3g} s"
                )
        return time_ns

    def clock(self, exchanges: int = EXCHANGES, *, over_s: float = 0.0) -> ClockFit:
        """Return a fit of host clock against device clock from new exchanges; for a useful drift, give `over_s` (s)."""
        return fit_clock(self.exchange_clock(exchanges, over_s=over_s))

    def drift(self) -> ClockFit:
        """Return a fit of host clock against device clock whose drift is known to a few ppm; it takes about 1 s."""
        over_s = DRIFT_VIRTUAL_S if self.link.clock.virtual else DRIFT_S
        return self.clock(DRIFT_EXCHANGES, over_s=over_s)

    def statistics(self) -> m.Statistics:
        """Return the device's counters of frames and errors on the link since the device started."""
        reply: m.Statistics = self._ask(m.GetStatistics(self._next_nonce()), m.Statistics)
        return reply

    def reference(self) -> m.Reference:
        """Return the REFERENCE message: how position zero was set, and the count at the encoder's last index pulse."""
        reply: m.Reference = self._ask(m.GetReference(self._next_nonce()), m.Reference)
        return reply

    def states(self, seconds: float) -> list[m.State]:
        """Return the STATE messages (samples) that arrive within `seconds` (s), 100 per second if unarmed."""
        self.dictionary  # noqa: B018  (a device in BOOT sends nothing)
        return [event.message for event in self._events(seconds) if isinstance(event.message, m.State)]

    def status_of(self, request: m.Message, *, session: int | None = None) -> Status:
        """Send a request of the caller with a new number (nonce) and return the status of the device's reply.

        It is for requests that the device must refuse; if it accepts the request, the caller must undo that. Raise
        `DeviceRefusedError` for a status that is not in `Status`.
        """
        answer = self._transact(replace(request, nonce=self._next_nonce()), session=session)  # type: ignore[type-var]
        if not isinstance(answer, m.Ack):
            return Status.OK
        if answer.status not in set(Status):
            raise self._refusal(answer)
        return Status(answer.status)

    def _listen_until(self, deadline_ns: int) -> None:
        # Unread frames would delay the next reply.
        remaining_ns = deadline_ns - self.link.clock.now_ns()
        for _ in self._events(max(0, remaining_ns) * 1e-9):
            pass

    def explain_fault(self, code: int) -> FaultReport:
        """Return name, text and remedy of a fault code, from the device's stored dictionary without a request."""
        info = self.dictionary.explain_fault(code)
        return FaultReport(code, info.name, info.text, info.remedy, 0, 0, [])

    def fault_report(self) -> FaultReport:
        """Read the fault that the device has stored, and its log of the ticks before the fault.

        Reading stops after `FAULT_LOG_S` (2 s); the report then contains the ticks that were read.
        """
        # The ring takes eighty requests: on a busy computer, the cause of many faults, longer than a person waits.
        entries: list[dict[str, int]] = []
        deadline = self.link.clock.now_ns() + round(FAULT_LOG_S * 1e9)
        while True:
            reply = self._ask(m.GetFaultLog(self._next_nonce(), len(entries)), m.FaultLog)
            with self._translate_errors():
                page = [asdict(entry) for entry in unpack_fault_entries(reply.data)]
            entries += page
            if not page or len(entries) >= reply.total or self.link.clock.now_ns() > deadline:
                break
        time_ns = round(reply.device_time * self.dictionary.time_unit_ns)
        explained = self.explain_fault(reply.fault)
        return replace(explained, later=reply.later, device_time_ns=time_ns, entries=entries)

    def close(self) -> None:
        """Stop and disarm the device if a session is open, and close the link; never raise an error of the device.

        If the last transaction timed out, DISARM is sent with all its retries without waiting for replies.
        """
        # By then the device has received no COMMAND for longer than any command's lifetime and ramp.
        if self.connection.session:
            self.stop()
            with suppress(Exception):
                if self._device_replies:
                    self.disarm(clear_fault=True)
                else:
                    self._send_disarm()
        self.link.close()

    def _send_disarm(self) -> None:
        """Send DISARM and all its retries at once, without waiting for a reply."""
        self.connection.begin(m.Disarm(self._next_nonce(), int(m.DisarmFlag.CLEAR_FAULT)))
        while frame := self.connection.say(self.connection.transaction.again_at):
            self.link.write(frame)

    def __enter__(self) -> FramedDevice:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    # ------------------------------------------------------------------ transactions

    def _next_nonce(self) -> int:
        self._nonce = (self._nonce + 1) % 0x10000
        return self._nonce

    def _ask(self, question: m.Message, reply: type[Any]) -> Any:
        """Send a request and return the reply of type `reply`; raise `DeviceRefusedError` for any other reply."""
        answer = self._transact(question)
        if isinstance(answer, reply):
            return answer
        raise self._refusal(answer)

    def _command(self, *requests: m.Message, session: int | None = None) -> m.Ack:
        answer = self._transact(*requests, session=session)
        if isinstance(answer, m.Ack) and answer.status == Status.OK:
            return answer
        raise self._refusal(answer)

    def _transact(self, *requests: m.Message, session: int | None = None) -> m.Message:
        """Send the requests of a transaction one after another, each with retries; return the last reply."""
        connection, clock, request = self.connection, self.link.clock, requests[0]
        connection.begin(*requests, session=session)
        while connection.transaction.step != UNANSWERED:
            now_ns = clock.now_ns()
            with self._translate_errors():
                frame = connection.say(now_ns)
            if frame:
                request = connection.request
                # Of the first try: a late reply may be the one to it, and the round trip must not be too short.
                if connection.transaction.tries == 1:
                    self._sent_ns = clock.now_ns()
                self.link.write(frame)
            before = connection.transaction
            for event in self._events((before.again_at - now_ns) * 1e-9):  # a write may have taken a while
                if connection.transaction.step < 0:
                    self._device_replies = True
                    return event.message
                if connection.transaction != before:
                    break
        self._device_replies = False
        raise LinkLostError(
            f"no reply to {type(request).__name__} from the device at {self.link.url.text}",
            remedy="check cable and power, the port in the URL, the baud rate, and that the device runs this firmware",
            statistics=connection.statistics,
        )

    def _events(self, timeout_s: float) -> Iterator[Received]:
        deadline = self.link.clock.now_ns() + math.ceil(timeout_s * 1e9)
        while (remaining := deadline - self.link.clock.now_ns()) > 0:
            data = self.link.read(remaining * 1e-9)
            self._received_ns = self.link.clock.now_ns()
            self.connection.receive_data(data)
            while True:
                with self._translate_errors():
                    event = self.connection.next_event()
                if event is None:
                    break
                if isinstance(event, Received):
                    yield event

    def _refusal(self, message: m.Message) -> DeviceRefusedError:
        if not isinstance(message, m.Ack):
            return DeviceRefusedError(
                f"the device replied {type(message).__name__}, which does not belong to the request",
                remedy="check that the device runs the firmware of this project",
            )
        known = () if self._dictionary is None else self._dictionary.statuses
        info = dictionaries.explain_status(message.status, known)
        request = (
            m.MESSAGES[message.request].__name__ if message.request in m.MESSAGES else str(message.request)
        )
        return DeviceRefusedError(
            f"the device refused {request}: {info.text.replace(' (detail)', '')}{self._detail(message)}",
            remedy=info.remedy,
            status=message.status,
        )

    def _detail(self, ack: m.Ack) -> str:
        """Return why a request was refused, in parentheses: parameter and range, state, or fault; else ""."""
        if ack.status == Status.BAD_STATE:
            return f" ({State(ack.detail).name if ack.detail in set(State) else f'state {ack.detail}'})"
        if self._dictionary is not None and ack.status == Status.FAULT_PRESENT:
            return f" ({self._dictionary.explain_fault(ack.detail).text})"
        if self._dictionary is not None and ack.detail:
            for info in self._dictionary.parameters:
                if info.id == ack.detail:
                    return f" ({info.name}, allowed {info.minimum:g} … {info.maximum:g})"
        return ""

    def _translate_errors(self) -> _ErrorTranslator:
        return _ErrorTranslator(self.link.url.text)


class _ErrorTranslator:
    """Context manager that converts an error of the protocol into a `RigError` for the user."""

    def __init__(self, url: str) -> None:
        self._url = url

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, IncompatibleMajorError):
            raise IncompatibleDeviceError(
                f"the device at {self._url} uses protocol {error.theirs}, this package uses {error.ours}",
                remedy="flash the firmware of this package, or install the package version that matches the device",
            ) from error
        if isinstance(error, LocalProtocolError):  # nothing was sent: the device's state forbids it
            raise DeviceRefusedError(
                f"the device at {self._url} cannot accept this request in its present state: {error}",
                remedy="configure the device again, which also clears a fault",
                status=Status.BAD_STATE,
            ) from error
        if isinstance(error, RemoteProtocolError | ParameterError):
            raise IncompatibleDeviceError(
                f"the device at {self._url} sends invalid data: {error}",
                remedy="check that the device runs the firmware of this project",
            ) from error
