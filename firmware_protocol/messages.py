"""Define all messages: frozen dataclasses whose fields have C type, unit and meaning; and the table of type ids.

The annotations are the only description of the bytes: packing.py, codec.py and the tables of PROTOCOL.md are generated
from them. Values are little-endian, without padding. A type id contains sender and delivery class, so a receiver can
handle an unknown type of a newer version correctly:

* even: sent by the host, odd: sent by the device;
* below 0x40: TRANSACTION, from 0x40: STREAM, from 0x60: BATCH.

Ids 0 and 1, and the fields that IDENTIFY and IDENTITY have in version 1.0, are the same in all versions. All of host,
device and code generator import it. A field must not move or change its type within a major version.
"""

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Annotated

from firmware_protocol.wire import Wire

MAJOR = 2
MINOR = 1
TIME_UNIT_NS = 62.5  # one unit of every u32 and u64 device time: 1/16 µs; u32 wraps after 268 s
# pid.codes keeps 1209:0001 … 1209:0010 for tests and private use: a product that is sold needs its own pair.
USB_VENDOR, USB_PRODUCT = 0x1209, 0x0001

NO_COMMAND_YET = 0xFFFF  # STATE.command_age before the first COMMAND of a session
OLDEST_EDGE = (
    1 << 31
) - 1  # age at which edge_time saturates (134 s): the 32-bit time would make it look fresh


class Role(IntEnum):
    """End of the link: the host or the device."""

    HOST = 0
    DEVICE = 1


class Delivery(IntEnum):
    """Delivery class of a message: whether it gets a reply, whether the sender repeats it, whether it may be lost."""

    TRANSACTION = 0  # has a reply; the host repeats it until the reply arrives
    STREAM = 1  # never repeated, the newest wins, losses are counted
    BATCH = 2  # never repeated, every frame kept, gaps show in the first index


class Mode(IntEnum):
    """Mode that a COMMAND message requests from the device."""

    CURRENT = 0  # apply the current
    SUPERVISE = 1  # keep the law on the device running; the current is ignored
    STOP = 2  # zero current now, without a ramp; the device stays armed


STOP_FRAMES = 5  # times that a host sends STOP, so that one arrives over a link that loses frames


class Sync(IntFlag):
    """Bits of the device's sync outputs, which mark ticks and trials for an oscilloscope or another recorder.

    `TRIAL` and `INSIDE` are also the flags of a COMMAND message with mode CURRENT. The device sets these pins when the
    current of the COMMAND becomes active, and clears them when the lifetime of the COMMAND is over, at STOP, at a fault
    and outside of a session. With mode SUPERVISE the law on the device controls the pins.
    """

    TICK = 1  # the device computes a tick; ignored in a COMMAND
    TRIAL = 2  # the trial runs
    INSIDE = 4  # the handle is inside its wall


class DisarmFlag(IntFlag):
    """Flag bits of a DISARM message: CLEAR_FAULT also leaves the state FAULT, unless the cause is still present."""

    CLEAR_FAULT = 1  # also leave FAULT; refused while the cause is present


Nonce = Annotated[int, Wire("u16", "", "number of the transaction; a repeated request has the same")]
Tail = Annotated[bytes, Wire("bytes", "", "the rest of the frame")]


class Message:
    """Base class of all messages."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class Identify(Message):
    """Request a piece of the device's dictionary; accepted in every state and from every major version."""

    nonce: Nonce
    offset: Annotated[
        int, Wire("u16", "byte", "offset of the first requested byte of the compressed dictionary")
    ]


@dataclass(frozen=True, slots=True)
class Identity(Message):
    """A piece of the device's dictionary. The major version in the header is the device's."""

    nonce: Nonce
    minor: Annotated[int, Wire("u8", "", "minor protocol version of the device")]
    state: Annotated[int, Wire("u8", "", "state of the device before this reply")]
    dictionary_hash: Annotated[
        int, Wire("u64", "", "first 8 bytes of the SHA-256 of the compressed dictionary")
    ]
    total: Annotated[int, Wire("u16", "byte", "length of the compressed dictionary")]
    offset: Annotated[int, Wire("u16", "byte", "offset of this piece")]
    data: Tail


