"""Test on a board whether its port (board-specific code) provides the functions in `firmware_protocol.duties`.

The board runs `firmware/port_check/port_check.c` in place of the core, with the port's files unchanged. That program
calls the port's functions and sends its observations, which this file judges. Each function that fails (broken duty)
has its own message; for a function that could not be tested, the message states what is missing. `rig firmware
check-port` calls it. It must not drive the motor unless a current is requested.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Annotated, Any, NamedTuple

from annotated_types import Ge, Le

from firmware_protocol import messages as m
from firmware_protocol.counters import LinkStatistics
from firmware_protocol.duties import Duty, duties
from firmware_protocol.faults import Input
from firmware_protocol.framing import HEADER_BYTES, FrameSplitter, encode_frame
from rig.core import check
from rig.core.check import Check, Outcome
from rig.core.errors import ConfigError, DeviceRefusedError, LinkLostError, RigError
from rig.core.keyword import Keyword
from rig.core.present import Item, reported
from rig.devices.device import Link

# Message types of the test program; port_check.h has the same numbers.
QUESTION, ANSWER, COUNTED = 0x3C, 0x3D, 0x3F
UNITS_PER_US = 1_000 / m.TIME_UNIT_NS
UNITS_A_SECOND = 1e6 * UNITS_PER_US
UNDOABLE_RATE = 0xFFFF_FFFF
# Tolerance of counted ticks: at least so many, those of TICKS_S, or this share of the time watched.
TICKS_LEAST, TICKS_S, TICKS_SHARE = 20, 0.1, 0.1
ODD_RATE = 7_001  # a prime number, which no timer has by chance (Hz)
# Largest difference of two equal rates (share); of two clocks from one crystal (ppm).
RATE_SHARE, CLOCKS_PPM = 0.01, 300.0
GRID_SHARE = 0.05  # of a period, as in the self test
WAITS_S = 1e-4
EDGE_OFF_S = 1e-5
SYNC_EDGES = 128
# A current must be below a quarter after so many lags: it is after ln 4 = 1.4.
GONE_LAGS, GONE_S = 3.0, 1e-4
MEASURED_SHARE, MEASURED_NOISES, MEASURED_QUANTA = 0.1, 4.0, 3.0
# The transmit buffer must have room for this time at so many bytes a tick: the link may pause for so long.
BATCH_S, BATCH_BYTES = 0.1, 5
FILL_FRAMES, FILL_S = 2_000, 10.0
BITES_US = (40_000, 5_000)
ANSWER_S, RETURNS_S, TRIES = 2.0, 0.5, 5
EMULATED = 5.0  # times as long as on a board
GONE_BY_S = 0.2
REPORTS_RESET = 7  # place of this flag in the reply to `PortProbe.BOARD`
QUIET_S = 0.05  # a starved board sends a frame each millisecond

_HEAD = struct.Struct("<HH")
Progress = Callable[[str, float], None]
# Failed: the values of its message. Not tested: the reason. Passed: None.
Verdict = Mapping[str, Any] | str | None


class PortProbe(IntEnum):
    """Number by which the host requests one test from the program on the board; port_check.c has the same numbers."""

    BOARD = 0
    TIME = 1
    TICKS = 2
    RATE = 3
    HOLD = 4
    OFF = 5
    ON = 6
    DISABLE = 7
    FILL = 8
    WIRES = 9
    BITE = 10
    SUMMARY = 11
    LEAVE = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class PortCheckRequest:
    """Parameters of a check of the board's own code (port).

    Attributes
    ----------
    current
        Current to switch on (quanta); 0 leaves the amplifier off.
    real_time
        True if the board's time follows the link's clock. False for an emulator, which gets more time to reply.
    """

    wired: Annotated[
        bool,
        Keyword(
            "Give this if the sync outputs tick and trial are wired to encoder A and B, inside to the sync input."
        ),
    ] = False
    current: Annotated[
        int,
        Ge(-32768),
        Le(32767),
        Keyword(
            "Current (quanta) to switch on for some milliseconds. IT DRIVES THE MOTOR: free the handle, keep all "
            "hands off."
        ),
    ] = 0
    seconds: Annotated[
        float,
        Ge(0.05),
        Le(600.0),
        Keyword("Time (s) for which the board's clock is observed; 280 s from power-up test its bit 32 too."),
    ] = 1.0
    bootloader: Annotated[bool, Keyword("Also test the restart into the boot loader, as the last test.")] = (
        False
    )
    real_time: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class PortCheck:
    """Result of a port check: a check for each function that a board port must provide, in order of duties.toml."""

    url: str
    checks: tuple[Check, ...]

    @reported
    def passed(self) -> bool:
        """Return True if the board's own code (port) passes all checks."""
        return not check.refused(self.checks)

    def items(self) -> list[Item]:
        """Return the checks of the board's own code (port) as items to print."""
        return list(self.checks)


