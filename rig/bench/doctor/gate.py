"""The arming gate: whether a wall may be rendered on a device, as its link was measured.

Refused is, on a real device,

* a way there and back that in 99.9 % of all cases takes more than half of a command's lifetime: the device would drop
  the wall in the middle of a touch, again and again;
* more questions lost than `LOST_SHARE`;
* a wall that linear theory finds unstable at the loop's rate with the delay that was measured, in no hand or in any of
  those that may hold it (`rig.bench.doctor.late_loops`: the spectral radius over one velocity period is 1 or more).

A law that the device runs itself answers within the tick: what delays it is the device's own execution time, which is
less than a tick or the device says so (missed ticks), and the amplifier's input, such as the period of a pulse width.
Its wall is judged without delay, and what a whole tick would make of it is said. The link only has to bring a word
within the lifetime of that loop, which is longer.

Linear theory leaves out Coulomb friction, which holds walls that it calls unstable; the gate does not count on it. That
the wall is passive is not asked, but said. A simulated device is never refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

from rig.analysis.theory import k_max, passivity_bound
from rig.analysis.theory.loop import NO_OPERATOR
from rig.bench.doctor.late_loops import LateLoops, loop_delay_ticks
from rig.bench.doctor.round_trip import ENOUGH, LinkMeasurement, Progress, measure_link
from rig.config import Experiment
from rig.config.controller import command_lifetime_s, supervise_lifetime_s
from rig.config.sections import Host
from rig.core.errors import ConfigError, PlanError
from rig.core.sample import unit_of
from rig.devices.framed import FramedDevice
from rig.realtime.scheduling import obtained

LIFETIME_SHARE = 0.5  # of a command's lifetime that the way there and back may take
LOST_SHARE = 0.001  # of the questions: a loop loses one command in a thousand and does not notice
SHORTEST_S, LONGEST_S = 1.0, 4.0  # of a measurement before arming; as long as bounding p99.9 takes
SIMULATED_S = 0.5  # on a simulated device, which is told and never refused


@dataclass(frozen=True, slots=True)
class Reason:
    """Why a wall must not be armed, and what can be done about it."""

    text: str
    remedy: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate:
    """What the gate found.

    Attributes
    ----------
    armable
        Whether nothing speaks against it.
    reasons
        Everything that does.
    notes
        What is worth knowing beside: what is not computed or stands in, what homing and passivity say.
    rate_hz, delay_ticks
        Rate of the loop, and the delay that the link gives it.
    travel_s
        Upper bound of the way there and back in 99.9 % of all cases, or the longest seen (s).
    lifetime_s
        Of a command (s).
    loss_share
        Share of questions that were lost.
    stiffness, damping
        The wall.
    spectral_radius
        By hand; empty where nothing is computed.
    k_max
        By hand: the largest stable stiffness at this damping and delay.
    passive_stiffness
        The largest one that is passive there, or None.
    simulated, forced
        The device is a simulated one; the user arms anyway. Neither is refused.
    """

    armable: bool
    reasons: tuple[Reason, ...]
    notes: tuple[str, ...]
    rate_hz: float
    delay_ticks: int
    travel_s: float
    lifetime_s: float
    loss_share: float
    stiffness: float
    damping: float
    spectral_radius: Mapping[str, float]
    k_max: Mapping[str, float]
    passive_stiffness: float | None
    simulated: bool
    forced: bool = False

    @property
    def remedy(self) -> str:
        """What to do, all of it."""
        return "; ".join(dict.fromkeys(reason.remedy for reason in self.reasons))

    @property
    def text(self) -> str:
        """All reasons."""
        return "; ".join(reason.text for reason in self.reasons)

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON and for the header of a recording."""
        return asdict(self) | {"spectral_radius": dict(self.spectral_radius), "k_max": dict(self.k_max)}


def gate(experiment: Experiment, measurement: LinkMeasurement) -> Gate:
    """Judge one experiment on one measured link."""
    rate, wall = experiment.controller.position_rate, experiment.wall
    on_the_device = experiment.controller.loop == "device"
    delay = loop_delay_ticks(experiment, measurement, rate)
    travel_s, lifetime_s = measurement.travel.almost_all, _lifetime_s(experiment)
    reasons = _of_the_link(experiment, measurement)
    notes: list[str] = []
    if measurement.travel.p999.high is None and not measurement.virtual:
        notes.append(
            f"{measurement.travel.number} exchanges bound p{100 * measurement.travel.bounded:.5g} only (p99.9 needs "
            f"{ENOUGH}): the longest one counts"
        )
    radius: dict[str, float] = {}
    limits: dict[str, float] = {}
    passive: float | None = None
    try:
        loops = LateLoops.of(experiment, delay)
        radius = loops.radius(wall.stiffness, wall.damping)
        limits = _limits(loops, wall.damping)
        homing = loops.radius(experiment.homing.stiffness, experiment.homing.damping)
        passive = passivity_bound(loops.by_hand[NO_OPERATOR][0], damping=wall.damping).stiffness
    except ConfigError as error:
        notes.append(f"stability is not computed: {error.message}")
    else:
        notes += [loops.stand_in] if loops.stand_in else []
        notes += _on_homing(homing, delay)
        notes.append(_on_passivity(experiment, passive))
        notes += _on_execution(experiment) if on_the_device and not measurement.virtual else []
    unstable = _unstable_hands(radius, wall.stiffness)
    if unstable:
        reasons.append(_unstable(experiment, delay, unstable, radius, limits))
    return Gate(
        armable=not reasons,
        reasons=tuple(reasons),
        notes=tuple(notes),
        rate_hz=rate,
        delay_ticks=delay,
        travel_s=travel_s,
        lifetime_s=lifetime_s,
        loss_share=measurement.loss_share,
        stiffness=wall.stiffness,
        damping=wall.damping,
        spectral_radius=radius,
        k_max=limits,
        passive_stiffness=passive,
        simulated=measurement.simulated,
    )


