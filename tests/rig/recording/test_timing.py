"""The latency ledger against a small model of two clocks and a lossy link; quantiles with their confidence bounds."""

import json
import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special, stats

from rig.core.clock_fit import ClockFit
from rig.core.present import plain
from rig.core.sample import ROW, RowFlag
from rig.recording._timing_summary import WORST, summarise
from rig.recording.quantiles import (
    CONFIDENCE,
    Distribution,
    Quantile,
    quantile,
    share_bounded_by_largest,
    values_needed,
)
from rig.recording.timing import LATENESS, NO_AGE, STAGES, WRAP_NS, device_times, ledger

PERIOD_NS = 500_000


def clock(*, offset_ns: int = 0, drift_ppm: float = 0.0, reference_ns: int = 0) -> Any:
    return ClockFit(reference_ns, offset_ns, drift_ppm, 10.0, 0.01, 1_000, 2_000, 0.0, 5.0, 10**9, 50, 1)


class Session:
    """A model of device and host, event by event: the rows, and the true times (host clock).

    Sample k is taken at `at(k)` of the device's clock. A STATE takes some time, and so does the answer after the law.
    From sample k on the device uses the newest COMMAND that came before sample k + 1, but not before it was sent.
    """

    def __init__(
        self, fit: Any, *, ticks: Any, seed: Any = 0, first_sequence: Any = 0, lost: Any = (), eaten: Any = (),
        spread: Any = 1.0,
    ) -> None:  # fmt: skip
        self.fit, self.rng = fit, np.random.default_rng(seed)
        self.rows, self.sampled, self.applied = [], [], []
        active, came_at = None, 0  # active command, sample from which it is
        commands = []  # (comes at device time, number of its row)
        free_ns = 0
        for k in range(1000, 1000 + ticks):
            now = self.at(k)
            for arrival, row in [c for c in commands if c[0] < now]:
                # The last sample before it came: the command acts from there on.
                index = k - 1 - max(0, math.ceil((now - arrival) / PERIOD_NS) - 1)
                active, came_at = row, index
                if self.applied[row] == 0:
                    on_grid = int(fit.host_of(np.array([self.at(index)]))[0])
                    self.applied[row] = max(on_grid, int(self.rows[row]["sent_at"]))
            commands = [c for c in commands if c[0] >= now]
            if k - 1000 in lost:
                continue
            sampled = int(fit.host_of(np.array([now]))[0])
            received = max(sampled + self.wait(80_000 * spread), free_ns)
            computed = received + self.wait(5_000)
            sent = computed + self.wait(9_000)
            free_ns = sent
            number = len(self.rows)
            row = np.zeros(1, ROW)[0]
            row["tick"], row["sample_index"], row["device_time"] = number, k, now
            row["elapsed_ticks"] = 1
            row["received_at"], row["computed_at"], row["sent_at"] = received, computed, sent
            row["command_sequence"] = (first_sequence + number) % 65536
            row["command_age"] = NO_AGE if active is None else min(k - came_at, NO_AGE)
            row["command_active"] = 0 if active is None else (first_sequence + active) % 65536
            row["lateness"] = received - sampled
            self.rows.append(row)
            self.sampled.append(sampled)
            self.applied.append(0)
            if number not in eaten:
                arrival = int(fit.device_of(np.array([sent + self.wait(60_000 * spread)]))[0])
                commands.append((arrival, number))
        self.rows = np.array(self.rows, ROW) if self.rows else np.zeros(0, ROW)

    @staticmethod
    def at(k: Any) -> Any:
        return k * PERIOD_NS

    def wait(self, mean_ns: Any) -> Any:
        return int(self.rng.exponential(mean_ns)) + 1_000

    def seen(self) -> Any:
        """Return for each row if some later row shows its command as active, by comparing every pair."""
        sequence, active, age = (
            self.rows[name].tolist() for name in ("command_sequence", "command_active", "command_age")
        )
        return [
            any(
                active[j] == sequence[i] and age[j] < NO_AGE
                for j in range(i + 1, min(len(sequence), i + 30_000))
            )
            for i in range(len(sequence))
        ]