def failure(found: PortCheck) -> DeviceRefusedError | None:
    """Return the error that lists all functions (duties) in which a board's own code fails; None if it passes."""
    broken = check.refused(found.checks)
    if not broken:
        return None
    return DeviceRefusedError(
        "; ".join(f"duty broken: {one.text}" for one in broken), remedy=broken[0].remedy
    )


class NoAnswerError(Exception):
    """The board did not reply in time to a request of the check of its own code (port)."""


@dataclass
class BoardUnderTest:
    """A connection to the test program on the board; the link is reopened if a reset of the board closes it."""

    open_link: Callable[[], Link]
    patience: float = 1.0  # factor of all waits for a reply
    link: Link = field(init=False)
    counted: list[int] = field(default_factory=list)  # numbers of the counting frames since the last question
    statistics: LinkStatistics = field(default_factory=LinkStatistics)
    _nonce: int = 0

    def __post_init__(self) -> None:
        self.link = self.open_link()
        self._splitter = FrameSplitter(self.statistics)

    def ask(
        self, probe: PortProbe, *arguments: int, wait_s: float = ANSWER_S, quiet_s: float = ANSWER_S
    ) -> tuple[int, ...]:
        """Send a request with its arguments to the test program; return the numbers in its reply (unsigned, 32 bits).

        Raise `NoAnswerError` if no reply comes within `wait_s` (s), or no byte within `quiet_s` (s).
        """
        self._nonce = (self._nonce + 1) % 0x10000
        self.counted.clear()
        header = bytes([m.MAJOR, QUESTION]).ljust(HEADER_BYTES, b"\0")
        numbers = struct.pack(f"<{len(arguments)}I", *(one % 2**32 for one in arguments))
        self.link.write(b"\0" + encode_frame(header + _HEAD.pack(self._nonce, probe) + numbers))
        clock = self.link.clock
        received_ns = clock.now_ns()
        deadline = received_ns + round(self.patience * wait_s * 1e9)
        while clock.now_ns() < min(deadline, received_ns + round(self.patience * quiet_s * 1e9)):
            data = self.link.read(0.01)
            received_ns = clock.now_ns() if data else received_ns
            for raw in self._splitter.feed(data):
                answer = self._answer(raw)
                if answer is not None:
                    return answer
        raise NoAnswerError

    def _answer(self, raw: bytes) -> tuple[int, ...] | None:
        kind, body = raw[1], raw[HEADER_BYTES:]
        if m.MESSAGES.get(kind) in (m.Ack, m.State):
            raise DeviceRefusedError(
                f"{self.link.url.text} runs the firmware itself instead of the port check program",
                remedy="flash the image of: rig firmware build --check-port --board …",
            )
        numbers = struct.unpack_from(f"<{(len(body) - _HEAD.size) // 4}I", body, _HEAD.size)
        if kind == COUNTED:
            self.counted.append(numbers[0])
        return numbers if kind == ANSWER and _HEAD.unpack_from(body)[0] == self._nonce else None

    def meet(self) -> tuple[int, ...]:
        """Return the board's properties; repeat the request, and raise `NoAnswerError` if the board never replies."""
        for _ in range(TRIES - 1):
            with suppress(NoAnswerError):
                return self.ask(PortProbe.BOARD, wait_s=ANSWER_S / TRIES)
        return self.ask(PortProbe.BOARD)

    def answers(self, wait_s: float) -> bool:
        """Return True if the board replies to a request within `wait_s` (s)."""
        try:
            self.ask(PortProbe.BOARD, wait_s=wait_s)
        except (NoAnswerError, LinkLostError):
            return False
        return True

    def meet_again(self) -> tuple[int, ...]:
        """Return the board's properties after a reset (reply to `PortProbe.BOARD`); reopen the link if it was closed.

        Raise `NoAnswerError` if the board does not reply.
        """
        for _ in range(TRIES):
            try:
                return self.meet()
            except (RigError, NoAnswerError):
                clock = self.link.clock
                clock.sleep_until(clock.now_ns() + round(RETURNS_S * 1e9))
            with suppress(RigError):
                self.link.close()
                self.link = self.open_link()
        raise NoAnswerError

    def pause(self, seconds: float) -> None:
        """Read the link for `seconds` (s) and discard the received bytes."""
        ends = self.link.clock.now_ns() + round(seconds * 1e9)
        while (left := ends - self.link.clock.now_ns()) > 0:
            self._splitter.feed(self.link.read(left * 1e-9))


