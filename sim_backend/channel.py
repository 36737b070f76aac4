"""A line that fails on command: frames dropped, corrupted, doubled, swapped, cut, delayed, silenced, unplugged.

`Faults` is a script: what happens to frame n of a direction, and what happens to the device at tick n. A test that
runs it for every n of a short run has seen every place where a link can break.

It mirrors what happens on USB and serial lines: noise (corrupt), full buffers (drop, truncate), retries of a hub
(duplicate, delay), a dead cable (silence), a pulled plug.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any

from firmware_protocol.faults import Fault


class Direction(Enum):
    """Which way the bytes go."""

    TO_DEVICE = "to device"
    TO_HOST = "to host"


class Kind(Enum):
    """What can happen to a frame."""

    DROP = "drop"
    CORRUPT = "corrupt"  # bit `bit` of byte `byte` flips; a 0x00 may appear or vanish
    DUPLICATE = "duplicate"
    REORDER = "reorder"  # it comes after the next frame of its direction
    TRUNCATE = (
        "truncate"  # only its first `byte` bytes come, without a delimiter: it runs into the next frame
    )
    DELAY = "delay"  # it, and all behind it, wait for `ticks` ticks
    SILENCE = "silence"  # it and all that follow are lost
    UNPLUG = "unplug"  # the line is gone in both directions, and both ends are notified


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFault:
    """What happens to frame number `frame` (from 0) of a direction; `byte` is taken modulo the frame's length."""

    kind: Kind
    direction: Direction
    frame: int
    byte: int = 0
    bit: int = 0
    ticks: int = 1
    both: bool = False  # SILENCE: in the other direction as well


@dataclass(frozen=True, slots=True)
class DeviceFault:
    """A fault that the device finds when `tick` ticks have passed; EMERGENCY_STOP means that it is pressed."""

    tick: int
    fault: Fault


@dataclass(frozen=True, slots=True)
class Happening:
    """What the world does to a device when `tick` ticks have passed: `act` is called with the device."""

    tick: int
    act: Callable[[Any], None]


@dataclass(frozen=True, slots=True)
class Faults:
    """A script for one run."""

    frames: tuple[FrameFault, ...] = ()
    device: tuple[DeviceFault | Happening, ...] = ()


class Line:
    """Both directions of a link, frame by frame, under a script.

    Attributes
    ----------
    unplugged
        Nothing moves any more.
    frames
        Frames sent so far in each direction.
    acted
        How often each kind of fault has struck.
    """

    def __init__(self, faults: Iterable[FrameFault] = ()) -> None:
        self.unplugged = False
        self.frames = dict.fromkeys(Direction, 0)
        self.acted: Counter[Kind] = Counter()
        self._faults: dict[tuple[Direction, int], list[FrameFault]] = {}
        self.add(faults)
        self._silent: set[Direction] = set()
        self._unfinished = dict.fromkeys(Direction, b"")
        self._held: dict[Direction, list[bytes]] = {direction: [] for direction in Direction}
        self._under_way: dict[Direction, deque[tuple[int, bytes]]] = {d: deque() for d in Direction}

    def add(self, faults: Iterable[FrameFault]) -> None:
        """Add to the script, also in the middle of a run."""
        for fault in faults:
            self._faults.setdefault((fault.direction, fault.frame), []).append(fault)

    def send(self, direction: Direction, data: bytes, tick: int) -> None:
        """Put bytes on the line when `tick` ticks have passed; an incomplete frame waits for the rest."""
        *frames, self._unfinished[direction] = (self._unfinished[direction] + data).split(b"\0")
        for frame in frames:
            if frame:  # a delimiter alone is not a frame
                self._send_frame(direction, frame + b"\0", tick)

    def receive(self, direction: Direction, tick: int) -> bytes:
        """Return what has come out at the other end when `tick` ticks have passed."""
        queue = self._under_way[direction]
        out = b""
        while queue and queue[0][0] <= tick and not self.unplugged:
            out += queue.popleft()[1]
        return out

    def next_due(self) -> int | None:
        """Return when the first of what is under way comes out (ticks); None when nothing will."""
        due = [queue[0][0] for queue in self._under_way.values() if queue]
        return min(due) if due and not self.unplugged else None

    def _send_frame(self, direction: Direction, frame: bytes, tick: int) -> None:
        number = self.frames[direction]
        self.frames[direction] = number + 1
        behind, self._held[direction] = self._held[direction], []
        pieces = [frame]
        for fault in self._faults.get((direction, number), ()):
            self.acted[fault.kind] += 1
            pieces, tick = self._strike(fault, pieces, tick)
        if direction in self._silent:
            pieces, behind = [], []
        queue = self._under_way[direction]
        if queue:
            tick = max(tick, queue[-1][0])  # a line keeps the order: a delayed frame holds up those behind it
        queue.extend((tick, piece) for piece in pieces + behind)

    def _strike(self, fault: FrameFault, pieces: list[bytes], tick: int) -> tuple[list[bytes], int]:
        """Return what is left of a frame, and when it comes."""
        if fault.kind is Kind.REORDER:
            self._held[fault.direction] = pieces
        elif fault.kind is Kind.SILENCE:
            self._silent |= set(Direction) if fault.both else {fault.direction}
        elif fault.kind is Kind.UNPLUG:
            self.unplugged = True
        elif fault.kind is Kind.DELAY:
            tick += fault.ticks
        leave = _LEFT.get(fault.kind)
        return [left for piece in pieces for left in leave(piece, fault)] if leave else [], tick


def _flip(frame: bytes, fault: FrameFault) -> bytes:
    damaged = bytearray(frame)
    damaged[fault.byte % len(frame)] ^= 1 << fault.bit
    return bytes(damaged)


# What is left of a frame; of the other kinds, nothing.
_LEFT: dict[Kind, Callable[[bytes, FrameFault], list[bytes]]] = {
    Kind.CORRUPT: lambda frame, fault: [_flip(frame, fault)],
    Kind.DUPLICATE: lambda frame, _: [frame, frame],
    Kind.TRUNCATE: lambda frame, fault: [frame[: fault.byte % len(frame)]],
    Kind.DELAY: lambda frame, _: [frame],
}
