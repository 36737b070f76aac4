"""Load the bridge's C code as a library: the firmware's core, with a drive in place of its hardware.

`Bridge` is the software alone, with bytes and times as input. `rig.extras.drives.serve` runs it in real time; tests run
it step by step.
"""

import ctypes
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import firmware_protocol
from firmware_protocol import dictionary as dictionaries
from firmware_protocol.connection import State
from firmware_protocol.parameters import PARAMETERS
from rig.core.board import describe, narrower
from rig.core.model import RigModel
from rig.extras.drives.faults import explain_faults
from rig.realtime.c_board import FLAGS, BoardSetup, CLibrary
from rig.realtime.kernel import CACHE_DIRECTORY

BRIDGE = CLibrary(
    name="bridge",
    root=Path(firmware_protocol.__file__).with_name("firmware"),
    parts=("core", "law", "bridge"),
    purpose="a bridge to a drive is the firmware",
    flags=(*FLAGS, "-D_GNU_SOURCE"),
)
RATE_INITIAL, RATE_MAXIMUM = 1_000, 2_500  # Hz; the highest rate at which a moteus replies
DRIVES = ("moteus", "odrive")  # enum bridge_drive of bridge.h
BINS = 5120  # of the round trips, 1 µs each
NO_EXCITATION = {"excitation_lines": (0, 0), "excitation_period": (2, 2)}
LAW_HERE, LAW_ON_THE_DRIVE = 2, 3  # largest kinds of `law`
_OUTPUT_BYTES = 65536
_INDEX = {parameter.name: index for index, parameter in enumerate(PARAMETERS)}


class CanFrameBytes(ctypes.Structure):
    """A CAN frame for the C code: ``struct can_frame_bytes`` of can_frame.h."""

    _fields_ = [
        ("id", ctypes.c_uint32),
        ("count", ctypes.c_uint8),
        ("bytes", ctypes.c_uint8 * 64),
        *((name, ctypes.c_bool) for name in ("classic", "remote")),
    ]

    @property
    def data(self) -> bytes:
        """Data of the frame, up to 64 bytes."""
        return bytes(self.bytes[: self.count])


class Adapter(ctypes.Structure):
    """State of a serial CAN adapter for the C code: ``struct fdcanusb`` of fdcanusb.h."""

    _fields_ = [
        ("checksum", ctypes.c_bool),
        ("overlong", ctypes.c_bool),
        ("count", ctypes.c_size_t),
        ("line", ctypes.c_char * 256),
        *((name, ctypes.c_uint32) for name in ("sent", "refused", "garbled")),
    ]


class Setup(ctypes.Structure):
    """Settings of a bridge (firmware in front of a drive) for C code: ``struct bridge_setup`` of bridge.h."""

    _fields_ = [
        ("board", BoardSetup),
        *((name, ctypes.c_uint32) for name in ("rate_maximum", "prefix", "drive")),
        *(
            (name, ctypes.c_double)
            for name in ("counts_per_turn", "torque_per_quantum", "torque_limit", "kp", "kd")
        ),
        *(
            (name, ctypes.c_uint32)
            for name in ("switches", "hold", "stop", "checksum", "socket", "kind", "cycle_us", "beat_us")
        ),
    ]


class Ends(ctypes.Structure):
    """File descriptors that a running bridge uses: ``struct bridge_ends`` of loop.h."""

    _fields_ = [*((name, ctypes.c_int) for name in ("host", "bus", "wake")), ("host_stays", ctypes.c_bool)]


class BridgeFacts(ctypes.Structure):
    """Statistics of a bridge's bus, times in µs, temperatures in °C: ``struct bridge_facts`` of bridge.h."""

    _fields_ = [
        *(
            (name, ctypes.c_int64)
            for name in (
                "replies",
                "lost",
                "late",
                "foreign",
                "invalid",
                "refused",
                "unsent",
                "skipped",
                "limited",
                "longest_us",
                "temperature",
                "hottest",
                "millivolts",
                "mode",
                "code",
            )
        ),
        ("round_trips", ctypes.c_int64 * BINS),
    ]

    def quantile_us(self, share: float) -> float:
        """Return a quantile of the round-trip time to the drive (µs, rounded up); 0 without replies.

        `share` is the share of shorter round trips, 0 to 1.
        """
        counted = list(self.round_trips)
        left = share * sum(counted)
        for number, count in enumerate(counted):
            left -= count
            if count and left <= 0:
                return float(min(number + 1, max(self.longest_us, 1)))
        return 0.0

    def as_mapping(self) -> dict[str, float]:
        """Return all statistics by name, with median and 99.9 % quantile of the round-trip time (µs)."""
        names = [str(field[0]) for field in self._fields_ if field[1] is ctypes.c_int64]
        return {
            **{name: int(getattr(self, name)) for name in names},
            "median_us": self.quantile_us(0.5),
            "p999_us": self.quantile_us(0.999),
        }