@dataclass
class PortTrial:
    """A running check of a board's own code (port): the board, its properties, the request, and the results so far."""

    board: BoardUnderTest
    request: PortCheckRequest
    rate_initial: int
    rate_maximum: int
    law_maximum: int
    senses: bool
    lag_units: int
    noise_milliquanta: int
    has_bootloader: bool
    verdicts: dict[str, Verdict] = field(default_factory=dict)
    time_ratio: float = 1.0  # device time / real time
    times: list[int] = field(default_factory=list)  # device times before and after `seconds`
    silent: bool = False

    @classmethod
    def begin(cls, board: BoardUnderTest, request: PortCheckRequest) -> PortTrial:
        """Return a new check of a board, whose properties are read first.

        Raise `ConfigError` if the requested current is above the rig's over-current limit.
        """
        rate, maximum, law, senses, lag, noise, bootloader, _reports_reset, _place, limit = board.meet()
        if abs(request.current) > limit:
            raise ConfigError(
                f"current = {request.current} quanta exceeds the rig's over-current limit of {limit} quanta",
                remedy=f"give a `current` from -{limit} to {limit} quanta",
            )
        return cls(board, request, rate, maximum, law, bool(senses), lag, noise, bool(bootloader))

    def distrust(self) -> None:
        """Replace results that depend on the board's clock by "not judged" if the test of this clock has failed."""
        if any(isinstance(self.verdicts[name], Mapping) for name in TIME):
            wrong = [name for name in BY_TIME if isinstance(self.verdicts[name], Mapping)]
            self.verdicts |= dict.fromkeys(wrong, "not judged: the board's time, which this needs, is wrong")

    def ask_signed(self, probe: PortProbe, *arguments: int) -> list[int]:
        """Send a request to the test program and return the numbers in its reply as signed 32-bit integers."""
        return [(one + 2**31) % 2**32 - 2**31 for one in self.board.ask(probe, *arguments)]