@dataclass(frozen=True, slots=True)
class Ack(Message):
    """The reply to a request that has no reply message of its own, and the reply to every rejected request."""

    nonce: Nonce
    request: Annotated[int, Wire("u8", "", "type id of the request")]
    status: Annotated[int, Wire("u8", "", "Status")]
    detail: Annotated[
        int, Wire("u16", "", "detail of the status: state, parameter id or fault; of a CHUNK: its offset")
    ]
    sample_index: Annotated[int, Wire("u32", "tick", "tick at which the request took effect")]
    crc: Annotated[int, Wire("u32", "", "COMMIT and ARM: CRC-32 of the whole active parameter block; else 0")]


@dataclass(frozen=True, slots=True)
class SetBegin(Message):
    """First step of SET_PARAMETERS: announce a parameter block."""

    nonce: Nonce
    length: Annotated[int, Wire("u16", "byte", "length of the block")]
    crc: Annotated[int, Wire("u32", "", "CRC-32 of the block")]


@dataclass(frozen=True, slots=True)
class SetChunk(Message):
    """Second step of SET_PARAMETERS: a piece of the parameter block; pieces may arrive twice and in any order."""

    nonce: Annotated[int, Wire("u16", "", "transaction of the SET_BEGIN")]
    offset: Annotated[int, Wire("u16", "byte", "offset of this piece")]
    data: Tail


@dataclass(frozen=True, slots=True)
class SetCommit(Message):
    """Last step of SET_PARAMETERS: check the parameter block, then activate all of it or nothing between two ticks."""

    nonce: Annotated[int, Wire("u16", "", "transaction of the SET_BEGIN")]


@dataclass(frozen=True, slots=True)
class GetParameters(Message):
    """Request a piece of the active parameter block."""

    nonce: Nonce
    offset: Annotated[int, Wire("u16", "byte", "offset of the first requested byte")]


@dataclass(frozen=True, slots=True)
class Parameters(Message):
    """A piece of the active parameter block, which contains every parameter."""

    nonce: Nonce
    total: Annotated[int, Wire("u16", "byte", "length of the block")]
    crc: Annotated[int, Wire("u32", "", "CRC-32 of the block")]
    offset: Annotated[int, Wire("u16", "byte", "offset of this piece")]
    data: Tail


@dataclass(frozen=True, slots=True)
class Arm(Message):
    """Begin a session with the number in the header; dictionary hash and parameter CRC must equal the device's."""

    nonce: Nonce
    dictionary_hash: Annotated[int, Wire("u64", "", "hash from IDENTITY")]
    parameters_crc: Annotated[int, Wire("u32", "", "CRC-32 of the whole active parameter block")]


@dataclass(frozen=True, slots=True)
class Disarm(Message):
    """End the session: zero effort, amplifier off."""

    nonce: Nonce
    flags: Annotated[int, Wire("u8", "", "DisarmFlag")]


@dataclass(frozen=True, slots=True)
class GetTime(Message):
    """Request time stamps that relate the clocks of host and device; it contains the host's time at sending."""

    nonce: Nonce
    host_sent: Annotated[int, Wire("u64", "ns", "host clock at sending; echoed")]


@dataclass(frozen=True, slots=True)
class Time(Message):
    """Reply to GET_TIME: the device's times at receipt and at sending; the host compares them with its own times."""

    nonce: Nonce
    host_sent: Annotated[int, Wire("u64", "ns", "copied from the request")]
    device_received: Annotated[int, Wire("u64", "1/16 µs", "device time at receipt, extended to 64 bits")]
    device_sent: Annotated[int, Wire("u64", "1/16 µs", "device time at sending, extended to 64 bits")]


@dataclass(frozen=True, slots=True)
class GetFaultLog(Message):
    """Request the latched fault and a page of the device's log of the ticks before it."""

    nonce: Nonce
    first: Annotated[int, Wire("u16", "", "first requested entry; 0 is the oldest")]