@settings(max_examples=12)
@given(
    offset_ns=st.integers(0, 10**17),  # a host's clock is never negative
    drift_ppm=st.floats(-200.0, 200.0, allow_subnormal=False),
    first_sequence=st.integers(0, 65535),
    lost=st.sets(st.integers(1, 99), max_size=20),
    eaten=st.sets(st.integers(0, 99), max_size=20),
    spread=st.sampled_from([0.1, 1.0, 5.0]),
    seed=st.integers(0, 2**32),
)
def test_every_time_is_the_true_one(
    offset_ns: int, drift_ppm: float, first_sequence: int, lost: Any, eaten: Any, spread: Any, seed: int
) -> None:
    """The model loses samples and commands, waits longer than a period, and wraps its sequences."""
    fit = clock(offset_ns=offset_ns, drift_ppm=drift_ppm, reference_ns=1000 * PERIOD_NS)
    session = Session(
        fit, ticks=100, seed=seed, first_sequence=first_sequence, lost=lost, eaten=eaten, spread=spread
    )
    found = ledger(session.rows, fit, PERIOD_NS)
    seen = np.array(session.seen())
    assert found.sampled.tolist() == session.sampled
    assert ((found.applied != 0) == seen).all()
    truth = np.array(session.applied)
    # A STATE that was lost between can only be counted back on the device's grid; here the grid is exact.
    assert (found.applied[seen] == truth[seen]).all()
    last = np.flatnonzero(seen)[-1] if seen.any() else -1
    assert found.never_active == (~seen[: last + 1]).sum()
    assert found.unanswered == (~seen[last + 1 :]).sum()
    for name, (begin, end, _) in STAGES.items():
        lengths, known = found.stage(name)
        assert (known == ((getattr(found, begin) != 0) & (getattr(found, end) != 0))).all()
        assert (lengths[known] == (getattr(found, end) - getattr(found, begin))[known]).all()


def test_in_lock_step_a_command_is_active_at_the_sample_that_it_answers() -> None:
    """In virtual time sampling, receiving, sending and applying coincide; no sample shows the last answer."""
    rows = np.zeros(5, ROW)
    rows["sample_index"] = np.arange(1, 6)
    rows["elapsed_ticks"] = 1
    for name in ("device_time", "received_at", "computed_at", "sent_at"):
        rows[name] = np.arange(1, 6) * PERIOD_NS
    rows["command_sequence"] = np.arange(5)
    rows["command_active"] = [0, 0, 1, 2, 3]
    rows["command_age"] = [NO_AGE, 1, 1, 1, 1]
    found = ledger(rows, clock(), PERIOD_NS)
    assert found.applied.tolist() == [*rows["sent_at"][:4], 0]
    assert (found.never_active, found.unanswered) == (0, 1)
    summary = summarise(found, None)
    assert summary.stages["whole"].maximum == 0
    assert summary.worst == [], "nothing is bad about no delay"


@pytest.mark.parametrize(
    ("sent_ns", "applied_ns", "within"), [(1_700, 1_700, 1), (1_000, 1_000, 0), (20_000, 1_000, 0)]
)
def test_no_command_is_active_before_it_was_sent(sent_ns: int, applied_ns: int, within: int) -> None:
    """Within a tick the device reports no finer time; a command active ticks before it was sent means wrong clocks."""
    rows = np.zeros(2, ROW)
    rows["sample_index"] = [1, 2]
    rows["device_time"] = rows["received_at"] = [1_000, 2_000]
    rows["sent_at"] = [sent_ns, 0]
    rows["command_sequence"] = [0, 1]
    rows["command_age"] = [NO_AGE, 1]
    found = ledger(rows, replace(clock(), asymmetry_bound_ns=0, offset_sd_ns=0.0), 1_000.0)
    assert found.applied[0] == applied_ns
    assert found.within_tick == within