def check_port(
    open_link: Callable[[], Link],
    request: PortCheckRequest,
    on_progress: Progress = lambda _what, _share: None,
) -> PortCheck:
    """Test on a connected board all functions (duties) that a board port (the board's own code) must provide.

    Parameters
    ----------
    open_link
        Function that opens the link; it is called again if a reset of the board closes the link. The link is closed at
        the end.
    request
        Parameters of the check.
    on_progress
        Called with the name of the current test and the completed share of all tests, 0 … 1.

    Raises
    ------
    LinkLostError
        The board does not reply.
    DeviceRefusedError
        The board runs the firmware instead of the test program.
    ConfigError
        The requested current is above the rig's over-current limit.
    """
    board = BoardUnderTest(open_link, 1.0 if request.real_time else EMULATED)
    try:
        try:
            trial = PortTrial.begin(board, request)
        except NoAnswerError:
            raise LinkLostError(
                f"no reply at {board.link.url.text} from the test program of the port check",
                remedy="flash the image of rig firmware build --check-port; check port and baud rate",
            ) from None
        for number, (step, names) in enumerate(STEPS.items()):
            on_progress(step.__name__.strip("_").replace("_", " "), number / len(STEPS))
            trial.verdicts |= _try_step(step, names, trial)
        trial.distrust()
        return PortCheck(
            url=board.link.url.text, checks=tuple(_check(one, trial.verdicts[one.name]) for one in duties())
        )
    finally:
        board.link.close()


def _try_step(step: Step, names: tuple[str, ...], trial: PortTrial) -> dict[str, Verdict]:
    if trial.silent:
        return dict.fromkeys(names, "the board no longer replies")
    try:
        return dict(step(trial))
    except NoAnswerError:
        trial.silent = not trial.board.answers(ANSWER_S)
        return dict.fromkeys(names, NO_ANSWER)


TIME = ("time_steps_back", "time_width", "time_unit")
BY_TIME = (
    *("time_of_timer", "tick_rate", "tick_grid", "rate_kept", "edge_time", "sync_time"),
    *("read_waits_not", "write_waits_not", "watchdog_time"),
)
NO_ANSWER: Mapping[str, Any] = {}  # failed without a reply: compare with `is`


def _check(duty: Duty, verdict: Verdict) -> Check:
    name = duty.name.replace("_", " ")
    if verdict is None:
        return Check(name, Outcome.OK, f"{duty.call}: {duty.duty}")
    if isinstance(verdict, str):
        return Check(name, Outcome.SKIPPED, verdict)
    if verdict is NO_ANSWER:
        return Check(
            name, Outcome.REFUSED, f"no reply during the test of {duty.call}: {duty.duty}", duty.remedy
        )
    return Check(name, Outcome.REFUSED, duty.broken.format(**verdict), duty.remedy)


# ------------------------------------------------------------------ time and ticks


def _device_clock(trial: PortTrial) -> Iterator[tuple[str, Verdict]]:
    clock = trial.board.link.clock
    looks = []
    for pause_s in (0.0, trial.request.seconds):
        trial.board.pause(pause_s)
        before = clock.now_ns()
        low, high = trial.board.ask(PortProbe.TIME)
        looks.append((before, clock.now_ns(), high << 32 | low))
    (begun, replied, first), (asked, ended, second) = looks
    trial.times = [first, second]
    passed_s = ((second - first) % (2**32 if second < first else 2**64)) / UNITS_A_SECOND
    least, most = passed_s / ((ended - begun) * 1e-9), passed_s / ((asked - replied) * 1e-9)
    if not trial.request.real_time:
        yield "time_unit", "not judged: the board's time does not follow this computer's clock"
    elif least > 1.0 + RATE_SHARE or most < 1.0 - RATE_SHARE:
        trial.time_ratio = (least + most) / 2.0
        yield "time_unit", {"ratio": trial.time_ratio}
    else:
        yield "time_unit", None


def _tick_rates(trial: PortTrial) -> Iterator[tuple[str, Verdict]]:
    rates = dict.fromkeys((trial.rate_initial, min(ODD_RATE, trial.rate_maximum), trial.rate_maximum))
    drift_ppm, wrong, grid = 0.0, None, None
    for rate in [*rates, trial.rate_initial]:
        found, accepted, off_s = _measure_ticks(trial, rate, rate)
        away = found / rate - 1.0
        if abs(away) > RATE_SHARE and (accepted or rate != ODD_RATE):
            wrong = wrong or {"wanted": rate, "found": found, "answer": "accepted" if accepted else "refused"}
        elif accepted and abs(away) * 1e6 > abs(drift_ppm):
            drift_ppm = away * 1e6
        if rate == trial.rate_initial and off_s * rate > GRID_SHARE and wrong is None:
            grid = {"us": off_s * 1e6, "rate": rate}
    yield "tick_rate", wrong
    yield "time_of_timer", {"ppm": drift_ppm} if abs(drift_ppm) > CLOCKS_PPM else None
    yield "tick_grid", grid if wrong is None else "not judged: the tick rate is not the set rate"


