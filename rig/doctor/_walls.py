"""Compute the largest stable stiffness over a measured link, for several loop rates, dampings and modelled hands.

The loop rates are the experiment's rate, the device's highest rate, the highest rate that the link's capacity permits,
and the highest rate with one tick of delay. Linear theory (`rig.doctor.late_loops`) with the measured delay gives the
stiffness, for a uniform and a dual-rate scheme with the experiment's velocity estimator.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.core.operators import hand_text
from rig.core.present import Item, Table
from rig.core.sample import unit_of
from rig.devices.device import LINK_SHARE, STATE_BYTES
from rig.doctor._round_trip import LinkMeasurement
from rig.doctor.late_loops import LateLoops, loop_delay_ticks

# Position samples for each velocity sample in the dual-rate scheme, if the experiment's scheme is uniform.
DIVIDER = 10
LOWEST_HZ, HIGHEST_HZ = 100, 200_000

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Rate:
    """A loop rate (Hz) at which `rig doctor` lists stable walls, and why: ``the device's maximum``, for example."""

    hertz: int
    because: str


@dataclass(frozen=True, slots=True)
class Largest:
    """Largest stable stiffness (N/m or N·m/rad) with each modelled hand, at one damping (N·s/m or N·m·s/rad)."""

    damping: float
    by_hand: Mapping[str, float]

    @property
    def least(self) -> tuple[str, float]:
        """Return the modelled hand with the smallest stable stiffness, and this stiffness (N/m or N·m/rad)."""
        hand = min(self.by_hand, key=lambda name: self.by_hand[name])
        return hand, self.by_hand[hand]


@dataclass(frozen=True, slots=True, kw_only=True)
class Supported:
    """One row of the table of stable walls: a scheme (position and velocity rate) with its largest stable stiffnesses.

    Attributes
    ----------
    because
        Reason why the rate is in the table, such as ``the device's maximum``.
    scheme, label
        Text form of the scheme, and its name in the table.
    position_rate, velocity_rate
        Rates of the scheme (Hz).
    delay_ticks
        Delay from a sample to its command at this rate with the measured link (ticks of the position rate).
    k_max
        Largest stable stiffness at each damping; empty if theory does not cover the scheme.
    reason
        Reason why `k_max` is empty, or a note that a nonlinear estimator was replaced; empty text otherwise.
    """

    because: str
    scheme: str
    label: str
    position_rate: int
    velocity_rate: int
    delay_ticks: int
    k_max: tuple[Largest, ...]
    reason: str = ""


def wall_items(experiment: Experiment, rows: Sequence[Supported]) -> list[Item]:
    """Return the table of stable walls for printing, and the reasons why theory does not cover some of its rows."""
    motion = experiment.rig.motion
    dampings = dampings_of(experiment)
    units = unit_of("stiffness", motion), unit_of("damping", motion)
    table = Table(
        ["scheme", "rate is", "delay (ticks)", *(f"B = {b:g}" for b in dampings)],
        [[row.label, row.because, row.delay_ticks, *_cells(row, len(dampings))] for row in rows],
        f"walls: largest stable K ({units[0]}) in the hand where it is smallest, by damping B ({units[1]})",
        words=2,
    )
    return [table, *(f"  {reason}" for reason in dict.fromkeys(row.reason for row in rows if row.reason))]


def _cells(row: Supported, columns: int) -> list[str]:
    found = [largest.least for largest in row.k_max]
    return [f"{value:.4g} ({hand_text(hand)})" for hand, value in found] or ["–"] * columns


