"""The latency ledger: when each sample was taken, received, answered and applied, on one clock.

Arithmetic on columns of rows (`rig.core.sample`), with a clock fit where there is one. A tick has five times on the
host's clock, 0 where unknown:

========  =====================================================================================================
sampled   the device read its encoder: device time through the clock fit
received  the loop received the STATE
computed  the law had computed its effort
sent      the link had accepted the COMMAND
applied   the COMMAND was active, at the earliest: device time of sample k − a, where STATE k is the first that names
          it as the active one, and a is the age that it gives; or when it was sent, if that is later. A device
          reports the tick in which a COMMAND came, not the time: it may have been up to a tick later
========  =====================================================================================================

Sampled and applied carry the errors of the clock fit, with opposite signs in the two transports; the whole way, from
sampled to applied, is free of its offset.

Where the law ran on the device (`Ledger.loop`) no COMMAND answers a sample: the device applied its effort in the tick
of the sample itself, and `execution_ns` bounds how long after it. Only sampled and received are known then, and how
late a batch brought the sample; no tick is late, because nothing waited for it.

Sealing, marks, the summaries of timing and the clock of LSL call it. It must not judge a run or read a file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.clock_fit import ClockFit
from rig.core.sample import RowFlag


class Span(NamedTuple):
    """The two times between which a stage lies, and what delays it beyond them."""

    begin: str
    end: str
    with_: str = ""

    @property
    def label(self) -> str:
        """Return the text ``sampled to received`` of the span's two ends."""
        return f"{self.begin} to {self.end}"


STAGES = {
    "transport_in": Span("sampled", "received"),
    "law": Span("received", "computed"),
    "send": Span("computed", "sent"),
    "answered": Span("sampled", "sent"),
    "transport_out": Span("sent", "applied", "with the wait for the device's tick"),
    "whole": Span("sampled", "applied"),
}
LATENESS = "lateness"
WRAP_NS = (1 << 32) * 125 // 2  # the u32 of a STATE counts units of 62.5 ns
SEQUENCES = 1 << 16
NO_AGE = 0xFFFF  # no COMMAND yet, or an age beyond the range of the field

_Ints = NDArray[np.int64]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingFacts:
    """Timing facts of a recording as a whole.

    Attributes
    ----------
    passed_over
        Samples that the law did not see.
    never_active
        Commands that no STATE named though a later one became active; among them those that were overtaken.
    unanswered
        Commands behind the last one known active: the recording ends before the device could report it.
    within_tick
        Commands sent after the sample from which they count, so that the time of sending counts as applied.
    period_ns
        Length of a device tick.
    clock
        The fit, or None.
    clock_sd_ns
        Largest standard uncertainty of sampled and applied in this recording, without what asymmetry may add.
    loop
        Where the law ran: "host" or "device".
    execution_ns
        Worst execution time of a device tick, as the device counted it; None where the law ran on the host.
    """

    passed_over: int
    never_active: int
    unanswered: int
    within_tick: int
    period_ns: float
    clock: ClockFit | None
    clock_sd_ns: float | None
    loop: str
    execution_ns: int | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ledger(TimingFacts):
    """Times of each tick (ns, host clock; 0 where unknown), and what else the rows state.

    Attributes
    ----------
    tick, sample_index
        Numbers of step and sample.
    sampled, received, computed, sent, applied
        See the module's text; sampled and applied are 0 without a clock fit.
    lateness, late
        Receipt behind the grid (ns), and whether the loop counted it as late.
    """

    tick: _Ints
    sample_index: _Ints
    sampled: _Ints
    received: _Ints
    computed: _Ints
    sent: _Ints
    applied: _Ints
    lateness: _Ints
    late: _Mask

    def stage(self, name: str) -> tuple[_Ints, _Mask]:
        """Return the length of a stage in each tick (ns) and whether it is known; `LATENESS` is one of them."""
        if name == LATENESS:
            return self.lateness, np.ones(len(self.lateness), bool)
        begin, end = getattr(self, STAGES[name].begin), getattr(self, STAGES[name].end)
        return end - begin, (begin != 0) & (end != 0)


