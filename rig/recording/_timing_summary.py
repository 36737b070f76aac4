"""Summary of the latencies of a recording: duration of each stage, the worst ticks, and the loop's counters.

The trailer of a recording stores it and `rig recording timing` shows it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from rig.core.present import Item, Row, Table, duration
from rig.recording.quantiles import Quantile, quantile
from rig.recording.timing import LATENESS, STAGES, Ledger, TimingFacts

COUNTED = {
    "late": "late by more than a period",
    "skipped": "samples skipped for a newer one",
    "lost": "samples lost",
    "stale": "ticks without a fresh sample",
    "duplicated": "samples received twice",
    "reordered": "samples out of order",
    "overruns": "grid points overrun",
    "unsent": "commands that the link did not take",
    "rows_dropped": "rows not recorded",
}
LOWEST_NS, EDGES_A_DECADE = 100, 10
EDGES_NS = np.rint(LOWEST_NS * 10.0 ** (np.arange(8 * EDGES_A_DECADE + 1) / EDGES_A_DECADE)).astype(np.int64)
QUANTILES = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999}
CONFIDENCE = 0.975  # of each bound of a quantile by itself
WORST = 10
_OF_A_TICK = {"transport_in": "in", "law": "law", "send": "send", "transport_out": "out", "whole": "whole"}

_Ints = NDArray[np.int64]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Stage:
    """Statistics of one latency, such as from sample to receipt, over all ticks in which it is known (ns).

    `counts` is a histogram over `TimingSummary.edges_ns`: number of ticks below the first edge, between each two edges,
    and from the last edge on. `negative` counts ticks in which the end seems to precede the begin. The bounds of the
    quantiles assume independent ticks; the bounds are too tight if late ticks come in bursts.
    """

    ticks: int
    minimum: int
    quantiles: dict[str, Quantile]
    maximum: int
    negative: int
    counts: list[int]


@dataclass(frozen=True, slots=True)
class BadTick:
    """One of the worst ticks: time since the first received sample (s), length of each stage (ns; None if unknown)."""

    tick: int
    sample_index: int
    time_s: float
    stages: dict[str, int | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingSummary(TimingFacts):
    """Summary of the timing of a recording.

    Attributes
    ----------
    ticks, duration_s
        Number of control ticks, and time from the first to the last receipt of a sample (s).
    stages
        Statistics of each latency by its name, such as "transport_in"; None if it is known in no tick.
    edges_ns
        Edges of the histograms (ns).
    worst
        Ticks with the longest delay from sample to command and its effect, the worst first; without a clock fit, the
        latest ticks.
    counts
        Number of ticks, samples or commands of each kind, such as "late"; None if the loop stored no counters.
    """

    ticks: int
    duration_s: float
    stages: dict[str, Stage | None]
    edges_ns: list[int]
    worst: list[BadTick]
    counts: dict[str, int | None]

    def items(self) -> list[Item]:
        """Return tables and lines with the durations of all stages and the counters, to print."""
        head = ("stage", "ticks", "least", "p50", "p99", "p99.9", "longest")
        found: list[Item] = [
            f"{self.ticks} ticks in {self.duration_s:.4g} s, one every {duration(self.period_ns)}",
            Table(head, self._stage_rows()),
        ]
        if self.loop == "device":
            worst = duration(self.execution_ns) if self.execution_ns else None
            effort = Row(
                "from a sample to its effort", "within the device's own tick: no command answers a sample"
            )
            found += ["law on the device", effort, Row("worst execution time of a tick", worst)]
        found += ["counted apart", *self._count_rows(), "clock", *self._clock_rows()]
        if self.worst:
            found.append(self._worst_table())
        return found

    def _stage_rows(self) -> list[tuple[str, ...]]:
        rows: list[tuple[str, ...]] = []
        for name, stage in self.stages.items():
            if stage is None:
                if self.loop == "host":
                    rows.append((label(name), "0", "", "unknown", "", "", ""))
                continue
            least, most = duration(stage.minimum), duration(stage.maximum)
            rows.append((label(name), str(stage.ticks), least, *map(_shown, stage.quantiles.values()), most))
        return rows

    def _count_rows(self) -> list[Row]:
        counts = [(text, self.counts[name]) for name, text in COUNTED.items()]
        counts.append(("samples that the law did not use", self.passed_over))
        if self.loop == "host":
            counts.append(("commands never reported as active", self.never_active))
            counts.append(("commands sent at the end, without a report", self.unanswered))
        return [Row(text, "not recorded" if count is None else count) for text, count in counts]

    def _clock_rows(self) -> list[Row]:
        if self.clock is None or self.clock_sd_ns is None:
            text = (
                "no clock exchanges are recorded (an interrupted run stores none): the times sampled "
                "and applied are unknown"
            )
            return [Row("none", text)]
        rows = [*self.clock.rows(), Row("sampled, applied", f"± {duration(self.clock_sd_ns)} at worst")]
        if self.within_tick:
            text = "commands arrived within the tick in which they were sent; counted as applied at once"
            rows.append(Row("", f"{self.within_tick} {text}"))
        out = self.stages["transport_out"]
        if out is not None and out.negative:
            text = "commands appear applied before they were sent: the device was late by its own clock"
            rows.append(Row("", f"{out.negative} {text}"))
        return rows

    def _worst_table(self) -> Table:
        names = {**_OF_A_TICK, LATENESS: "late"}
        rows = []
        for bad in self.worst:
            lengths = (bad.stages[name] for name in names)
            shown = ("?" if length is None else duration(length) for length in lengths)
            rows.append((str(bad.tick), f"{bad.time_s:.4f} s", *shown))
        return Table(("tick", "at", *names.values()), rows, "worst ticks")


def label(name: str) -> str:
    """Return the printed name of a latency, like ``sampled to received``, with a further cause of delay if any."""
    if name == LATENESS:
        return "late on the grid of the samples"
    return ", ".join(filter(None, (STAGES[name].label, STAGES[name].with_)))


def _shown(quantile: Quantile) -> str:
    text = duration(quantile.value)
    if quantile.high is None or quantile.high == quantile.value:
        return text
    return f"{text} (≤ {duration(quantile.high)})"


def summarise(ledger: Ledger, counters: Mapping[str, int] | None) -> TimingSummary:
    """Return the summary of the times at which each tick was sampled, received, computed, sent and applied.

    `counters` are the loop's counters from the recording's trailer, or None without a trailer.
    """
    counts = {name: (counters or {}).get(name) for name in COUNTED}
    if counts["late"] is None:
        counts["late"] = int(np.count_nonzero(ledger.late))
    received = ledger.received
    duration_ns = int(received[-1] - received[0]) if len(received) else 0
    return TimingSummary(
        **{field.name: getattr(ledger, field.name) for field in fields(TimingFacts)},
        ticks=len(ledger.tick),
        duration_s=duration_ns * 1e-9,
        stages={name: _summary(*ledger.stage(name)) for name in (*STAGES, LATENESS)},
        edges_ns=EDGES_NS.tolist(),
        worst=_worst(ledger),
        counts=counts,
    )


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
    """Return how bad each tick is (ns), and a mask that is True where this is known.

    It is the time from the sample to the sent command, plus the delay of the command's effect beyond one device tick;
    without a clock fit, how late the sample was received.
    """
    answered, known = ledger.stage("answered")
    if not known.any():
        return ledger.stage(LATENESS)
    whole, applied = ledger.stage("whole")
    ticks = np.where(applied, np.rint(whole / ledger.period_ns), 0.0)
    return answered + np.rint(np.maximum(ticks - 1.0, 0.0) * ledger.period_ns).astype(np.int64), known


def _worst(ledger: Ledger) -> list[BadTick]:
    """Return at most `WORST` ticks, the worst first, of equal ticks the earlier first; omit ticks without delay."""
    values, known = _badness(ledger)
    candidates = np.flatnonzero(known & (values > 0))
    # Sort only ticks that can be among the worst: a recording may have millions of ticks.
    if len(candidates) > WORST:
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
