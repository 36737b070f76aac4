"""The latency ledger: when each sample was taken, received, answered and applied, on one clock, and a summary.

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
late a batch brought the sample; no tick is late, because nobody waited for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.clock_fit import ClockFit
from rig.core.sample import RowFlag
from rig.recording.quantiles import Quantile, quantile

# Stage → the times between which it lies, and what it is.
STAGES: dict[str, tuple[str, str, str]] = {
    "transport_in": ("sampled", "received", "sampled to received"),
    "law": ("received", "computed", "received to computed"),
    "send": ("computed", "sent", "computed to sent"),
    "answered": ("sampled", "sent", "sampled to sent"),
    "transport_out": ("sent", "applied", "sent to applied, with the wait for the device's tick"),
    "whole": ("sampled", "applied", "sampled to applied"),
}
LATENESS = "lateness"
COUNTED = (
    "late",
    "skipped",
    "lost",
    "stale",
    "duplicated",
    "reordered",
    "overruns",
    "unsent",
    "rows_dropped",
)
LOWEST_NS, HIGHEST_NS, EDGES_A_DECADE = 100, 10**10, 10
EDGES_NS = np.rint(LOWEST_NS * 10.0 ** (np.arange(8 * EDGES_A_DECADE + 1) / EDGES_A_DECADE)).astype(np.int64)
QUANTILES = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999}
CONFIDENCE = 0.975  # of each bound of a quantile by itself
WORST = 10
WRAP_NS = (1 << 32) * 125 // 2  # the u32 of a STATE counts units of 62.5 ns
SEQUENCES = 1 << 16
NO_AGE = 0xFFFF  # no COMMAND yet, or an age beyond the counter

_Ints = NDArray[np.int64]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Ledger:
    """Times of each tick (ns, host clock; 0 where unknown), and counts that the rows give.

    Attributes
    ----------
    tick, sample_index
        Numbers of step and sample.
    sampled, received, computed, sent, applied
        See the module's text; sampled and applied are 0 without a clock fit.
    lateness, late
        Receipt behind the grid (ns), and whether the loop counted it as late.
    passed_over
        Samples that the law did not see.
    never_active
        Commands that no STATE named though a later one became active; among them those that were overtaken.
    within_tick
        Commands sent after the sample from which they count, so that the time of sending stands as applied.
    unanswered
        Commands behind the last one known active: the recording ends before the device could report.
    period_ns
        Length of a device tick.
    clock
        The fit, or None.
    clock_sd_ns
        Standard uncertainty of sampled and applied at worst in this recording, without what asymmetry may add.
    loop
        Where the law ran: "host" or "device".
    execution_ns
        Worst execution time of a device tick, as the device counted it; None where the law ran on the host.
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
    passed_over: int
    never_active: int
    unanswered: int
    within_tick: int
    period_ns: float
    clock: ClockFit | None
    clock_sd_ns: float | None
    loop: str = "host"
    execution_ns: int | None = None

    def stage(self, name: str) -> tuple[_Ints, _Mask]:
        """Length of a stage in each tick (ns) and whether it is known; `LATENESS` is one of them."""
        if name == LATENESS:
            return self.lateness, np.ones(len(self.lateness), bool)
        begin, end = (getattr(self, side) for side in STAGES[name][:2])
        return end - begin, (begin != 0) & (end != 0)


@dataclass(frozen=True, slots=True)
class Stage:
    """Durations of one stage over all ticks in which it is known (ns).

    `counts` belongs to the edges of the summary: below the first, between each two, from the last on. `negative` counts
    ticks in which the end seems to come before the begin. Bounds of the quantiles take ticks as independent, which
    lateness in bursts is not.
    """

    ticks: int
    minimum: int
    quantiles: dict[str, Quantile]
    maximum: int
    negative: int
    counts: list[int]


@dataclass(frozen=True, slots=True)
class BadTick:
    """One of the worst ticks: seconds from the first receipt, and its stages (ns), None where unknown."""

    tick: int
    sample_index: int
    time_s: float
    stages: dict[str, int | None]


