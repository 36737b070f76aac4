"""Which walls a measured link supports: the largest stable stiffness at some dampings and rates, in every hand.

The rates: the device's highest, what the link carries, what it allows with one tick of delay, and the experiment's. At
each the delay in ticks follows from the measured link, and the stiffness from linear theory
(`rig.doctor.late_loops`), uniform and dual-rate, with the experiment's estimator.
"""

from __future__ import annotations

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

DIVIDER = 10  # position samples for one of velocity, where the experiment is uniform
LOWEST_HZ, HIGHEST_HZ = 100, 200_000

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Rate:
    """A rate (Hz) that is looked at, and what names it."""

    hertz: int
    because: str


@dataclass(frozen=True, slots=True)
class Largest:
    """At one damping: by hand, the largest stable stiffness."""

    damping: float
    by_hand: Mapping[str, float]

    @property
    def least(self) -> tuple[str, float]:
        """Hand in which it is smallest, and its value there."""
        hand = min(self.by_hand, key=lambda name: self.by_hand[name])
        return hand, self.by_hand[hand]


@dataclass(frozen=True, slots=True, kw_only=True)
class Supported:
    """One row: the stable walls under one scheme.

    Attributes
    ----------
    because
        Why this rate.
    scheme, label
        Text form, and its name in a table.
    position_rate, velocity_rate
        Of the scheme (Hz).
    delay_ticks
        That the link gives at this rate.
    k_max
        At each damping.
    reason
        Why there is nothing, or what stands in for the estimator; else empty.
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
    """Return the table for people, with the reasons below it."""
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
    """Return the rates worth looking at, the slowest first, each once."""
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
    """Return the dampings that are looked at: none, the experiment's, and twice that."""
    own = experiment.wall.damping
    return (0.0, own, 2.0 * own) if own > 0.0 else (0.0,)


def supported_walls(
    experiment: Experiment,
    measurement: LinkMeasurement,
    rate_maximum: int,
    progress: Progress | None = None,
) -> list[Supported]:
    """Compute the table.

    Parameters
    ----------
    experiment
        Rig, wall and estimator.
    measurement
        Of the link.
    rate_maximum
        Of the device (Hz).
    progress
        Called with the share that is done.
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
    """Return the uniform scheme at this rate, and the dual-rate one with about the experiment's ratio."""
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
    """Round a rate down to two digits, so that it can be divided."""
    if hertz < 100.0:
        return int(hertz)
    scale = int(10.0 ** (math.floor(math.log10(hertz)) - 1))
    return int(hertz // scale) * scale