@dataclass(frozen=True, slots=True)
class FaultLog(Message):
    """The latched fault and some of the last 256 ticks before it, one FAULT_ENTRY record each."""

    nonce: Nonce
    fault: Annotated[int, Wire("u16", "", "Fault that came first")]
    later: Annotated[int, Wire("u32", "", "faults since: bit 1 << code")]
    device_time: Annotated[int, Wire("u64", "1/16 µs", "device time of the fault, extended to 64 bits")]
    total: Annotated[int, Wire("u16", "", "entries in the ring")]
    first: Annotated[int, Wire("u16", "", "number of the first entry here")]
    data: Tail


@dataclass(frozen=True, slots=True)
class GetStatistics(Message):
    """Request the device's counters of received and dropped frames."""

    nonce: Nonce


@dataclass(frozen=True, slots=True)
class Statistics(Message):
    """The device's counters of received and dropped frames, each modulo 2³², and the address of its last crash."""

    nonce: Nonce
    frames: Annotated[int, Wire("u32", "", "frames with a good CRC")]
    framing_errors: Annotated[int, Wire("u32", "", "bad byte stuffing, too long, too short")]
    crc_errors: Annotated[int, Wire("u32", "", "wrong CRC")]
    malformed: Annotated[int, Wire("u32", "", "impossible payload")]
    unknown_type: Annotated[int, Wire("u32", "", "frames of a type from a newer minor version")]
    foreign_major: Annotated[int, Wire("u32", "", "frames of another major version")]
    stale_session: Annotated[int, Wire("u32", "", "COMMANDs of another session")]
    out_of_state: Annotated[int, Wire("u32", "", "messages forbidden in their state")]
    lost: Annotated[int, Wire("u32", "", "COMMANDs missing between two that arrived")]
    duplicated: Annotated[int, Wire("u32", "", "COMMANDs that arrived twice")]
    reordered: Annotated[int, Wire("u32", "", "COMMANDs older than one applied, or than their lifetime")]
    stopped_at: Annotated[
        int,
        Wire("u32", "", "address at which the processor stopped before its last reset; 0: it did not stop"),
    ]


@dataclass(frozen=True, slots=True)
class GetReference(Message):
    """Request how position zero was set, and the encoder count at which the device detected the encoder's index."""

    nonce: Nonce


@dataclass(frozen=True, slots=True)
class Reference(Message):
    """How position zero was set, if it was, and the encoder's index pulses that the device has detected so far."""

    nonce: Nonce
    zero: Annotated[
        int,
        Wire(
            "u8",
            "",
            "0: not set since the start, or the encoder has failed since; else parameter reference + 1",
        ),
    ]
    reference_count: Annotated[int, Wire("i32", "count", "the parameter of this name")]
    index_edges: Annotated[
        int, Wire("u32", "", "index pulses that have begun; 0: none yet, or no such input")
    ]
    index_count: Annotated[int, Wire("i32", "count", "encoder count where the last of them began")]


@dataclass(frozen=True, slots=True)
class EnterBootloader(Message):
    """Restart the device in its boot loader, which accepts another firmware, shortly after the reply."""

    nonce: Nonce


@dataclass(frozen=True, slots=True)
class Command(Message):
    """The host's motor current and mode for this tick; every COMMAND message restarts the device's link watchdog."""

    state_sequence: Annotated[
        int, Wire("u16", "", "sequence of the STATE that this answers; 0 before the first")
    ]
    lifetime_us: Annotated[
        int,
        Wire(
            "u32",
            "µs",
            "the effort ramps to zero unless another COMMAND comes within this time; a COMMAND that "
            "answers an older STATE is not activated",
        ),
    ]
    mode: Annotated[int, Wire("u8", "", "Mode")]
    flags: Annotated[int, Wire("u8", "", "Sync: TRIAL and INSIDE for the sync outputs; all other bits 0")]
    current: Annotated[int, Wire("i16", "quantum", "motor current")]


