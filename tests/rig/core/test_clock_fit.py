"""The fitted line between two clocks against simulated truth: drift, jitter, bursts, asymmetry, false stamps."""

import json
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.core.clock_fit import EXCHANGE, STAMP_NS, ClockFit, as_exchanges, fit_clock, fit_if_possible
from rig.core.errors import RigError
from rig.core.present import plain
from tests.conformance.tiers import first_by_default

UP_NS = 3 * 10**14  # the device has been up for three days and a half
SECOND = 10**9


class World:
    """Two clocks and a link: device = (host − start)·(1 + ppm) + up, exact in whole numbers."""

    def __init__(
        self, ppm: float = 0.0, *, start_ns: Any = 77 * 10**12, up_ns: Any = UP_NS, seed: int = 0
    ) -> None:
        rate = 1 + Fraction(ppm).limit_denominator(10**6) / 10**6
        self.over, self.under = rate.numerator, rate.denominator
        self.start_ns, self.up_ns = start_ns, up_ns
        self.rng = np.random.default_rng(seed)

    @property
    def drift_ppm(self) -> Any:
        """Return the drift of host − device over device time."""
        return (self.under - self.over) * 10**6 / self.over

    def device(self, host_ns: Any) -> Any:
        """Return the device's stamp: ns in units of 62.5, truncated."""
        exact = (host_ns - self.start_ns) * self.over + self.up_ns * self.under
        return exact * 2 // (self.under * 125) * 125 // 2

    def host(self, device_ns: Any) -> Any:
        """Return the true host times of device times (ns), from the origin of the session."""
        return [(int(d) - self.up_ns) * self.under / self.over for d in device_ns]

    def error_ns(self, fit: Any, device_ns: Any) -> Any:
        return (fit.host_of(device_ns) - self.start_ns) - np.array(self.host(device_ns))

    def exchanges(
        self,
        count: Any,
        span_s: Any,
        *,
        ways_ns: tuple[int, ...] = (40_000, 60_000),
        jitter_ns: tuple[float, ...] = (20_000.0, 20_000.0),
        burst: float = 0.0,
    ) -> Any:
        """Return exchanges at random times; in a row of share `burst`, one way waits 2 ms more on average."""
        rng = self.rng
        sent = self.start_ns + np.sort(rng.integers(0, round(span_s * SECOND) + 1, count))
        ways = [
            way + rng.exponential(1.0, count) * jitter for way, jitter in zip(ways_ns, jitter_ns, strict=True)
        ]
        struck = round(burst * count)
        first = int(rng.integers(0, count - struck + 1))
        ways[int(rng.integers(2))][first : first + struck] += rng.exponential(2e6, struck)
        made = np.zeros(count, EXCHANGE)
        for row, at, out, back in zip(made, sent, *ways, strict=True):
            came = int(at) + round(out)
            left = came + int(rng.integers(5_000, 20_000))
            row["host_sent"], row["device_received"] = at, self.device(came)
            row["device_sent"], row["host_received"] = self.device(left), left + round(back)
        return made