class _MeasuredTicks(NamedTuple):
    """Measured tick rate (Hz, an error of the board's clock is corrected), and the jitter of the ticks (s)."""

    rate: float
    is_rate_accepted: bool
    jitter_s: float


def _measure_ticks(trial: PortTrial, rate: int, expected: int) -> _MeasuredTicks:
    """Set the tick rate `rate` (Hz; 0: keep the present one), then measure ticks, `expected` per second."""
    wanted = max(TICKS_LEAST, round(min(TICKS_S, TICKS_SHARE * trial.request.seconds) * expected))
    accepted, count, passed, *off = trial.ask_signed(PortProbe.TICKS, rate, wanted)
    least, most, newest = off
    found = count * UNITS_A_SECOND / (passed % 2**32) * trial.time_ratio if count and passed else 0.0
    return _MeasuredTicks(found, bool(accepted), (most - least - abs(newest)) / UNITS_A_SECOND)


def _impossible_rate(trial: PortTrial) -> Iterator[tuple[str, Verdict]]:
    (accepted,) = trial.board.ask(PortProbe.RATE, UNDOABLE_RATE)
    yield "rate_refused", {"wanted": UNDOABLE_RATE} if accepted else None
    rate = trial.rate_initial
    found = rate if accepted else _measure_ticks(trial, 0, rate).rate
    broken = {"wanted": UNDOABLE_RATE, "found": found, "rate": rate}
    if accepted:
        yield "rate_kept", "not judged: no rate was refused"
    else:
        yield "rate_kept", broken if abs(found / rate - 1.0) > RATE_SHARE else None
    trial.board.ask(PortProbe.TICKS, rate, 1)


def _nested_interrupts(trial: PortTrial) -> Iterator[tuple[str, Verdict]]:
    names = ("ticks_in_poll", "polls_in_tick", "ticks_in_tick")
    seen = dict(zip(names, trial.board.ask(PortProbe.HOLD), strict=True))
    yield "not_nested", seen if any(seen.values()) else None


# ------------------------------------------------------------------ pins


def _wired_pins(trial: PortTrial) -> Iterator[tuple[str, Verdict]]:
    encoder = ("encoder_count", "edge_time", "encoder_failed")
    if not trial.request.wired:
        why = "wire the sync outputs tick and trial to A and B, inside to the sync input, and give `wired`"
        yield from dict.fromkeys(STEPS[_wired_pins], why).items()
        return
    moved, wrong, missed, edge_off, alarmed, failed, again, rose, sync_off, fell = trial.ask_signed(
        PortProbe.WIRES
    )
    nothing = not moved and not rose
    yield "sync_bits", {} if nothing else None
    if nothing:
        yield from dict.fromkeys(
            ("sync_time", *encoder), "not judged: no edge of the sync outputs was seen"
        ).items()
        return
    counted = {"wrong": wrong, "edges": SYNC_EDGES, "missed": missed}
    yield "encoder_count", counted if wrong or missed else None
    results = {
        name: str(bool(one)).lower()
        for name, one in (("alarmed", alarmed), ("failed", failed), ("again", again))
    }
    yield "encoder_failed", results if (alarmed, failed, again) != (0, 1, 0) else None
    edge_us = edge_off % 2**32 / UNITS_PER_US
    yield "edge_time", {"us": edge_us} if edge_us > EDGE_OFF_S * 1e6 else None
    sync_us = sync_off % 2**32 / UNITS_PER_US
    late = {"us": sync_us, "fell": str(bool(fell)).lower()}
    yield "sync_time", late if sync_us > EDGE_OFF_S * 1e6 or fell else None


