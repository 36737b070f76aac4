"""Fit the host's clock against the device's clock: a line through exchanges of four time stamps, with its uncertainty.

An exchange is host_sent → device_received → device_sent → host_received. Its offset, host clock − device clock, is the
mean of host_sent − device_received and host_received − device_sent. Its round trip is (host_received − host_sent) −
(device_sent − device_received). The offset is wrong by half the difference of the transit times in the two directions,
which is at most half of the round trip. So exchanges with a short round trip have more weight. Each trial has its fit.

References: D. L. Mills, RFC 5905 (minimum filter); P. K. Sen, J. Am. Stat. Assoc. 63 (1968) 1379 (median slope); R. T.
Birge, Phys. Rev. 40 (1932) 207 (uncertainties from the residuals).

Devices, trials, the timing of recordings and the export to Lab Streaming Layer call it. It must not read a clock or
exchange anything itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import RecordingError, RigError
from rig.core.present import Row, duration

EXCHANGE = np.dtype(
    [(name, "<i8") for name in ("host_sent", "device_received", "device_sent", "host_received")]
)

# Two units of the device's clock (1/16 µs): each stamp of a difference is cut to a unit.
STAMP_NS = 125
LAST_NS = 1 << 59  # sums and differences of stamps below this stay within 64 bits
# Half a unit: stamps are cut to units, not rounded, a bias that no averaging removes.
CUT_NS = 31.25
DRIFT_PRIOR_PPM = 100.0  # two ordinary crystals
IMPOSSIBLE_PPM = 10_000.0  # the worst oscillator of a microcontroller is an RC one, 1 %
SHARE_PRIOR = 0.29  # standard deviation of a share that lies evenly in −½ … ½
SLOW = 10.0  # an exchange with a larger excess, in medians of all, is rejected
OFF_LINE = 6.0  # an exchange farther from a line, in uncertainties, is rejected
STRETCHES = 64  # intervals of time of which the robust line uses the fastest exchange each
ROUNDS = 5  # fits at most, each without the exchanges that the fit before rejected
# Times the median of magnitudes: the standard deviation of a normal distribution.
NORMAL_SD = 1.4826
# Two exchanges closer than this fraction of the whole time can have any slope.
FAR_APART = 0.25
# Factor on the weight of the drift's prior, for a fit that shows a drift far beyond it.
NEARLY_NO_PRIOR = 1e-8

_NO_EXCHANGE = np.array((0, 0, -1, 0), EXCHANGE)  # the device's clock ran backwards: never possible

_Floats = NDArray[np.float64]
_Ints = NDArray[np.int64]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ClockFit:
    """Host clock as a linear function of device clock: host = device + offset + drift · (device − reference).

    Attributes
    ----------
    reference_ns
        Device time at which the errors of offset and drift are independent of each other.
    offset_ns
        Host clock minus device clock at the reference.
    drift_ppm
        Rate at which host clock minus device clock grows; negative when the device's clock runs fast.
    offset_sd_ns, drift_sd_ppm
        Standard uncertainties, without the error by different transit times in the two directions.
    asymmetry_bound_ns
        Largest error of the offset by different transit times in the two directions: half of the least round trip.
    round_trip_ns
        Least round trip without the time on the device.
    share
        Part of a round trip's excess delay that occurs on the way to the device, minus ½: −½ if only the way back
        waits.
    residual_rms_ns
        Weighted rms distance of the exchanges from the fit.
    span_ns
        Device time from the first to the last used exchange.
    used, rejected
        Numbers of used and of rejected exchanges.
    """

    reference_ns: int
    offset_ns: int
    drift_ppm: float
    offset_sd_ns: float
    drift_sd_ppm: float
    asymmetry_bound_ns: int
    round_trip_ns: int
    share: float
    residual_rms_ns: float
    span_ns: int
    used: int
    rejected: int

    def host_of(self, device_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert times of the device clock (ns) to the host clock (ns), rounded to whole nanoseconds."""
        # Whole numbers, and floats for the small drift part alone: 2^53 ns, the last exact float, are 104 days.
        since: _Ints = np.asarray(device_ns, np.int64) - self.reference_ns
        return since + (self.reference_ns + self.offset_ns) + _round(since, self.drift_ppm * 1e-6)

    def device_of(self, host_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert times of the host clock (ns) to the device clock (ns): the inverse of `host_of` within 1 ns."""
        since: _Ints = np.asarray(host_ns, np.int64) - (self.reference_ns + self.offset_ns)
        drift = self.drift_ppm * 1e-6
        return since + self.reference_ns - _round(since, drift / (1.0 + drift))

    def sd_of(self, device_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the standard uncertainty (ns) of the host time for each device time (ns), least at `reference_ns`.

        An error by different transit times in the two directions is not included (`asymmetry_bound_ns`).
        """
        since = np.asarray(device_ns, np.int64) - self.reference_ns
        # Independent uncertainties add in squares.
        return np.asarray(np.hypot(self.offset_sd_ns, since * (self.drift_sd_ppm * 1e-6)), np.float64)

    def rows(self) -> list[Row]:
        """Return offset, drift and round trip of the clocks with their uncertainties, as rows to print."""
        asymmetry_note = (
            f"and at most {duration(self.asymmetry_bound_ns)} if the two directions take different times"
        )
        offset = f"{self.offset_ns * 1e-9:.9f} s ± {duration(self.offset_sd_ns)}"
        return [
            Row("clock offset", offset, note=asymmetry_note),
            Row("clock drift", f"{self.drift_ppm:.2f} ± {self.drift_sd_ppm:.2g} ppm"),
            Row("round trip", f"{duration(self.round_trip_ns)} at least"),
            Row("exchanges", self.used, note=f"over {duration(self.span_ns)}, {self.rejected} rejected"),
        ]

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> ClockFit:
        """Return the clock fit from the dictionary that a recording contains (`rig.core.present.plain`).

        Raise `RecordingError` if a value is missing, not a number, or out of the range of a clock. Further keys are
        ignored.
        """
        try:
            kinds = {"int": int, "float": float}
            found = cls(**{f.name: kinds[str(f.type)](mapping[f.name]) for f in fields(cls)})
            for f in fields(cls):
                if not abs(getattr(found, f.name)) < 1 << 62:  # sums of two fit 64 bits
                    raise ValueError(f"{f.name} is not between -2^62 and 2^62")
            return found
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise RecordingError(
                f"the clock fit in the recording is invalid ({error!r})",
                remedy="read the recording with the version of haptic-rig that wrote it",
            ) from error


def as_exchanges(stamps: Iterable[Sequence[int]]) -> NDArray[np.void]:
    """Return clock exchanges as an array of dtype `EXCHANGE`, from lists of four time stamps each (ns)."""
    return np.array([tuple(int(stamp) for stamp in four) for four in stamps], EXCHANGE)


def fit_clock(exchanges: NDArray[np.void], *, drift_prior_ppm: float = DRIFT_PRIOR_PPM) -> ClockFit:
    """Fit a line to host clock minus device clock over device time, from exchanges of four time stamps.

    Exchanges with a long round trip have less weight or are rejected.

    Parameters
    ----------
    exchanges
        Exchanges (dtype `EXCHANGE`) in any order; the device's stamps in ns, extended to 64 bits.
    drift_prior_ppm
        Standard deviation of the drift before any measurement (ppm).

    Raises
    ------
    RigError
        No exchange can be used, or the clocks' rates differ by far more than crystals can (`IMPOSSIBLE_PPM`).
    """
    usable = exchanges[_find_possible(exchanges)]
    if not len(usable):
        raise RigError(
            f"none of {len(exchanges)} clock exchanges with the device has possible time stamps",
            remedy="check that the link works, then measure again; if the device's time stamps run "
            "backwards, report a fault of the firmware",
        )
    points = _Points.of(usable)
    keep = _not_slow(points, np.ones(len(usable), bool))
    # A robust line first, because stamps of two different exchanges, or a clock that was set, would bend a fit.
    keep &= _near_line(points, keep, *_median_line(points, keep))
    line = _fit(points, keep, drift_prior_ppm)
    if line.least_drift_ppm > IMPOSSIBLE_PPM:
        raise RigError(
            f"the rates of the device's clock and this computer's clock differ by {line.least_drift_ppm * 1e-4:.2g} %",
            remedy="simulated board: end other programs, this computer is too busy to simulate it; real "
            "board: its firmware states a wrong unit of time, report it",
        )
    for _ in range(ROUNDS):
        allowed = OFF_LINE * line.scale * _sigma(points, keep)
        nearer = _not_slow(points, keep) & (np.abs(line.residuals(points)) <= allowed)
        if (nearer == keep).all() or not nearer.any():
            break
        keep = nearer
        line = _fit(points, keep, drift_prior_ppm)
    return _to_clock_fit(points, keep, line, len(exchanges))


def fit_if_possible(exchanges: NDArray[np.void]) -> ClockFit | None:
    """Return the fit of host clock against device clock; None if no exchange of time stamps is usable."""
    try:
        return fit_clock(exchanges)
    except RigError:
        return None


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """Clock exchanges as arrays: device time, host time (s), offset host − device, round trip (ns).

    Times and offset count from their own origins (ns): floating point needs small numbers.
    """

    time_origin: int
    offset_origin: int
    time: _Floats
    host_time: _Floats
    offset: _Floats
    trip: _Ints

    @classmethod
    def of(cls, exchanges: NDArray[np.void]) -> _Points:
        out = exchanges["host_sent"] - exchanges["device_received"]
        back = exchanges["host_received"] - exchanges["device_sent"]
        middle = exchanges["device_received"] + (exchanges["device_sent"] - exchanges["device_received"]) // 2
        time_origin, offset_origin = int(middle[len(exchanges) // 2]), int(out[len(exchanges) // 2])
        # Differences of whole numbers first: only they are small enough for floating point.
        doubled = (out - offset_origin) + (back - offset_origin)
        host_time = (exchanges["host_sent"] - exchanges["host_sent"].min()) * 1e-9
        time = (middle - time_origin) * 1e-9
        return cls(time_origin, offset_origin, time, host_time, doubled * 0.5, back - out)

    def excess(self, keep: _Mask) -> _Floats:
        return np.asarray(np.maximum(self.trip - self.trip[keep].min(), 0), np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _ClockLine:
    """Fitted line of clock offset (ns), drift (ns/s) and share of the excess delay (`values`), with their covariance.

    `scale` is the factor by which large residuals widened the uncertainties, `least_drift_ppm` a lower bound of the
    drift's magnitude that does not depend on its prior.
    """

    values: _Floats
    covariance: _Floats
    scale: float
    rms: float
    least_trip: int
    least_drift_ppm: float

    def residuals(self, points: _Points) -> _Floats:
        excess = np.maximum(points.trip - self.least_trip, 0)
        offset, drift, share = self.values
        return np.asarray(points.offset - (offset + drift * points.time + share * excess), np.float64)


# Impossible is an exchange within which a clock ran backwards, whose round trip is shorter than the stamps can resolve,
# or with an invalid stamp (negative, or more than 18 years).
def _find_possible(exchanges: NDArray[np.void]) -> _Mask:
    stamps = np.stack([exchanges[name] for name in EXCHANGE.names or ()])
    exchanges = np.where(((stamps >= 0) & (stamps < LAST_NS)).all(axis=0), exchanges, _NO_EXCHANGE)
    on_device = exchanges["device_sent"] - exchanges["device_received"]
    away = exchanges["host_received"] - exchanges["host_sent"]
    return np.asarray((on_device >= 0) & (away >= 0) & (away - on_device >= -STAMP_NS), bool)


def _not_slow(points: _Points, keep: _Mask) -> _Mask:
    excess = points.excess(keep)
    return np.asarray(keep & (excess <= SLOW * max(float(np.median(excess[keep])), STAMP_NS)), bool)


def _sigma(points: _Points, keep: _Mask) -> _Floats:
    """Return the standard uncertainty (ns) of each clock exchange's offset, which grows with its round trip."""
    # The offset is uncertain by half the excess (round trip minus the least round trip), and by half of the time that
    # the fastest exchange may itself have waited: this is taken as the excess of the √n-th fastest of n exchanges, or
    # as 1/n of the least round trip if that is more.
    excess = points.excess(keep)
    fast = np.sort(excess[keep])
    number = len(fast)
    unseen = max(fast[min(number - 1, int(np.sqrt(number)))], points.trip[keep].min() / number, STAMP_NS)
    return np.asarray(np.hypot(0.5 * float(unseen), 0.5 * excess), np.float64)


def _median_line(points: _Points, keep: _Mask) -> tuple[float, float]:
    """Return height (ns) and slope (ns/s) of a robust line of offset over host time, by medians.

    Only the fastest exchange in each interval of time is used.
    """
    # Of the host's time: the device's stamps are not checked yet, and may belong to two exchanges.
    chosen = np.flatnonzero(keep)
    time = points.host_time[chosen]
    span = np.ptp(time)
    if span == 0.0:
        return float(np.median(points.offset[chosen])), 0.0
    stretch = np.minimum(((time - time.min()) * (STRETCHES / span)).astype(np.int64), STRETCHES - 1)
    order = np.lexsort((points.trip[chosen], stretch))
    first = np.diff(stretch[order], prepend=-1) > 0
    fastest = chosen[order[first]]
    time, offset = points.host_time[fastest], points.offset[fastest]
    rise, run = offset[:, None] - offset, time[:, None] - time
    # Of both orders of a pair only the one with positive run.
    far = run > FAR_APART * span
    slope = float(np.median(rise[far] / run[far])) if far.any() else 0.0
    return float(np.median(offset - slope * time)), slope


def _near_line(points: _Points, keep: _Mask, height: float, slope: float) -> _Mask:
    """Return a mask of the clock exchanges near a line over host time, with `height` in ns and `slope` in ns/s.

    Near is `OFF_LINE` times the uncertainty, which is widened if the median residual is larger than it.
    """
    pull = np.abs(points.offset - height - slope * points.host_time) / _sigma(points, keep)
    scale = max(1.0, NORMAL_SD * float(np.median(pull[keep])))
    near = keep & (pull <= OFF_LINE * scale)
    return near if near.any() else keep


# The offset is a line in device time plus a share of the excess: ± ½ if all delay is in one direction, with a prior of
# 0 ± 0.29 (uniform within ± ½). The drift has a prior of 0 ± 100 ppm: after one exchange, or several at nearly the same
# time, it is still 0 ± 100 ppm; after exchanges over a second the measurement dominates.
def _fit(points: _Points, keep: _Mask, drift_prior_ppm: float) -> _ClockLine:
    time, offset = points.time[keep], points.offset[keep]
    weight = _sigma(points, keep)[keep] ** -2
    # Time from its weighted centre: offset and drift are then nearly independent, and the matrix well conditioned.
    centre = np.sum(weight * time) / np.sum(weight)
    columns = np.stack([np.ones_like(time), time - centre, points.excess(keep)[keep]])
    prior = np.array([0.0, (drift_prior_ppm * 1e3) ** -2, SHARE_PRIOR**-2])  # a ppm is 1000 ns/s
    normal = (columns * weight) @ columns.T
    right = (columns * weight) @ offset
    # Almost without the prior of the drift: one far beyond it must not look like a fault of the exchanges.
    free = prior * np.array([0.0, NEARLY_NO_PRIOR, 1.0])
    unbound, spread = _solve(normal, free, 1.0, right)
    residuals = offset - unbound @ columns
    chi2 = float(np.sum(weight * residuals**2))
    scale = 1.0
    if len(time) > len(prior):
        scale = max(1.0, np.sqrt(chi2 / (len(time) - len(prior))))
    values, covariance = _solve(normal, prior, scale, right)
    back = np.array([[1.0, -centre, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])  # from the centre to the origin
    rms = float(np.sqrt(chi2 / np.sum(weight)))
    least_drift = max(0.0, abs(float(unbound[1])) - OFF_LINE * scale * float(np.sqrt(spread[1, 1])))
    least_trip = int(points.trip[keep].min())
    return _ClockLine(back @ values, back @ covariance @ back.T, scale, rms, least_trip, least_drift * 1e-3)


def _solve(normal: _Floats, prior: _Floats, scale: float, right: _Floats) -> tuple[_Floats, _Floats]:
    matrix = normal / scale**2 + np.diag(prior)
    unit = 1.0 / np.sqrt(np.diag(matrix))
    covariance = np.linalg.inv(matrix * np.outer(unit, unit)) * np.outer(unit, unit)
    return covariance @ right / scale**2, covariance


def _to_clock_fit(points: _Points, keep: _Mask, line: _ClockLine, total: int) -> ClockFit:
    offset, drift, share = line.values
    var, cross, var_drift = line.covariance[0, 0], line.covariance[0, 1], line.covariance[1, 1]
    reference_s = -cross / var_drift  # there offset and drift are independent
    reference = round(reference_s * 1e9)
    time = points.time[keep]
    least = max(0, line.least_trip)
    return ClockFit(
        reference_ns=points.time_origin + reference,
        offset_ns=points.offset_origin + round(float(offset + drift * reference * 1e-9)),
        drift_ppm=float(drift) * 1e-3,
        offset_sd_ns=float(np.sqrt(max(0.0, var - cross**2 / var_drift) + CUT_NS**2)),
        drift_sd_ppm=float(np.sqrt(var_drift)) * 1e-3,
        # The two directions may differ: a bound beside the standard uncertainties, not a part of them.
        asymmetry_bound_ns=-(-least // 2),
        round_trip_ns=least,
        share=float(share),
        residual_rms_ns=line.rms,
        span_ns=round(float(np.ptp(time)) * 1e9),
        used=int(np.count_nonzero(keep)),
        rejected=total - int(np.count_nonzero(keep)),
    )


def _round(times: _Ints, factor: float) -> _Ints:
    return np.asarray(np.rint(times * factor), np.int64)