def test_active_command_of_another_run_is_ignored() -> None:
    """Its sequence is more than half a wrap behind, or it belongs to an earlier session."""
    rows = np.zeros(3, ROW)
    rows["sample_index"] = rows["received_at"] = rows["device_time"] = np.arange(1, 4)
    rows["command_sequence"] = [0, 1, 2]
    rows["command_active"] = [40, 30_000, 3]
    rows["command_age"] = 1
    assert not ledger(rows, clock(), PERIOD_NS).applied.any()


def test_without_a_fit_only_the_host_is_known() -> None:
    session = Session(clock(offset_ns=10**12), ticks=20)
    found = ledger(session.rows, None, PERIOD_NS)
    assert not found.sampled.any()
    assert not found.applied.any()
    summary = summarise(found, {"late": 3})
    assert summary.stages["transport_in"] is summary.stages["whole"] is None
    assert summary.stages["law"].ticks == 20
    assert summary.clock is None
    assert summary.clock_sd_ns is None
    late = found.lateness.argmax()
    assert summary.worst[0].tick == late
    assert summary.worst[0].stages["whole"] is None


@pytest.mark.parametrize("wraps", [0, 1, 1000])
def test_a_device_that_has_been_up_for_long_is_put_on_its_own_scale(wraps: int) -> None:
    """A STATE has 32 bits of the device's clock, an exchange 64, so rows lack a multiple of 268 s."""
    fit = clock(offset_ns=5 * 10**9, drift_ppm=80.0)
    up = wraps * WRAP_NS
    times = np.array([1_000, 2_000_000, 3 * 10**9], np.int64)
    near = int(fit.host_of(np.array([up + 1_000 + 40_000_000]))[0])
    assert (device_times(times, fit, near) == times + up).all()


def test_no_rows_are_no_error() -> None:
    found = ledger(np.zeros(0, ROW), clock(), PERIOD_NS)
    summary = summarise(found, None)
    assert (summary.ticks, summary.duration_s, summary.worst) == (0, 0.0, [])
    assert set(summary.stages.values()) == {None}


def stage_of(values: Any) -> Any:
    rows = np.zeros(len(values), ROW)
    rows["lateness"] = values
    rows["received_at"] = np.arange(len(values)) + 1
    return summarise(ledger(rows, None, PERIOD_NS), None)


@given(st.lists(st.integers(-(10**7), 2 * 10**10), min_size=1, max_size=300))
def test_quantiles_and_histogram_count_what_is_there(values: list[int]) -> None:
    summary = stage_of(values)
    stage = summary.stages[LATENESS]
    array = np.array(values)
    assert (stage.minimum, stage.maximum, stage.ticks) == (min(values), max(values), len(values))
    assert stage.negative == (array < 0).sum()
    for name, share in (("p50", 0.5), ("p99", 0.99), ("p99_9", 0.999)):
        found = stage.quantiles[name]
        assert found.value == np.quantile(array, share, method="inverted_cdf")
        assert found.low is None or found.low <= found.value
        assert found.high is None or found.high >= found.value
    edges = [-math.inf, *summary.edges_ns, math.inf]
    inside = [sum(low <= v < high for v in values) for low, high in pairwise(edges)]
    assert stage.counts == inside


def test_the_worst_ticks_come_first_with_their_stages() -> None:
    session = Session(clock(offset_ns=10**12), ticks=200, seed=3)
    found = ledger(session.rows, clock(offset_ns=10**12), PERIOD_NS)
    summary = summarise(found, None)
    whole, known = found.stage("whole")
    late = np.where(known, np.maximum(np.rint(whole / PERIOD_NS) - 1, 0), 0) * PERIOD_NS
    answered = found.stage("answered")[0] + late
    assert [answered[bad.tick] for bad in summary.worst] == sorted(answered, reverse=True)[:WORST]
    for bad in summary.worst:
        parts = [bad.stages[name] for name in ("transport_in", "law", "send", "transport_out")]
        assert sum(parts) == bad.stages["whole"]
        assert session.rows["sample_index"][bad.tick] == bad.sample_index