# ------------------------------------------------------------------ link


def _transmit_buffer(trial: PortTrial) -> Iterator[tuple[str, Verdict]]:
    board, before = trial.board, _count_damaged(trial.board.statistics)
    taken, room, refused, longest, total = board.ask(PortProbe.FILL, FILL_FRAMES, wait_s=FILL_S)
    came, torn = board.counted, _count_damaged(board.statistics) - before
    broken = {"taken": taken, "came": len(came), "torn": torn, "others": ""}
    if len(came) == taken and sum(came) % 2**32 != total:
        broken["others"] = ", including frames reported as dropped"
    yield "write_whole", broken if torn or broken["others"] or len(came) != taken else None
    waits_s = longest / UNITS_A_SECOND
    yield "write_waits_not", {"ms": waits_s * 1e3} if waits_s > WAITS_S else None
    wanted = round(BATCH_S * BATCH_BYTES * trial.rate_maximum)
    short = {"bytes": room, "wanted": wanted, "rate": trial.rate_maximum}
    if trial.law_maximum == 0:
        yield "write_room", "the board runs no law, so it sends no BATCH"
    else:
        yield "write_room", short if refused and room < wanted else None


def _count_damaged(statistics: LinkStatistics) -> int:
    return statistics.framing_errors + statistics.crc_errors


# ------------------------------------------------------------------ observed during all tests so far


def _observations_so_far(trial: PortTrial) -> Iterator[tuple[str, Verdict]]:
    low, high, read_units, overruns, ever = trial.board.ask(PortProbe.SUMMARY)
    back = high << 32 | low
    begins_again = back > UNITS_A_SECOND
    yield "time_steps_back", {"us": back / UNITS_PER_US} if back and not begins_again else None
    crossed = trial.times[0] >> 32 != trial.times[1] >> 32
    unseen = "not observed for long enough: give 280 `seconds` from power-up"
    yield ("time_width", {"s": back / UNITS_A_SECOND} if begins_again else None if crossed else unseen)
    yield "read_room", {"overruns": overruns} if overruns else None
    waits_s = read_units / UNITS_A_SECOND
    yield "read_waits_not", {"ms": waits_s * 1e3} if waits_s > WAITS_S else None
    foreign = ever & ~int(Input.EMERGENCY_STOP | Input.HOLD_TO_RUN | Input.SYNC)
    yield "inputs_bits", {"bits": foreign} if foreign else None


# ------------------------------------------------------------------ resets


def _watchdog(trial: PortTrial) -> Iterator[tuple[str, Verdict]]:
    slow_us, fast_us = BITES_US
    lived_ms, bitten = _starve(trial.board, slow_us)
    if not bitten:
        yield "watchdog_bites", {"ms": lived_ms, "bite": slow_us * 1e-3}
        yield from dict.fromkeys(
            ("watchdog_time", "reset_reported"), "not judged: the watchdog does not reset the board"
        ).items()
        return
    yield "watchdog_bites", None
    is_reported = bool(trial.board.meet_again()[REPORTS_RESET])
    yield "reset_reported", None if is_reported else {}
    found = [(lived_ms, slow_us * 1e-3)]
    lived_ms, bitten = _starve(trial.board, fast_us)
    found.append((lived_ms, fast_us * 1e-3))
    if bitten:
        trial.board.meet_again()
    wrong = [(ms, bite) for ms, bite in found if not 0.5 * bite <= ms <= 1.5 * bite]
    yield "watchdog_time", {"ms": wrong[0][0], "bite": wrong[0][1]} if wrong else None


def _starve(board: BoardUnderTest, bite_us: int) -> tuple[int, bool]:
    """Let the watchdog expire after `bite_us` (µs); return how long the board ran (ms), and True if it was reset."""
    try:
        (lived_ms,) = board.ask(PortProbe.BITE, bite_us, wait_s=8e-6 * bite_us + 0.2, quiet_s=QUIET_S)
    except (NoAnswerError, LinkLostError):
        return max(board.counted, default=0), True
    return lived_ms, False


