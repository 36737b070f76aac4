"""Apply scripted faults (`rig.devices.fault_script`) to the frames of a simulated link.

Links in virtual time and served drives use it. Without a fault it must not change a byte.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterable

from rig.devices.fault_script import Direction, FaultKind, FrameFault


class ScriptedLine:
    """A line between host and device whose frames are damaged, delayed or dropped by a script.

    Attributes
    ----------
    unplugged
        True after a scripted unplug: no more bytes are delivered.
    frames
        Number of frames sent so far in each direction.
    acted
        Number of times that each kind of fault has acted.
    """

    def __init__(self, faults: Iterable[FrameFault] = ()) -> None:
        self.unplugged = False
        self.frames = dict.fromkeys(Direction, 0)
        self.acted: Counter[FaultKind] = Counter()
        self._faults_by_frame: dict[tuple[Direction, int], list[FrameFault]] = {}
        self._faults_by_tick: dict[Direction, list[FrameFault]] = {direction: [] for direction in Direction}
        self.add(faults)
        self._silent: set[Direction] = set()
        self._unfinished = dict.fromkeys(Direction, b"")
        self._reordered: dict[Direction, list[bytes]] = {direction: [] for direction in Direction}
        self._in_transit: dict[Direction, deque[tuple[int, bytes]]] = {d: deque() for d in Direction}

    def add(self, faults: Iterable[FrameFault]) -> None:
        """Add faults to the script; allowed also during a run."""
        for fault in faults:
            if fault.frame is None:
                self._faults_by_tick[fault.direction].append(fault)
            else:
                self._faults_by_frame.setdefault((fault.direction, fault.frame), []).append(fault)

    def send(self, direction: Direction, data: bytes, tick: int) -> None:
        """Send bytes in a direction at tick `tick`; an incomplete frame waits for its remaining bytes."""
        *frames, self._unfinished[direction] = (self._unfinished[direction] + data).split(b"\0")
        for frame in frames:
            if frame:  # a delimiter alone is not a frame
                self.send_frame(direction, frame + b"\0", tick)

    def receive(self, direction: Direction, tick: int) -> bytes:
        """Return the bytes sent in a direction (to the host or to the device) that have arrived by tick `tick`."""
        queue = self._in_transit[direction]
        out = b""
        while queue and queue[0][0] <= tick and not self.unplugged:
            out += queue.popleft()[1]
        return out

    def next_due(self) -> int | None:
        """Return the tick at which the next delayed bytes arrive; None if no bytes are delayed."""
        due = [queue[0][0] for queue in self._in_transit.values() if queue]
        return min(due) if due and not self.unplugged else None

    def send_frame(self, direction: Direction, frame: bytes, tick: int) -> None:
        """Send one complete frame, of any format, in a direction at tick `tick`, with the faults of the script."""
        number = self.frames[direction]
        self.frames[direction] = number + 1
        reordered, self._reordered[direction] = self._reordered[direction], []
        pieces = [frame]
        for fault in self._find_due(direction, number, tick):
            self.acted[fault.kind] += 1
            pieces, tick = self._apply(fault, pieces, tick)
        if direction in self._silent:
            pieces, reordered = [], []
        queue = self._in_transit[direction]
        if queue:
            tick = max(tick, queue[-1][0])  # a line keeps the order: a delayed frame delays those behind it
        queue.extend((tick, piece) for piece in pieces + reordered)

    def _find_due(self, direction: Direction, number: int, tick: int) -> list[FrameFault]:
        """Return the faults of frame `number`, sent at `tick`: those for this number, and for a tick up to `tick`."""
        waiting = self._faults_by_tick[direction]
        now = [fault for fault in waiting if fault.tick is not None and fault.tick <= tick]
        # A fault at a tick acts on the first frame after it, once.
        self._faults_by_tick[direction] = [fault for fault in waiting if fault not in now]
        return [*self._faults_by_frame.get((direction, number), ()), *now]

    def _apply(self, fault: FrameFault, pieces: list[bytes], tick: int) -> tuple[list[bytes], int]:
        """Apply a fault to the `pieces` of a frame; return the pieces that are delivered, and the tick of delivery."""
        if fault.kind is FaultKind.REORDER:
            self._reordered[fault.direction] = pieces
        elif fault.kind is FaultKind.SILENCE:
            self._silent |= set(Direction) if fault.both else {fault.direction}
        elif fault.kind is FaultKind.UNPLUG:
            self.unplugged = True
        elif fault.kind is FaultKind.DELAY:
            tick += fault.ticks
        leave = _DELIVERED.get(fault.kind)
        return [left for piece in pieces for left in leave(piece, fault)] if leave else [], tick


def _flip(frame: bytes, fault: FrameFault) -> bytes:
    damaged = bytearray(frame)
    damaged[fault.byte % len(frame)] ^= 1 << fault.bit
    return bytes(damaged)


# Pieces of a frame that each kind of fault still delivers; the other kinds deliver nothing.
_DELIVERED: dict[FaultKind, Callable[[bytes, FrameFault], list[bytes]]] = {
    FaultKind.CORRUPT: lambda frame, fault: [_flip(frame, fault)],
    FaultKind.DUPLICATE: lambda frame, _: [frame, frame],
    FaultKind.TRUNCATE: lambda frame, fault: [frame[: fault.byte % len(frame)]],
    FaultKind.DELAY: lambda frame, _: [frame],
}