_P, _N, _U64 = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_uint64
_FRAME, _ADAPTER = ctypes.POINTER(CanFrameBytes), ctypes.POINTER(Adapter)
_RECEIVED = [_P, ctypes.c_char_p, _N, _U64]
_SIGNATURES: dict[str, tuple[Any, list[Any]]] = {
    "bridge_bytes": (_N, []),
    "bridge_facts_bytes": (_N, []),
    "bridge_setup": (None, [_P, ctypes.POINTER(Setup), ctypes.POINTER(BridgeFacts)]),
    "bridge_narrow": (None, [_P, ctypes.c_uint8, ctypes.c_uint32, ctypes.c_uint32]),
    "bridge_start": (None, [_P, _U64]),
    "bridge_tick": (None, [_P, _U64]),
    "bridge_poll": (None, [_P, _U64]),
    "bridge_receive_bus": (None, _RECEIVED),
    "bridge_receive_host": (None, _RECEIVED),
    "bridge_lose_bus": (None, [_P, _U64]),
    "bridge_stop": (None, [_P]),
    "bridge_due": (_U64, [_P]),
    "bridge_take": (_N, [_P, _P, _N]),
    "bridge_take_bus": (_N, [_P, _P, _N]),
    "bridge_state": (ctypes.c_uint8, [_P]),
    "bridge_fault_now": (ctypes.c_uint8, [_P]),
    "bridge_torque": (ctypes.c_double, [_P]),
    "bridge_run": (None, [_P, ctypes.POINTER(Ends)]),
    "fdcanusb_take": (ctypes.c_bool, [_ADAPTER, ctypes.c_uint8, _FRAME]),
    "fdcanusb_make": (_N, [_ADAPTER, _FRAME, _P]),
    "socketcan_take": (ctypes.c_int, [ctypes.c_char_p, _N, _FRAME]),
    "socketcan_make": (_N, [_FRAME, _P]),
}


def load(path: Path) -> ctypes.CDLL:
    """Open a compiled library, and declare the signatures of its functions."""
    library = ctypes.CDLL(str(path))
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


@cache
def library() -> ctypes.CDLL:
    """Return the C library of firmware in front of a drive; raise `ConfigError` if it cannot be compiled."""
    return BRIDGE.opened(CACHE_DIRECTORY, load)


@dataclass(frozen=True, slots=True)
class Switches:
    """Input pins of a drive: the register that reads them (0: none), and the bits that are 1 while the rig may run."""

    register: int = 0
    hold: int = 0
    stop: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedDrive:
    """A drive that matches a rig, and what a bridge (firmware on this computer in front of a drive) must know about it.

    Attributes
    ----------
    kind, firmware
        Kind of drive, one of `DRIVES`; name and version of the drive's firmware.
    id, prefix
        Id of the drive, and prefix of its CAN ids.
    counts_per_turn, transmission
        Encoder counts per turn of the output; angle of the output (rad) for 1 rad or 1 m of the rig.
    ranges, settings
        Ranges of the device's parameters that the drive limits, by name; further facts for the recording.
    switches
        Switches on the drive's pins.
    rate_maximum
        Largest number of samples a second.
    cycle_us, beat_us
        Period of the samples and of the heartbeats that the drive sends unrequested (µs); 0 if the bridge polls them.
    gains
        Stiffness and damping of the drive's own law (N·m/turn and N·m·s/turn at its output); None: it renders no wall.
    """

    kind: str
    firmware: str
    id: int
    prefix: int = 0
    counts_per_turn: float
    transmission: float
    ranges: dict[str, tuple[int, int]]
    settings: dict[str, int | float | str]
    switches: Switches = Switches()
    rate_maximum: int = RATE_MAXIMUM
    cycle_us: int = 0
    beat_us: int = 0
    gains: tuple[float, float] | None = None


def dictionary_of(model: RigModel, drive: FittedDrive) -> dictionaries.Dictionary:
    """Return the dictionary (parameters, ranges, faults) that a bridge reports to a host for a rig on this drive."""
    plain = describe(
        model,
        firmware=f"bridge to {drive.firmware}",
        simulated=False,
        rate_default=min(RATE_INITIAL, drive.rate_maximum),
        rate_maximum=drive.rate_maximum,
        narrower={"law": (0, LAW_ON_THE_DRIVE if drive.gains else LAW_HERE), **NO_EXCITATION, **drive.ranges},
        settings=drive.settings,
    )
    return replace(plain, faults=(*plain.faults, *explain_faults(drive.kind)))