# ------------------------------------------------------------------ amplifier


def _amplifier(trial: PortTrial) -> Iterator[tuple[str, Verdict]]:
    names, quanta = STEPS[_amplifier], trial.request.current
    why = _why_no_current(trial)
    if why:
        yield from dict.fromkeys(names, why).items()
        return
    off, last, started = trial.ask_signed(PortProbe.OFF, quanta)
    first, mean, zero_units = trial.ask_signed(PortProbe.ON, quanta)
    (off_units,) = trial.ask_signed(PortProbe.DISABLE, quanta)
    if first == last == quanta:
        echoed = {"quanta": quanta, "wanted": 0, "echo": " with the amplifier off: it repeats the set-point"}
        yield "measured_flows", echoed
        yield from dict.fromkeys(
            names[1:], "not judged: measured_current does not measure the current"
        ).items()
        return
    near = max(
        MEASURED_SHARE * abs(quanta), MEASURED_NOISES * 1e-3 * trial.noise_milliquanta + MEASURED_QUANTA
    )
    wrong = {"quanta": mean, "wanted": quanta, "echo": ""}
    yield "measured_flows", wrong if abs(mean - quanta) > near else None
    flows = abs(quanta) / 4.0
    if off > flows:
        yield "off_until_enabled", {"quanta": off}
        yield "starts_from_zero", "not judged: the amplifier is on before it is enabled"
    else:
        yield "off_until_enabled", None
        yield "starts_from_zero", {"quanta": started} if started > flows else None
    limit = GONE_LAGS * trial.lag_units + GONE_S * UNITS_A_SECOND
    for name, units in (("zero_at_once", zero_units), ("off_at_once", off_units)):
        yield name, {"ms": units / UNITS_PER_US * 1e-3} if units > limit else None


def _why_no_current(trial: PortTrial) -> str:
    if not trial.senses:
        return "the board measures no current"
    if not trial.request.current:
        return "free the handle or replace the motor by a resistor, and give a `current`"
    # A current that is switched off late, because time or watchdog are wrong, can burn the winding.
    if any(isinstance(trial.verdicts[name], Mapping) for name in (*TIME, "tick_rate", "watchdog_bites")):
        return "not tested: time, tick and watchdog must pass first"
    return ""


# ------------------------------------------------------------------ boot loader


def _boot_loader(trial: PortTrial) -> Iterator[tuple[str, Verdict]]:
    if not trial.has_bootloader:
        yield "bootloader", "the board has no boot loader"
    elif not trial.request.bootloader:
        yield "bootloader", "not tested: give `bootloader` to enter it at the end"
    else:
        with suppress(NoAnswerError, LinkLostError):
            trial.board.ask(PortProbe.LEAVE, wait_s=GONE_BY_S)
        yield "bootloader", {} if trial.board.answers(GONE_BY_S) else None


Step = Callable[[PortTrial], Iterator[tuple[str, Verdict]]]
# In the order of execution: no current before clock and watchdog have passed, and the boot loader last.
STEPS: dict[Step, tuple[str, ...]] = {
    _device_clock: ("time_unit",),
    _tick_rates: ("tick_rate", "time_of_timer", "tick_grid"),
    _impossible_rate: ("rate_refused", "rate_kept"),
    _nested_interrupts: ("not_nested",),
    _wired_pins: ("sync_bits", "encoder_count", "edge_time", "encoder_failed", "sync_time"),
    _transmit_buffer: ("write_whole", "write_waits_not", "write_room"),
    _observations_so_far: ("time_steps_back", "time_width", "read_room", "read_waits_not", "inputs_bits"),
    _watchdog: ("watchdog_bites", "watchdog_time", "reset_reported"),
    _amplifier: ("measured_flows", "off_until_enabled", "starts_from_zero", "zero_at_once", "off_at_once"),
    _boot_loader: ("bootloader",),
}