def test_each_count_is_reported_separately() -> None:
    session = Session(clock(offset_ns=10**12), ticks=50)
    session.rows["flags"][[3, 7]] = int(RowFlag.LATE | RowFlag.GAP)
    session.rows["elapsed_ticks"][7] = 4
    found = ledger(session.rows, None, PERIOD_NS)
    named = {"late": 5, "skipped": 1, "lost": 3, "stale": 4, "duplicated": 6, "reordered": 2, "overruns": 9}
    summary = summarise(found, {**named, "frames": 50})
    assert {name: summary.counts[name] for name in named} == named
    assert summary.counts["rows_dropped"] is None
    assert summary.passed_over == 3
    alone = summarise(found, None)
    assert alone.counts["late"] == 2, "the rows say it where the loop could not"
    assert alone.counts["stale"] is None


def test_law_on_the_device_has_no_command_stages() -> None:
    """The loop receives batches of 20 samples, and no command answers a sample."""
    fit, rows, number = clock(offset_ns=5_000_000), np.zeros(200, ROW), np.arange(200)
    rows["tick"], rows["sample_index"], rows["elapsed_ticks"] = number, 700 + number, 1
    rows["device_time"] = (700 + number) * PERIOD_NS
    rows["received_at"] = fit.host_of(rows["device_time"][number // 20 * 20 + 19]) + 30_000
    rows["command_sequence"], rows["command_active"], rows["command_age"] = 7, 6, number % 100
    rows["execution_time"] = np.where(number < 50, 2_000, 3_000)
    summary = summarise(ledger(rows, fit, PERIOD_NS, "device"), {"late": 0})
    assert summary.loop == "device"
    assert summary.execution_ns == 3_000
    for name in ("law", "send", "answered", "transport_out", "whole"):
        assert summary.stages[name] is None
    arrived = summary.stages["transport_in"]
    assert (arrived.ticks, arrived.minimum, arrived.maximum) == (200, 30_000, 30_000 + 19 * PERIOD_NS)
    assert (summary.never_active, summary.unanswered, summary.within_tick) == (0, 0, 0)
    assert json.loads(json.dumps(plain(summary)))["loop"] == "device"


@pytest.mark.parametrize("confidence", [CONFIDENCE, 0.975])
@pytest.mark.parametrize("share", [0.5, 0.9, 0.99, 0.999])
@pytest.mark.parametrize("number", [1, 2, 5, 20, 58, 59, 298, 299, 1000, 2994, 2995, 5000])
def test_bounds_are_order_statistics_by_the_binomial(number: int, share: float, confidence: float) -> None:
    """Rank r is an upper bound if fewer than r values are below it with enough confidence; summed here as an oracle."""
    n = np.arange(number + 1)
    chance = (
        special.comb(number, n) * share**n * (1.0 - share) ** (number - n)
        if number < 60
        else stats.binom.pmf(n, number, share)
    )
    below = np.cumsum(chance)  # below[r]: no more than r values lie below the quantile
    found = quantile(np.arange(1, number + 1), share, confidence)  # the value is its own rank
    upper = [r for r in range(1, number + 1) if below[r - 1] >= confidence]
    lower = [r for r in range(1, number + 1) if 1.0 - below[r - 1] >= confidence]
    assert found == Quantile(
        value=math.ceil(round(share * number, 9)),
        low=lower[-1] if lower else None,
        high=upper[0] if upper else None,
    )
    assert isinstance(found.value, int)


def test_a_bound_of_p999_needs_2995_values() -> None:
    needed = values_needed(0.999)
    assert needed == 2995
    assert quantile(np.arange(needed - 1.0), 0.999).high is None
    assert quantile(np.arange(float(needed)), 0.999).high == needed - 1.0


@given(st.integers(1, 100_000))
def test_the_largest_value_bounds_a_quantile_just_so(number: int) -> None:
    share = share_bounded_by_largest(number)
    assert 1.0 - share**number == pytest.approx(CONFIDENCE)
    few = Distribution.of(np.arange(number % 3000 + 1.0))
    assert few.almost_all == (few.maximum if few.p999.high is None else few.p999.high)