class Bridge:
    """The software of a bridge (firmware in front of a drive) without its bus: it gets bytes and times, returns bytes.

    Attributes
    ----------
    dictionary
        Description of parameters, ranges and faults that the bridge sends to a host.
    facts
        Statistics of the bus.
    """

    def __init__(
        self,
        model: RigModel,
        drive: FittedDrive,
        *,
        checksum: bool = True,
        socket: bool = False,
        facts: BridgeFacts | None = None,
        rate: int = RATE_INITIAL,
    ) -> None:
        self._library = library()
        self._memory = ctypes.create_string_buffer(self._library.bridge_bytes())
        self._address = ctypes.addressof(self._memory)
        self._taken = ctypes.create_string_buffer(_OUTPUT_BYTES)
        self.facts = facts or BridgeFacts()
        self.dictionary = dictionary_of(model, drive)
        amplifier = model.amplifier
        torque_per_quantum = amplifier.effort_quantum / drive.transmission
        kp, kd = drive.gains or (0.0, 0.0)
        setup = Setup(
            board=BoardSetup.of(
                model,
                # The C code keeps the address of these bytes, which live as long as the dictionary.
                self.dictionary.packed,
                self.dictionary.hash,
                min(rate, drive.rate_maximum),
            ),
            rate_maximum=drive.rate_maximum,
            prefix=drive.prefix,
            drive=drive.id,
            counts_per_turn=drive.counts_per_turn,
            torque_per_quantum=model.encoder.sign * torque_per_quantum,
            torque_limit=amplifier.effort_limit / drive.transmission,
            kp=kp,
            kd=kd,
            switches=drive.switches.register,
            hold=drive.switches.hold,
            stop=drive.switches.stop,
            checksum=checksum,
            socket=socket,
            kind=DRIVES.index(drive.kind),
            cycle_us=drive.cycle_us,
            beat_us=drive.beat_us,
        )
        self._library.bridge_setup(self._address, ctypes.byref(setup), ctypes.byref(self.facts))
        for parameter, low, high in narrower(self.dictionary):
            self._library.bridge_narrow(self._address, _INDEX[parameter.name], low, high)

    def run(self, *, host: int, bus: int, wake: int, host_stays: bool) -> None:
        """Run on three file descriptors until `wake` is readable or, unless `host_stays`, the host closes its end."""
        ends = Ends(host=host, bus=bus, wake=wake, host_stays=host_stays)
        self._library.bridge_run(self._address, ctypes.byref(ends))

    # ------------------------------------------------------------------ by hand, in device time (1/16 µs)

    def start(self, now: int) -> None:
        """Start the bridge as at power-up; `now` is the device time (1/16 µs)."""
        self._library.bridge_start(self._address, now)

    def tick(self, now: int) -> bytes:
        """End a sample period at the device time `now` (1/16 µs); return the bytes for the bus."""
        self._library.bridge_tick(self._address, now)
        return self._bus()

    def receive_bus(self, data: bytes, now: int) -> bytes:
        """Process bytes from the bus at the device time `now` (1/16 µs); return the bytes for the bus."""
        self._library.bridge_receive_bus(self._address, data, len(data), now)
        return self._bus()

    def receive_host(self, data: bytes, now: int) -> bytes:
        """Process bytes from the host at the device time `now` (1/16 µs); return the bytes for the bus."""
        if data:
            self._library.bridge_receive_host(self._address, data, len(data), now)
        self._library.bridge_poll(self._address, now)
        return self._bus()

    def lose_bus(self, now: int) -> None:
        """Report to the bridge that its adapter or CAN interface was lost at the device time `now` (1/16 µs)."""
        self._library.bridge_lose_bus(self._address, now)

    def stop(self) -> bytes:
        """Stop the bridge; return the bytes for the bus."""
        self._library.bridge_stop(self._address)
        return self._bus()

    def to_host(self) -> bytes:
        """Return the bytes for the host that the bridge has queued, and empty the queue."""
        count = self._library.bridge_take(self._address, self._taken, _OUTPUT_BYTES)
        return self._taken.raw[:count]

    @property
    def due(self) -> int:
        """Device time (1/16 µs) at which the next sample period begins."""
        return int(self._library.bridge_due(self._address))

    @property
    def state(self) -> State:
        """State of the bridge in the device protocol, such as idle or armed."""
        return State(self._library.bridge_state(self._address))

    @property
    def fault(self) -> int:
        """Code of the latched fault; 0 without a fault."""
        return int(self._library.bridge_fault_now(self._address))

    @property
    def torque(self) -> float:
        """Commanded torque (N·m at the drive's output)."""
        return float(self._library.bridge_torque(self._address))

    def _bus(self) -> bytes:
        count = self._library.bridge_take_bus(self._address, self._taken, _OUTPUT_BYTES)
        return self._taken.raw[:count]