def refused_among(
    experiment: Experiment, measurement: LinkMeasurement, stiffnesses: Iterable[float]
) -> tuple[float, ...]:
    """Which of these stiffnesses `gate` refuses, at the experiment's damping; the same answer in far less time."""
    walls = tuple(stiffnesses)
    if _of_the_link(experiment, measurement):
        return walls
    rate, damping = experiment.controller.position_rate, experiment.wall.damping
    try:
        loops = LateLoops.of(experiment, loop_delay_ticks(experiment, measurement, rate))
    except ConfigError:
        return ()
    return tuple(k for k in walls if _unstable_hands(loops.radius(k, damping), k))


def _of_the_link(experiment: Experiment, measurement: LinkMeasurement) -> list[Reason]:
    """What speaks against any wall on this link."""
    travel_s, lifetime_s = measurement.travel.almost_all, _lifetime_s(experiment)
    reasons = []
    if travel_s > LIFETIME_SHARE * lifetime_s:
        ticks = measurement.delay_ticks(experiment.controller.position_rate, experiment.host.pacing)
        reasons.append(_too_slow(travel_s, lifetime_s, ticks, experiment.controller.loop == "device"))
    if measurement.loss_share > LOST_SHARE:
        reasons.append(_too_many_lost(measurement))
    return reasons


def _lifetime_s(experiment: Experiment) -> float:
    on_the_device = experiment.controller.loop == "device"
    return (supervise_lifetime_s if on_the_device else command_lifetime_s)(experiment)


def _limits(loops: LateLoops, damping: float) -> dict[str, float]:
    """Largest stable stiffness for each hand."""
    return {
        hand: min(k_max(loop, damping=damping).stiffness for loop in of_hand)
        for hand, of_hand in loops.by_hand.items()
    }


def _unstable_hands(radius: Mapping[str, float], stiffness: float) -> list[str]:
    # without stiffness the handle is free to stay anywhere: an eigenvalue of 1, which rounding may lift
    return [hand for hand, value in radius.items() if value >= (1.0 if stiffness > 0.0 else 1.0 + 1e-9)]


def check_change(experiment: Experiment, armed: Mapping[str, Any]) -> None:
    """Refuse a wall for a loop that runs where it would have been refused before arming.

    Parameters
    ----------
    experiment
        With the new wall.
    armed
        Of `Gate.as_mapping`, as the loop was armed: ``delay_ticks``, ``simulated`` and ``forced``.

    Raises
    ------
    PlanError
        Linear theory finds it unstable with the delay that was measured then. A simulated device is never refused, nor
        whoever armed anyway, nor a law of which theory does not speak.
    """
    if armed["simulated"] or armed["forced"]:
        return
    wall, delay = experiment.wall, int(armed["delay_ticks"])
    try:
        loops = LateLoops.of(experiment, delay)
    except ConfigError:
        return
    radius = loops.radius(wall.stiffness, wall.damping)
    if unstable := _unstable_hands(radius, wall.stiffness):
        reason = _unstable(experiment, delay, unstable, radius, _limits(loops, wall.damping))
        raise PlanError(f"this wall must not be rendered here: {reason.text}", remedy=reason.remedy)


def _too_slow(travel_s: float, lifetime_s: float, delay: int, on_the_device: bool) -> Reason:
    return Reason(
        f"the way to the device and back takes up to {1e3 * travel_s:.3g} ms ({delay} ticks), more than half of a "
        f"command's lifetime of {1e3 * lifetime_s:.3g} ms",
        "run `rig doctor --url …`, which names what delays it, grant real-time scheduling, or "
        + ("lengthen controller.supervise_lifetime_s" if on_the_device else "choose a lower rate"),
    )