@dataclass(frozen=True, slots=True)
class TimingSummary:
    """Timing of a recording.

    Attributes
    ----------
    ticks, duration_s, period_ns
        Steps of the law, time from the first to the last receipt, length of a device tick.
    stages
        By name (`STAGES`, `LATENESS`); None where no tick is known.
    edges_ns
        Of the histograms.
    worst
        Ticks with the longest whole way, or, where that is unknown, the latest; worst first.
    counts
        Late, skipped, lost, stale and so on, separately; None where the trailer has no counters.
    never_active, unanswered, passed_over, within_tick
        As in `Ledger`.
    clock
        The fit, or None.
    clock_sd_ns, loop, execution_ns
        As in `Ledger`.
    """

    ticks: int
    duration_s: float
    period_ns: float
    stages: dict[str, Stage | None]
    edges_ns: list[int]
    worst: list[BadTick]
    counts: dict[str, int | None]
    never_active: int
    unanswered: int
    passed_over: int
    within_tick: int
    clock: ClockFit | None
    clock_sd_ns: float | None
    loop: str = "host"
    execution_ns: int | None = None

    def as_mapping(self) -> dict[str, Any]:
        """Return plain values, for JSON and for a recording's trailer."""
        return asdict(self)


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
    shown_at, never, unanswered = _unanswered(rows) if on_device else _active(rows)
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
        early = (
            known & (applied < sent) & (sent - applied <= period_ns + doubt_ns)
        )  # else the clocks are wrong: show it
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
    """Device times of rows on the scale of the clock exchanges (ns).

    A STATE has 32 bits of the device's clock, so rows count from a multiple of 268 s that they do not know; the first
    receipt says which.
    """
    wraps = round((int(fit.device_of(np.array([near_host_ns]))[0]) - int(device_time[0])) / WRAP_NS)
    return device_time + wraps * WRAP_NS


def summarise(ledger: Ledger, counters: Mapping[str, int] | None) -> TimingSummary:
    """Add up a ledger; `counters` are the loop's, as a recording's trailer has them, or None when there are none."""
    counts = {name: (counters or {}).get(name) for name in COUNTED}
    if counts["late"] is None:
        counts["late"] = int(np.count_nonzero(ledger.late))
    received = ledger.received
    duration_ns = int(received[-1] - received[0]) if len(received) else 0
    return TimingSummary(
        ticks=len(ledger.tick),
        duration_s=duration_ns * 1e-9,
        period_ns=ledger.period_ns,
        stages={name: _summary(*ledger.stage(name)) for name in (*STAGES, LATENESS)},
        edges_ns=EDGES_NS.tolist(),
        worst=_worst(ledger),
        counts=counts,
        never_active=ledger.never_active,
        unanswered=ledger.unanswered,
        passed_over=ledger.passed_over,
        within_tick=ledger.within_tick,
        clock=ledger.clock,
        clock_sd_ns=ledger.clock_sd_ns,
        loop=ledger.loop,
        execution_ns=ledger.execution_ns,
    )


def _column(rows: NDArray[np.void], name: str) -> _Ints:
    return np.ascontiguousarray(rows[name], np.int64)


def _unanswered(rows: NDArray[np.void]) -> tuple[_Ints, int, int]:
    """As `_active` where the law ran on the device: there is no command for a sample, and so none that failed."""
    return np.full(len(rows), -1, np.int64), 0, 0


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
    """Device time of sample k − a: of its row, or where that is missing, counted back from the row of sample k."""
    age = rows["command_age"][shown_at]
    index = _column(rows, "sample_index")
    wanted = index[shown_at] - age
    place = np.minimum(np.searchsorted(index, wanted), len(index) - 1)
    counted = device[shown_at] - np.rint(age * period_ns).astype(np.int64)
    return np.where(index[place] == wanted, device[place], counted)


def _summary(values: _Ints, known: _Mask) -> Stage | None:
    found = np.sort(values[known])
    if not len(found):
        return None
    inner = np.searchsorted(found, EDGES_NS)
    return Stage(
        ticks=len(found),
        minimum=int(found[0]),
        quantiles={name: quantile(found, share, CONFIDENCE) for name, share in QUANTILES.items()},
        maximum=int(found[-1]),
        negative=int(np.searchsorted(found, 0)),
        counts=np.diff(inner, prepend=0, append=len(found)).tolist(),
    )


def _badness(ledger: Ledger) -> tuple[_Ints, _Mask]:
    """From sample to command, and what the device then waited beyond its next tick; without a clock, lateness (ns)."""
    answered, known = ledger.stage("answered")
    if not known.any():
        return ledger.stage(LATENESS)
    whole, applied = ledger.stage("whole")
    ticks = np.where(applied, np.rint(whole / ledger.period_ns), 0.0)
    return answered + np.rint(np.maximum(ticks - 1.0, 0.0) * ledger.period_ns).astype(np.int64), known


def _worst(ledger: Ledger) -> list[BadTick]:
    """Worst first; of equal ones the earlier. Ticks without any delay are not bad."""
    values, known = _badness(ledger)
    candidates = np.flatnonzero(known & (values > 0))
    if len(candidates) > WORST:  # only what can be among the worst is sorted
        least = np.partition(values[candidates], -WORST)[-WORST]
        candidates = candidates[values[candidates] >= least]
    chosen = candidates[np.argsort(-values[candidates], kind="stable")[:WORST]]
    lengths = {name: ledger.stage(name) for name in (*STAGES, LATENESS)}
    return [
        BadTick(
            tick=int(ledger.tick[i]),
            sample_index=int(ledger.sample_index[i]),
            time_s=int(ledger.received[i] - ledger.received[0]) * 1e-9,
            stages={name: int(length[i]) if known[i] else None for name, (length, known) in lengths.items()},
        )
        for i in chosen
    ]