def ends_of(exchanges: Any) -> Any:
    return exchanges["device_received"][[0, len(exchanges) // 2, -1]]


# ---------------------------------------------------------------------- against the truth


@settings(max_examples=30, deadline=None)
@given(
    ppm=st.floats(-200.0, 200.0, allow_subnormal=False),
    count=st.integers(3, 120),
    span_s=st.floats(0.2, 3600.0),
    ways=st.tuples(st.integers(0, 200_000), st.integers(0, 200_000)),
    jitter=st.tuples(
        st.floats(0.0, 100_000.0, allow_subnormal=False), st.floats(0.0, 100_000.0, allow_subnormal=False)
    ),
    burst=st.sampled_from([0.0, 0.0, 0.2, 0.4]),
    seed=st.integers(0, 2**32),
)
def test_the_truth_lies_within_three_sigma_and_the_bound(
    ppm: float, count: int, span_s: float, ways: Any, jitter: Any, burst: Any, seed: int
) -> None:
    world = World(ppm, seed=seed)
    exchanges = world.exchanges(count, span_s, ways_ns=ways, jitter_ns=jitter, burst=burst)
    fit = fit_clock(exchanges)
    at = ends_of(exchanges)
    # Five sigma here: hypothesis looks for the worst of many. How often three suffice is counted below.
    assert (np.abs(world.error_ns(fit, at)) <= 5.0 * fit.sd_of(at) + fit.asymmetry_bound_ns).all()
    assert fit.used + fit.rejected == count
    # Single fits may use less than half: without a burst the median excess falls, and slow exchanges leave, too.
    assert fit.used >= 1


@pytest.mark.parametrize(
    "link",
    first_by_default(
        [
            {"burst": 0.4},
            {},
            {"jitter_ns": (0.0, 50_000.0)},
            {"jitter_ns": (50_000.0, 0.0), "ways_ns": (500, 500)},
            {"jitter_ns": (20_000.0, 20_000.0), "ways_ns": (300_000, 10_000)},
            {"jitter_ns": (0.0, 0.0)},
        ]
    ),
    ids=["bursts", "both-ways-wait", "back-waits", "out-waits-on-a-fast-link", "asymmetric", "quiet"],
)
@pytest.mark.parametrize(("count", "span_s"), [(10, 1.0), (60, 6.0)])
def test_three_sigma_cover_the_truth(link: Any, count: int, span_s: float) -> None:
    """Over 100 seeds, offsets at start, middle and end, and the drift, are covered at least 97 times each."""
    seeds = 100
    covered = drifts = used = 0
    for seed in range(seeds):
        world = World(float(np.random.default_rng(seed).normal(0.0, 60.0)), seed=seed)
        exchanges = world.exchanges(count, span_s, **link)
        fit = fit_clock(exchanges)
        at = ends_of(exchanges)
        covered += (np.abs(world.error_ns(fit, at)) <= 3.0 * fit.sd_of(at) + fit.asymmetry_bound_ns).all()
        drifts += abs(fit.drift_ppm - world.drift_ppm) <= 3.0 * fit.drift_sd_ppm
        used += fit.used
    assert used >= 0.5 * seeds * count, "of all exchanges half"
    assert covered >= 0.97 * seeds
    assert drifts >= 0.97 * seeds


def test_uncertainties_are_of_use() -> None:
    """They must be small too: 150 exchanges in 15 s with 20 µs of jitter give a microsecond and 0.5 ppm."""
    world = World(-87.5)
    fit = fit_clock(world.exchanges(150, 15.0))
    assert fit.offset_sd_ns < 3_000
    assert fit.drift_sd_ppm < 0.5
    assert fit.drift_ppm == pytest.approx(world.drift_ppm, abs=0.5)
    assert fit.asymmetry_bound_ns == pytest.approx(50_000, rel=0.2)
    assert fit.round_trip_ns == pytest.approx(100_000, rel=0.2)


def test_ways_that_differ_shift_the_offset_by_half_the_difference_and_the_bound_says_so() -> None:
    world = World(20.0)
    exchanges = world.exchanges(200, 20.0, ways_ns=(10_000, 90_000), jitter_ns=(0.0, 0.0))
    fit = fit_clock(exchanges)
    assert world.error_ns(fit, ends_of(exchanges)) == pytest.approx(40_000, abs=200)
    assert fit.asymmetry_bound_ns == pytest.approx(50_000, abs=200)
    assert fit.drift_ppm == pytest.approx(world.drift_ppm, abs=0.01), "a constant difference is no drift"


@pytest.mark.parametrize(("jitter", "share"), [((0.0, 5e4), 0.5), ((5e4, 0.0), -0.5), ((5e4, 5e4), 0.0)])
def test_waiting_on_one_way_alone_is_seen_and_taken_out(jitter: tuple[float, ...], share: float) -> None:
    """The excess of a round trip shows the error; uncorrected, the offset would err by half the mean wait."""
    world = World(0.0)
    exchanges = world.exchanges(300, 10.0, ways_ns=(1_000, 1_000), jitter_ns=jitter)
    fit = fit_clock(exchanges)
    assert fit.share == pytest.approx(share, abs=0.1)
    assert np.abs(world.error_ns(fit, ends_of(exchanges))).max() < 3_000


# ---------------------------------------------------------------------- little to go by


def test_one_exchange_leaves_the_drift_to_the_prior() -> None:
    world = World(73.0)
    fit = fit_clock(world.exchanges(1, 0.0))
    assert (fit.drift_ppm, fit.drift_sd_ppm) == (0.0, pytest.approx(100.0))
    assert (fit.used, fit.span_ns) == (1, 0)
    later = np.array([fit.reference_ns + 10 * SECOND])
    assert fit.sd_of(later)[0] == pytest.approx(1e6, rel=0.01), "100 ppm of ten seconds are a millisecond"
    assert abs(world.error_ns(fit, later)[0]) < 3 * 1e6
    narrow = fit_clock(world.exchanges(1, 0.0), drift_prior_ppm=2.0)
    assert narrow.drift_sd_ppm == pytest.approx(2.0)


def test_exchanges_without_a_usable_one_are_an_error() -> None:
    with pytest.raises(RigError, match="none of 0 clock exchanges"):
        fit_clock(np.zeros(0, EXCHANGE))
    backwards = as_exchanges([(100, 50, 40, 200), (100, 50, 60, 90), (0, 0, 10_000, 100)])
    with pytest.raises(RigError, match="none of 3"):
        fit_clock(backwards)


# ---------------------------------------------------------------------- the outlier rule


def test_impossible_exchanges_are_rejected() -> None:
    """Examples: a clock that runs backwards, a negative reply time; truncated stamps may be two units short."""
    world = World(0.0)
    good = world.exchanges(20, 2.0, ways_ns=(1_000, 1_000), jitter_ns=(0.0, 0.0))
    bad = good[:3].copy()
    bad["device_sent"][0] = bad["device_received"][0] - 63
    bad["host_received"][1] = bad["host_sent"][1] - 1
    bad["device_sent"][2] = (
        bad["device_received"][2] + (bad["host_received"] - bad["host_sent"])[2] + STAMP_NS + 1
    )
    fit = fit_clock(np.concatenate([good, bad]))
    assert (fit.used, fit.rejected) == (20, 3)
    instant = good[:1].copy()
    instant["host_received"] = instant["host_sent"]
    instant["device_sent"] = instant["device_received"] + STAMP_NS
    assert fit_clock(instant).round_trip_ns == 0


def test_slow_exchanges_are_rejected_from_ten_times_the_median_excess_on() -> None:
    world = World(0.0)
    good = world.exchanges(99, 10.0)
    excess = (good["host_received"] - good["host_sent"]) - (good["device_sent"] - good["device_received"])
    excess -= excess.min()
    slow = good[:1].copy()
    before = fit_clock(good)
    for factor, rejected in ((8.0, 0), (13.0, 1)):
        added = slow.copy()
        added["host_received"] += round(factor * np.median(excess)) - excess[0]
        assert fit_clock(np.concatenate([good, added])).rejected - before.rejected == rejected


@settings(max_examples=20, deadline=None)
@given(
    bad=st.integers(1, 12),
    shift=st.one_of(st.integers(10**6, 10**12), st.integers(-(10**12), -(10**6)), st.just(268_435_456_000)),
    seed=st.integers(0, 2**32),
)
def test_stamps_that_do_not_belong_together_are_rejected(bad: int, shift: Any, seed: int) -> None:
    """Up to a fifth of fast round trips have stamps off by a millisecond or by a wrap of the device's clock."""
    world = World(35.0, seed=seed)
    exchanges = world.exchanges(60, 6.0)
    lies = world.rng.choice(60, bad, replace=False)
    exchanges["device_received"][lies] += shift
    exchanges["device_sent"][lies] += shift
    fit = fit_clock(exchanges)
    honest = np.delete(exchanges, lies)
    assert fit.rejected >= bad
    assert fit.used >= 60 - bad - 10
    at = ends_of(honest)
    assert (np.abs(world.error_ns(fit, at)) <= 5.0 * fit.sd_of(at) + fit.asymmetry_bound_ns).all()


ANY = st.integers(-(2**63), 2**63 - 1)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.one_of(
            st.tuples(ANY, ANY, ANY, ANY),
            *(st.tuples(*[st.integers(0, most)] * 4) for most in (1_000, 10**12, 2**60)),
        ),
        max_size=20,
    )
)
def test_any_stamps_give_a_fit_of_finite_numbers_or_an_error(stamps: Any) -> None:
    """Whatever a device sends: no other exception, no warning, and `fit_if_possible` returns None instead."""
    exchanges = as_exchanges(stamps)
    try:
        fit = fit_clock(exchanges)
    except RigError:
        assert fit_if_possible(exchanges) is None
        return
    assert np.isfinite(list(plain(fit).values())).all()
    assert fit_if_possible(exchanges) == fit
    assert len(fit.device_of(fit.host_of(np.array([0, 10**12])))) == 2


