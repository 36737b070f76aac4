"""The arming gate: decide from the measured link whether the motor may be armed to render a wall.

On a real device the gate refuses

* a link whose round trip exceeds half of a command's lifetime in more than 0.1 % of all exchanges;
* a share of lost requests above `LOST_SHARE`;
* a wall that is unstable by linear theory at the loop's rate with the measured delay, without a hand or with any
  modelled hand (`rig.doctor.late_loops`: the spectral radius over one velocity period is 1 or more);
* homing that cannot work by the description of the rig (`rig.doctor.predicted`).

Passivity is reported and not required. A simulated device is never refused.

Hits (trials against a wall), identification, motions, `rig design`, `rig.doctor` and sessions call this file. It must
not move the motor: a refusal comes before the device is armed.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

from rig.config import Experiment, Host
from rig.config.controller import command_lifetime_s, rate_of_lifetime, supervise_lifetime_s
from rig.core import check
from rig.core.answers import ok, question, refused, warning
from rig.core.check import Check
from rig.core.errors import ConfigError, PlanError
from rig.devices.framed import FramedDevice
from rig.devices.local import host_beside
from rig.doctor._late_walls import late_wall, stability
from rig.doctor._round_trip import ENOUGH, LinkMeasurement, Progress, measure_link
from rig.doctor.gate_result import Gate, ticks_text
from rig.doctor.late_loops import LateLoops, loop_delay_ticks, unstable_hands
from rig.doctor.predicted import homing_checks
from rig.realtime.scheduling import obtained

# Share of a command's lifetime for both ways of the link: a slower one would drop the wall during a contact.
LIFETIME_SHARE = 0.5
# Allowed share of lost requests: a loop loses one command in a thousand without effect.
LOST_SHARE = 0.001
# A measurement before arming lasts as long as a bound of p99.9 needs, within these limits (s).
SHORTEST_S, LONGEST_S = 1.0, 4.0
# A simulated device is never refused, so a short measurement is enough.
SIMULATED_S = 0.2


def gate(experiment: Experiment, measurement: LinkMeasurement) -> Gate:
    """Decide whether the motor may be armed to render the experiment's wall over the measured link."""
    rate, wall = experiment.controller.position_rate, experiment.wall
    delay = loop_delay_ticks(experiment, measurement, rate)
    # Coulomb friction, which stabilises walls that linear theory finds unstable, is not counted on.
    judged = late_wall(experiment, delay)
    executed = experiment.controller.loop == "device" and not measurement.virtual and judged.radius
    return Gate(
        checks=(
            *_link_checks(experiment, measurement),
            *judged.checks,
            *homing_checks(experiment, delay),
            *([_execution(experiment)] if executed else []),
        ),
        rate_hz=rate,
        delay_ticks=delay,
        travel_s=measurement.travel_s.almost_all,
        lifetime_s=_lifetime_s(experiment),
        loss_share=measurement.loss_share,
        stiffness=wall.stiffness,
        damping=wall.damping,
        spectral_radius=judged.radius,
        k_max=judged.k_max,
        passive_stiffness=judged.passive,
        simulated=measurement.simulated,
    )


def refused_among(
    experiment: Experiment, measurement: LinkMeasurement, stiffnesses: Iterable[float]
) -> tuple[float, ...]:
    """Return those of the stiffnesses (N/m or N·m/rad) with which the motor must not be armed, at the wall's damping.

    All are refused if the link is too slow or lossy, or homing cannot work; none if theory does not cover the law.
    """
    walls = tuple(stiffnesses)
    delay = loop_delay_ticks(experiment, measurement, experiment.controller.position_rate)
    if check.refused([*_link_checks(experiment, measurement), *homing_checks(experiment, delay)]):
        return walls
    damping = experiment.wall.damping
    try:
        loops = LateLoops.of(experiment, delay)
    except ConfigError:
        return ()
    return tuple(k for k in walls if unstable_hands(loops.radius(k, damping), k))


def check_change(experiment: Experiment, armed: Mapping[str, Any]) -> None:
    """Raise `PlanError` if a new wall for a running loop is unstable with the delay that was measured before arming.

    Parameters
    ----------
    experiment
        Experiment with the new wall.
    armed
        Result of `gate` before arming: the fields ``delay_ticks``, ``simulated``, ``forced`` (armed despite refusals).

    Raises
    ------
    PlanError
        The wall is unstable by linear theory, the device is real, and the user did not force the arming.
    """
    if armed["simulated"] or armed["forced"]:
        return
    wall, delay = experiment.wall, int(armed["delay_ticks"])
    try:
        loops = LateLoops.of(experiment, delay)
    except ConfigError:
        return
    radius = loops.radius(wall.stiffness, wall.damping)
    if unstable_hands(radius, wall.stiffness):
        found = stability(experiment, delay, radius, loops.k_max([wall.damping])[0])
        raise PlanError(f"the running loop must not render this wall: {found.text}", remedy=found.remedy)


def _lifetime_s(experiment: Experiment) -> float:
    on_the_device = experiment.controller.loop == "device"
    return (supervise_lifetime_s if on_the_device else command_lifetime_s)(experiment)