@dataclass(frozen=True, slots=True)
class State(Message):
    """The device's sample of one tick: count, times, currents, limits and state."""

    command_sequence: Annotated[int, Wire("u16", "", "sequence of the active COMMAND")]
    command_age: Annotated[
        int, Wire("u16", "tick", "ticks since that COMMAND arrived; saturates; 65535: none yet")
    ]
    sample_index: Annotated[
        int, Wire("u32", "tick", "number of this tick since the device started, modulo 2³²")
    ]
    device_time: Annotated[int, Wire("u32", "1/16 µs", "device time at which the count was read")]
    count: Annotated[int, Wire("i32", "count", "encoder count")]
    edge_time: Annotated[int, Wire("u32", "1/16 µs", "device time of the last encoder edge")]
    current_measured: Annotated[int, Wire("i16", "quantum", "measured motor current; saturates")]
    current_commanded: Annotated[int, Wire("i16", "quantum", "active current, after all limits")]
    limits: Annotated[int, Wire("u16", "", "LimitFlag: limits that acted since the last STATE")]
    fault: Annotated[int, Wire("u16", "", "Fault that is latched, or 0")]
    execution_time: Annotated[
        int, Wire("u16", "1/16 µs", "worst execution time of a tick since arming; saturates")
    ]
    missed_ticks: Annotated[int, Wire("u16", "tick", "ticks missed since arming; saturates")]
    state: Annotated[int, Wire("u8", "", "state of the device (connection.State)")]
    inputs: Annotated[int, Wire("u8", "", "Input")]
    phase: Annotated[
        int, Wire("u8", "", "phase of the law on the device (firmware/law/law.h); 0 without a law")
    ]
    sync_time: Annotated[
        int, Wire("u32", "1/16 µs", "device time of the last rising edge of the sync input; 0: none")
    ]


@dataclass(frozen=True, slots=True)
class Batch(Message):
    """Consecutive samples of the law on the device; `layout` selects the C types of their values (BATCH_LAYOUTS)."""

    first_index: Annotated[int, Wire("u32", "tick", "sample index of the first sample")]
    device_time: Annotated[int, Wire("u32", "1/16 µs", "device time of the first sample")]
    base_count: Annotated[int, Wire("i32", "count", "encoder count before the first sample's difference")]
    layout: Annotated[
        int, Wire("u8", "", "key of BATCH_LAYOUTS; the length of the data gives the number of samples")
    ]
    data: Tail


@dataclass(frozen=True, slots=True)
class FaultEntry:
    """One tick in the device's fault log (a ring buffer), as the record FAULT_ENTRY."""

    sample_index: Annotated[int, Wire("u32", "tick", "number of the tick")]
    count: Annotated[int, Wire("i32", "count", "encoder count")]
    current_commanded: Annotated[int, Wire("i16", "quantum", "active current")]
    current_measured: Annotated[int, Wire("i16", "quantum", "measured motor current")]
    limits: Annotated[int, Wire("u16", "", "LimitFlag")]


MESSAGES: dict[int, type[Message]] = {
    0x00: Identify,
    0x01: Identity,
    0x03: Ack,
    0x04: SetBegin,
    0x06: SetChunk,
    0x08: SetCommit,
    0x0A: GetParameters,
    0x0B: Parameters,
    0x0C: Arm,
    0x0E: Disarm,
    0x10: GetTime,
    0x11: Time,
    0x12: GetFaultLog,
    0x13: FaultLog,
    0x14: GetStatistics,
    0x15: Statistics,
    0x16: EnterBootloader,
    0x18: GetReference,
    0x19: Reference,
    0x40: Command,
    0x41: State,
    0x61: Batch,
}

# Samples of a BATCH: (count difference, commanded current, measured current); the last is absent in layout 1.
BATCH_LAYOUTS: dict[int, tuple[str, ...]] = {
    0: ("i8", "i16", "i16"),
    1: ("i8", "i16"),
    2: ("i16", "i16", "i16"),  # below 5 kHz, where a fast handle passes more than 127 counts in a tick
}


def sender_of(type_id: int) -> Role:
    """Return the sender of messages with a type id (even: host, odd: device), also of an unknown id."""
    return Role.DEVICE if type_id & 1 else Role.HOST


def delivery_of(type_id: int) -> Delivery:
    """Return the delivery class of messages with a type id, also of an unknown id."""
    if type_id < 0x40:
        return Delivery.TRANSACTION
    return Delivery.STREAM if type_id < 0x60 else Delivery.BATCH
