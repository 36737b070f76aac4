"""The latencies of each control tick: when its sample was taken and received, its command sent and applied.

The times are computed from columns of the rows (`rig.core.sample`) and from a clock fit (host time over device time). A
tick has five times on the host's clock, 0 where unknown:

========  =====================================================================================================
sampled   the device read its encoder: device time, converted by the clock fit
received  the loop received the STATE, the message with the sample
computed  the control law finished the computation of its effort
sent      the link accepted the COMMAND, the message with the effort
applied   the COMMAND was active, at the earliest: device time of sample k − a, where STATE k is the first that
          reports the COMMAND as active, and a is the age in ticks that STATE k reports; or the time of sending, if
          that is later. A device reports only the tick in which a COMMAND arrived: the real time may be up to a tick
          later
========  =====================================================================================================

Storing a recording as Parquet, its events, timing summaries and the LSL clock (lab streaming layer) use this module. It
must not judge a run or read files.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.clock_fit import ClockFit
from rig.core.sample import RowFlag


class Span(NamedTuple):
    """A latency stage of a tick: names of its begin and end time, and a text on a further cause of delay (`with_`)."""

    begin: str
    end: str
    with_: str = ""

    @property
    def label(self) -> str:
        """Text "BEGIN to END" with the names of the two times, e.g. ``sampled to received``."""
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
# The device received no COMMAND yet, or its age is beyond the range of the field.
NO_AGE = 0xFFFF

_Ints = NDArray[np.int64]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingFacts:
    """Timing facts about a whole recording.

    Attributes
    ----------
    passed_over
        Number of samples that the control law did not use.
    never_active
        Number of commands that the device never reported as active although it reported a later command as active.
    unanswered
        Number of commands sent after the last command reported as active: the recording ends before their report.
    within_tick
        Number of commands whose computed time of application is before the time of sending, which is used instead.
    period_ns
        Length of a device tick (ns).
    clock
        Fit of host time over device time; None if the clocks were not compared.
    clock_sd_ns
        Largest standard uncertainty of the times sampled and applied (ns), without the error by asymmetric delays.
    loop
        Where the control law ran: "host" or "device".
    execution_ns
        Worst execution time of a device tick, as measured by the device (ns); None if the law ran on the host.
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
    """Times of each control tick (ns, host clock; 0 where unknown), with tick number, sample number and lateness.

    Attributes
    ----------
    tick, sample_index
        Number of the control tick, and number of the device's sample.
    sampled, received, computed, sent, applied
        Time at which the encoder was sampled, the sample received, the effort computed, the command sent, and the
        command applied (ns). The times sampled and applied are 0 without a clock fit.
    lateness, late
        Delay of the receipt after its regular time (ns), and True where the loop counted the tick as late.
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
        """Return a latency in each tick (ns), and a mask that is True where it is known.

        `name` is the latency, such as "transport_in" (a key of `STAGES`), or `LATENESS`: how much later than on a
        regular grid the sample was received.
        """
        if name == LATENESS:
            return self.lateness, np.ones(len(self.lateness), bool)
        begin, end = getattr(self, STAGES[name].begin), getattr(self, STAGES[name].end)
        return end - begin, (begin != 0) & (end != 0)


def ledger(rows: NDArray[np.void], fit: ClockFit | None, period_ns: float, loop: str = "host") -> Ledger:
    """Return when each tick was sampled, received, computed, sent and applied (ns, on the host's clock).

    `rows` are in the order of the ticks; some may be missing. `fit` converts device to host time; None if the clocks
    were not compared. `period_ns` is the length of a device tick (ns, device clock), `loop` where the law ran: "host"
    or "device".
    """
    received = _column(rows, "received_at")
    # A law on the device answers no sample by a COMMAND: the device applied its effort in the tick of the sample
    # itself, and `execution_ns` bounds the delay. No tick is late then, because nothing waited for a sample.
    on_device = loop == "device"
    no_commands = np.full(len(rows), -1, np.int64), 0, 0
    shown_at, never, unanswered = no_commands if on_device else _active(rows)
    sampled, applied = np.zeros_like(received), np.zeros_like(received)
    sent = _column(rows, "sent_at")
    clock_sd, within_tick = None, 0
    if fit is not None and len(rows):
        device = device_times(rows["device_time"], fit, int(received[0]))
        # Both times carry the errors of the fit, with opposite signs in the transport of the sample and of the command;
        # the latency from sampled to applied is free of the fit's offset.
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
    """Return the device times of rows (ns) without wrap-around, with the same zero as the clock fit `fit`.

    `near_host_ns` is the host time at which the first row was received (ns).
    """
    # A STATE has 32 bits of the device's clock: the first receipt gives the multiple of 268 s to add.
    wraps = round((int(fit.device_of(np.array([near_host_ns]))[0]) - int(device_time[0])) / WRAP_NS)
    return device_time + wraps * WRAP_NS


def _column(rows: NDArray[np.void], name: str) -> _Ints:
    return np.ascontiguousarray(rows[name], np.int64)


def _active(rows: NDArray[np.void]) -> tuple[_Ints, int, int]:
    """Return the row number at which the device first reports each row's command as active (−1: never).

    Also return the number of commands that never became active, and of those sent after the last one reported.
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
    age = rows["command_age"][shown_at]
    index = _column(rows, "sample_index")
    wanted = index[shown_at] - age
    place = np.minimum(np.searchsorted(index, wanted), len(index) - 1)
    counted = device[shown_at] - np.rint(age * period_ns).astype(np.int64)
    return np.where(index[place] == wanted, device[place], counted)