def _link_checks(experiment: Experiment, measurement: LinkMeasurement) -> list[Check]:
    found = [_delay(experiment, measurement), _losses(measurement)]
    times = measurement.travel_s
    if times.p999.high is None and not measurement.virtual:
        found.append(_short(times.number, times.bounded))
    return found


@question(
    "delay", "if a command arrives after the previous one's lifetime, the device has already dropped the wall"
)
def _delay(experiment: Experiment, measurement: LinkMeasurement) -> Check:
    travel_s, lifetime_s = measurement.travel_s.almost_all, _lifetime_s(experiment)
    ticks = measurement.delay_ticks(experiment.controller.position_rate, experiment.host.pacing)
    text = f"the link takes up to {1e3 * travel_s:.3g} ms both ways ({ticks_text(ticks)})"
    limit = f"half of a command's lifetime of {1e3 * lifetime_s:.3g} ms"
    if travel_s <= LIFETIME_SHARE * lifetime_s:
        return ok(f"{text}, less than {limit}")
    if experiment.controller.loop == "device":
        other = "lengthen controller.supervise_lifetime_s"
    elif experiment.controller.command_lifetime_s is not None:
        other = f"set controller.command_lifetime_s to {travel_s / LIFETIME_SHARE:.3g} s or more, if its limit permits"
    else:
        other = f"choose a rate of {rate_of_lifetime(travel_s / LIFETIME_SHARE)} Hz or less"
    return refused(
        f"{text}, more than {limit}",
        f"run `rig doctor --url …`, which names what delays it, grant real-time scheduling, or {other}",
    )


@question("losses", "each lost command is a tick without a new effort")
def _losses(measurement: LinkMeasurement) -> Check:
    share = f"{100 * measurement.loss_share:.2g} %, allowed {100 * LOST_SHARE:g} %"
    text = f"{measurement.lost} of {measurement.sent} requests were lost ({share})"
    if measurement.loss_share <= LOST_SHARE:
        return ok(text)
    return refused(
        text, "check the cable, its length and the baud rate, and whether another program reads the port"
    )


@question("measurement")
def _short(number: int, bounded: float) -> Check:
    return warning(
        f"{number} replies bound only p{100 * bounded:.5g}; the longest round trip is used instead",
        f"measure longer: bounding p99.9 needs {ENOUGH} replies",
    )


@question("execution")
def _execution(experiment: Experiment) -> Check:
    """Return a check that warns if the wall, whose law runs on the device, would be unstable with one tick of delay."""
    # The device answers within two thirds of a tick at most, or reports missed ticks: the gate counts no delay.
    wall = experiment.wall
    late = LateLoops.of(experiment, 1).radius(wall.stiffness, wall.damping)
    text = "the law runs on the device within a tick; with a full tick of delay this wall would be"
    if unstable_hands(late, wall.stiffness):
        return warning(f"{text} unstable (spectral radius {max(late.values()):.4g})")
    return ok(f"{text} stable, too")


# By device; scheduling is a part of what was measured.
_MEASURED: WeakKeyDictionary[FramedDevice, dict[tuple[str, int, int | None], LinkMeasurement]] = (
    WeakKeyDictionary()
)


def measured_once(
    device: FramedDevice, host: Host, rate: int, progress: Progress | None = None
) -> LinkMeasurement:
    """Measure the link of an open device with the loop's scheduling; repeated calls return the first measurement.

    Raise `LinkLostError` if the device does not reply, and `RealtimeError` if the experiment requires a scheduling that
    the kernel does not grant.
    """
    kept = _MEASURED.setdefault(device, {})
    found = kept.get(scheduling := (host.realtime, host.priority, host.cpu))
    if found is None:
        seconds = min(LONGEST_S, max(SHORTEST_S, 1.05 * ENOUGH / rate))
        if device.dictionary.simulated:
            seconds = SIMULATED_S
        with obtained(host_beside(host, device.link), virtual=device.link.clock.virtual) as realtime:
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
    """Measure the link of an open device (once); raise `PlanError` if the experiment's wall must not be armed.

    Parameters
    ----------
    device
        Open device that is not in a run.
    experiment
        Experiment that is about to run.
    anyway
        True if the user accepts the risk: nothing is refused, and all checks are reported and recorded.
    progress
        Function that receives the completed share of the measurement (0 to 1).

    Returns
    -------
    Gate or None
        Decision of `gate`; None in virtual time, in which the link has no delay.

    Raises
    ------
    PlanError
        The wall must not be armed; the message has all reasons and remedies. The motor has not moved.
    LinkLostError
        The device does not reply.
    """
    if device.link.clock.virtual:
        return None
    measurement = measured_once(device, experiment.host, experiment.controller.position_rate, progress)
    found = replace(gate(experiment, measurement), forced=anyway)
    if found.armable or found.simulated or anyway:
        return found
    raise PlanError(
        f"this wall must not be armed: {found.text}",
        remedy=f"{found.remedy}; or accept the risk with `arm_anyway`",
    )