def _too_many_lost(measurement: LinkMeasurement) -> Reason:
    return Reason(
        f"{measurement.lost} of {measurement.sent} questions were lost ({100 * measurement.loss_share:.2g} %, "
        f"{100 * LOST_SHARE:g} % are allowed)",
        "check the cable, its length and the baud rate, and whether another program reads the port",
    )


def _unstable(
    experiment: Experiment,
    delay: int,
    hands: list[str],
    radius: Mapping[str, float],
    limits: Mapping[str, float],
) -> Reason:
    wall, unit = experiment.wall, unit_of("stiffness", experiment.rig.motion)
    worst = max(radius.values())
    where = ", ".join("no hand" if hand == NO_OPERATOR else f"{hand} hand" for hand in hands)
    largest = min(limits.values())
    less = (
        f"choose --stiffness below {_rounded_down(largest)}" if largest > 0.0 else "choose another --damping"
    )
    return Reason(
        f"K = {wall.stiffness:g} {unit} with B = {wall.damping:g} is unstable at "
        f"{experiment.controller.position_rate} Hz with {delay} tick{'' if delay == 1 else 's'} of delay ({where}; "
        f"spectral radius {worst:.4g}, it holds up to K = {largest:.4g})",
        f"{less}, or a quicker link or another rate; `rig doctor --url …` lists what holds",
    )


def _rounded_down(value: float) -> str:
    """Two digits, not above the value."""
    scale = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.floor(value / scale) * scale:.12g}"


def _on_homing(radius: Mapping[str, float], delay: int) -> list[str]:
    worst = max(radius, key=lambda hand: radius[hand])
    if radius[worst] < 1.0:
        return []
    held = "no hand" if worst == NO_OPERATOR else f"a {worst} hand"
    return [
        f"homing would oscillate in {held} with a delay of {delay} (spectral radius {radius[worst]:.4g}), within "
        "homing.effort"
    ]


def _on_execution(experiment: Experiment) -> list[str]:
    """What a whole tick of delay would make of the wall: some two thirds of one is the device's at its highest rate."""
    wall = experiment.wall
    says = "the law runs on the device, within the tick"
    late = LateLoops.of(experiment, 1).radius(wall.stiffness, wall.damping)
    if _unstable_hands(late, wall.stiffness):
        return [
            f"{says}; with a whole tick of delay this wall would oscillate (spectral radius {max(late.values()):.4g})"
        ]
    return [f"{says}; with a whole tick of delay this wall would hold, too"]


def _on_passivity(experiment: Experiment, passive: float) -> str:
    wall, unit = experiment.wall, unit_of("stiffness", experiment.rig.motion)
    says = "passive" if wall.stiffness <= passive else "not passive (which is not asked)"
    return (
        f"the wall is {says}: up to K = {max(0.0, passive):.4g} {unit} it would be, at this damping and delay"
    )


# By device; scheduling is a part of what was measured.
_MEASURED: WeakKeyDictionary[FramedDevice, dict[tuple[str, int, int | None], LinkMeasurement]] = (
    WeakKeyDictionary()
)


def measured_once(
    device: FramedDevice, host: Host, rate: int, progress: Progress | None = None
) -> LinkMeasurement:
    """Measure the link of an open device, once for each scheduling: under that which the loop would have.

    Errors as `rig.bench.doctor.round_trip.measure_link`, and `RealtimeError` where scheduling is demanded and not
    granted.
    """
    kept = _MEASURED.setdefault(device, {})
    found = kept.get(scheduling := (host.realtime, host.priority, host.cpu))
    if found is None:
        seconds = min(LONGEST_S, max(SHORTEST_S, 1.05 * ENOUGH / rate))
        if device.dictionary.simulated:
            seconds = SIMULATED_S
        with obtained(host, virtual=device.link.clock.virtual) as realtime:
            found = measure_link(device, seconds, realtime=realtime, progress=progress)
        kept[scheduling] = found
    return found


def check_armable(
    device: FramedDevice,
    experiment: Experiment,
    *,
    anyway: bool = False,
    progress: Progress | None = None,
) -> Gate | None:
    """Measure the link of an open device (once) and refuse a wall that must not be armed on it.

    Parameters
    ----------
    device
        Open device that is not in a run.
    experiment
        As it is about to run.
    anyway
        The user takes the responsibility: nothing is refused, everything is said and recorded.
    progress
        Told the share of the measurement that is done.

    Returns
    -------
    Gate or None
        What was found; None in virtual time, where there is no delay and nothing to measure.

    Raises
    ------
    PlanError
        The wall must not be armed: all reasons, all remedies. Nothing has moved.
    LinkLostError
        The device does not answer.
    """
    if device.link.clock.virtual:
        return None
    measurement = measured_once(device, experiment.host, experiment.controller.position_rate, progress)
    found = replace(gate(experiment, measurement), forced=anyway)
    if found.armable or found.simulated or anyway:
        return found
    raise PlanError(
        f"this wall must not be armed: {found.text}",
        remedy=f"{found.remedy}; or, when you know better, --arm-anyway",
    )