def ledger(rows: NDArray[np.void], fit: ClockFit | None, period_ns: float, loop: str = "host") -> Ledger:
    """Put the times of each tick on the host's clock.

    Parameters
    ----------
    rows
        Rows of a recording, in the order of the ticks; some may be missing.
    fit
        Host against device clock, or None when they were never compared.
    period_ns
        Length of a device tick (ns, device clock).
    loop
        Where the law ran: "host" or "device".
    """
    received = _column(rows, "received_at")
    on_device = loop == "device"
    no_commands = np.full(len(rows), -1, np.int64), 0, 0
    shown_at, never, unanswered = no_commands if on_device else _active(rows)
    sampled, applied = np.zeros_like(received), np.zeros_like(received)
    sent = _column(rows, "sent_at")
    clock_sd, within_tick = None, 0
    if fit is not None and len(rows):
        device = device_times(rows["device_time"], fit, int(received[0]))
        sampled = fit.host_of(device)
        clock_sd = float(fit.sd_of(device[[0, -1]]).max())
        known = shown_at >= 0
        applied[known] = fit.host_of(_became_active(rows, device, shown_at[known], period_ns))
        doubt_ns = 3.0 * clock_sd + fit.asymmetry_bound_ns
        # The clocks' fit may place the effect up to a period before its command; further apart, the clocks are wrong.
        early = known & (applied < sent) & (sent - applied <= period_ns + doubt_ns)
        applied[early] = sent[early]
        within_tick = int(np.count_nonzero(early))
    return Ledger(
        tick=_column(rows, "tick"),
        sample_index=_column(rows, "sample_index"),
        sampled=sampled,
        received=received,
        computed=_column(rows, "computed_at"),
        sent=sent,
        applied=applied,
        lateness=_column(rows, "lateness"),
        late=(rows["flags"] & int(RowFlag.LATE)) != 0,
        passed_over=int((rows["elapsed_ticks"] - 1).sum()),
        never_active=never,
        unanswered=unanswered,
        within_tick=within_tick,
        period_ns=period_ns,
        clock=fit,
        clock_sd_ns=clock_sd,
        loop=loop,
        execution_ns=int(rows["execution_time"].max(initial=0)) if on_device else None,
    )


def device_times(device_time: NDArray[np.int64], fit: ClockFit, near_host_ns: int) -> NDArray[np.int64]:
    """Return the device times of rows on the scale of the clock exchanges (ns)."""
    # A STATE has 32 bits of the device's clock: the first receipt gives the multiple of 268 s to add.
    wraps = round((int(fit.device_of(np.array([near_host_ns]))[0]) - int(device_time[0])) / WRAP_NS)
    return device_time + wraps * WRAP_NS


def _column(rows: NDArray[np.void], name: str) -> _Ints:
    return np.ascontiguousarray(rows[name], np.int64)


def _active(rows: NDArray[np.void]) -> tuple[_Ints, int, int]:
    """Place of the first row that shows each row's active command, −1 for none; commands passed over; unanswered.

    An active command was sent before the row that shows it, at most half a round of the sequence numbers before.
    """
    shown_at = np.full(len(rows), -1, np.int64)
    if not len(rows):
        return shown_at, 0, 0
    sequence = _column(rows, "command_sequence")
    steps = np.diff(sequence, prepend=sequence[:1]) % SEQUENCES
    sent = int(sequence[0]) + np.cumsum(steps)
    back = (sent - rows["command_active"] - 1) % SEQUENCES + 1
    age = rows["command_age"]
    good = np.flatnonzero((back <= SEQUENCES // 2) & (age >= 0) & (age < NO_AGE))
    numbers, first = np.unique((sent - back)[good], return_index=True)
    if not len(numbers):
        return shown_at, 0, len(rows)
    place = np.minimum(np.searchsorted(numbers, sent), len(numbers) - 1)
    known = numbers[place] == sent
    shown_at[known] = good[first[place[known]]]
    overtaken = ~known & (sent < numbers[-1])
    return shown_at, int(overtaken.sum()), int((~known & ~overtaken).sum())


def _became_active(rows: NDArray[np.void], device: _Ints, shown_at: _Ints, period_ns: float) -> _Ints:
    """Return the device time of sample k − a: of its row, else counted back from the row of sample k."""
    age = rows["command_age"][shown_at]
    index = _column(rows, "sample_index")
    wanted = index[shown_at] - age
    place = np.minimum(np.searchsorted(index, wanted), len(index) - 1)
    counted = device[shown_at] - np.rint(age * period_ns).astype(np.int64)
    return np.where(index[place] == wanted, device[place], counted)