def test_a_wrong_unit_of_time_is_refused() -> None:
    exchanges = World().exchanges(20, 2.0)
    for name in EXCHANGE.names[1:3]:
        exchanges[name] = exchanges[name] // 16 * 10
    with pytest.raises(RigError, match="wrong unit of time"):
        fit_clock(exchanges)


# ---------------------------------------------------------------------- arithmetic

FITS = st.builds(
    ClockFit,
    reference_ns=st.integers(0, 10**17),
    offset_ns=st.integers(-(10**18), 10**18),
    drift_ppm=st.floats(-200.0, 200.0, allow_subnormal=False),
    offset_sd_ns=st.floats(0.0, 1e6, allow_subnormal=False),
    drift_sd_ppm=st.floats(0.0, 100.0, allow_subnormal=False),
    asymmetry_bound_ns=st.integers(0, 10**6),
    round_trip_ns=st.integers(0, 10**6),
    share=st.floats(-0.5, 0.5, allow_subnormal=False),
    residual_rms_ns=st.floats(0.0, 1e6, allow_subnormal=False),
    span_ns=st.integers(0, 10**14),
    used=st.integers(1, 10_000),
    rejected=st.integers(0, 10_000),
)


@given(fit=FITS, since=st.lists(st.integers(-(10**15), 10**15), min_size=1, max_size=20))
def test_no_nanosecond_is_lost_in_eleven_days(fit: Any, since: list[int]) -> None:
    """Compare with exact fractions; converting there and back is exact to a nanosecond."""
    device = np.array([fit.reference_ns + s for s in since], np.int64)
    host = fit.host_of(device)
    for d, h in zip(device.tolist(), host.tolist(), strict=True):
        exact = d + fit.offset_ns + Fraction(fit.drift_ppm) / 10**6 * (d - fit.reference_ns)
        assert abs(h - exact) <= Fraction(51, 100)
    assert np.abs(fit.device_of(host) - device).max() <= 1


@given(fit=FITS, start=st.integers(-(10**14), 10**14), steps=st.lists(st.integers(0, 10**7), max_size=50))
def test_later_on_one_clock_is_never_earlier_on_the_other(fit: Any, start: int, steps: list[int]) -> None:
    times = (
        fit.reference_ns
        + start
        + np.concatenate([[0], np.cumsum(np.array(steps, np.int64))]).astype(np.int64)
    )
    assert (np.diff(fit.host_of(times)) >= 0).all()
    assert (np.diff(fit.device_of(times)) >= 0).all()


@given(fit=FITS)
def test_a_fit_survives_json(fit: Any) -> None:
    assert ClockFit.from_mapping(json.loads(json.dumps({"kind": "monotonic", **plain(fit)}))) == fit


@pytest.mark.parametrize("broken", [{}, {"reference_ns": "yesterday"}, {"drift_ppm": None}])
def test_a_mapping_that_is_no_fit_is_refused(broken: Any) -> None:
    mapping = {} if not broken else {**plain(fit_clock(World().exchanges(5, 1.0))), **broken}
    with pytest.raises(RigError, match="clock fit in the recording is invalid"):
        ClockFit.from_mapping(mapping)