def candidate_rates(experiment: Experiment, measurement: LinkMeasurement, rate_maximum: int) -> list[Rate]:
    """Return the loop rates at which to compute stable walls, ascending; `rate_maximum` (Hz) is that of the device."""
    found = [Rate(experiment.controller.position_rate, "the experiment's")]
    fastest, on_the_device = rate_maximum, experiment.controller.loop == "device"
    if measurement.capacity_bytes_per_s is not None and not on_the_device:
        carried = int(LINK_SHARE * measurement.capacity_bytes_per_s // STATE_BYTES)
        if carried < rate_maximum:
            found.append(Rate(_round(carried), "the link's capacity"))
            fastest = carried
    if fastest == rate_maximum:
        found.append(Rate(rate_maximum, "the device's maximum"))
    if measurement.loop_rate_hz < fastest and not on_the_device:
        found.append(Rate(_round(measurement.loop_rate_hz), "one tick of delay"))
    names: dict[int, str] = {}
    for rate in found:
        if LOWEST_HZ <= rate.hertz <= min(HIGHEST_HZ, fastest):
            names[rate.hertz] = (
                f"{names[rate.hertz]}, {rate.because}" if rate.hertz in names else rate.because
            )
    return [Rate(hertz, names[hertz]) for hertz in sorted(names)]


def dampings_of(experiment: Experiment) -> tuple[float, ...]:
    """Return the dampings at which to compute stable walls (SI): 0, the experiment's, and twice the experiment's."""
    own = experiment.wall.damping
    return (0.0, own, 2.0 * own) if own > 0.0 else (0.0,)


def supported_walls(
    experiment: Experiment,
    measurement: LinkMeasurement,
    rate_maximum: int,
    progress: Progress | None = None,
) -> list[Supported]:
    """Compute the largest stable stiffnesses over a measured link: for each loop rate a uniform and a dual-rate scheme.

    Parameters
    ----------
    experiment
        Experiment with the rig, the wall and the estimator.
    measurement
        Measurement of the link.
    rate_maximum
        Highest rate of the device (Hz).
    progress
        Function that receives the completed share of the computation (0 to 1).
    """
    rates = candidate_rates(experiment, measurement, rate_maximum)
    wanted = [(rate, scheme) for rate in rates for scheme in _schemes(experiment, rate.hertz)]
    rows: list[Supported] = []
    for rate, scheme in wanted:
        if progress is not None:
            progress(len(rows) / len(wanted))
        delay = loop_delay_ticks(experiment, measurement, rate.hertz)
        rows.append(_row(experiment, scheme, rate.because, delay))
    if progress is not None:
        progress(1.0)
    return rows


def _schemes(experiment: Experiment, rate: int) -> list[Scheme]:
    """Return at position rate `rate` (Hz) a uniform sampling scheme, and one with a lower, dividing velocity rate."""
    controller = experiment.controller
    asked = controller.position_rate // controller.velocity_rate
    asked = asked if asked > 1 else DIVIDER
    uniform = Scheme(position_rate=rate, velocity_rate=rate)
    divider = next((n for n in range(asked, 1, -1) if rate % n == 0 and rate // n >= 10), 1)
    dual = Scheme(position_rate=rate, velocity_rate=rate // divider)
    return [uniform] if divider == 1 else [uniform, dual]


def _row(experiment: Experiment, scheme: Scheme, because: str, delay: int) -> Supported:
    dampings = dampings_of(experiment)
    label, reason = scheme.text, ""
    k_max: tuple[Largest, ...] = ()
    try:
        label = scheme.label(experiment)
        loops = LateLoops.of(scheme.applied(experiment), delay)
        reason = loops.stand_in
        k_max = tuple(map(Largest, dampings, loops.k_max(dampings)))
    except ConfigError as error:
        reason = error.message
    return Supported(
        because=because,
        scheme=scheme.text,
        label=label,
        position_rate=scheme.position_rate,
        velocity_rate=scheme.velocity_rate,
        delay_ticks=delay,
        k_max=k_max,
        reason=reason,
    )


def _round(hertz: float) -> int:
    """Return a rate (Hz) rounded down to two significant digits, so that the rate has many integer divisors."""
    if hertz < 100.0:
        return int(hertz)
    scale = int(10.0 ** (math.floor(math.log10(hertz)) - 1))
    return int(hertz // scale) * scale
