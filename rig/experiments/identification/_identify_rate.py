"""Choose the rate of an identification in real time, so that the measured link transmits every command in time.

`identify` calls this module.
"""

from dataclasses import dataclass

from rig import config
from rig.config import Experiment
from rig.config.controller import command_lifetime_s
from rig.core.errors import PlanError
from rig.devices.device import LINK_SHARE, STATE_BYTES
from rig.devices.framed import FramedDevice
from rig.devices.local import host_beside
from rig.doctor.gate import LIFETIME_SHARE
from rig.doctor.pace import SECONDS, LinkMeasurement, measure_link, pace_of
from rig.experiments.motion._motion_run import MOST_LOST_SHARE, SLOWEST_HZ, bearing_rate
from rig.experiments.trials._identify_motions import RATE_STEP, still
from rig.realtime.scheduling import obtained

LEAST_RATE_HZ = 10  # lowest rate of any loop (rule of `controller.position_rate`)
# Allowed fraction of lost samples over the fraction that can be filled in: losses may increase in the next minute.
LOST_MARGIN = 0.5
RATES = ("controller.position_rate", "controller.velocity_rate")


def at_rate(experiment: Experiment, rate_hz: int, origin: str) -> Experiment:
    """Return the experiment without a wall at the loop rate `rate_hz`; error messages quote the reason `origin`."""
    return config.override(still(experiment), dict.fromkeys(RATES, rate_hz), origin)


@dataclass(frozen=True, slots=True)
class RateChoice:
    """A loop rate (Hz), why identification at it would fail ("" if not), and the longest time without a command (s)."""

    rate_hz: int
    reason: str
    silence_s: float


def measure_for(device: FramedDevice, experiment: Experiment, rate_hz: int) -> LinkMeasurement:
    """Measure the link by clock exchanges at this rate (Hz), in a thread scheduled like the loop; nothing moves."""
    with obtained(host_beside(experiment.host, device.link)) as realtime:
        return measure_link(device, SECONDS, rate_hz, realtime=realtime)


def choose_rate(
    experiment: Experiment, measurement: LinkMeasurement, *, most_hz: int, stated_hz: int | None = None
) -> RateChoice:
    """Return `stated_hz`, or the highest of `most_hz` and its halves (Hz), for which the measured link is good enough.

    Raises
    ------
    PlanError
        The link is too slow or lossy at these rates; the message has the numbers, and proposes a rate if there is one.
    """
    rates = [most_hz, *halves(most_hz)]
    judged = [judge_rate(experiment, measurement, rate) for rate in rates]
    last = bearing_rate(judged[-1].silence_s)
    if SLOWEST_HZ <= last < judged[-1].rate_hz:
        judged.append(judge_rate(experiment, measurement, last))
    works = next((choice for choice in judged if not choice.reason), None)
    if stated_hz is not None:
        stated = judge_rate(experiment, measurement, stated_hz)
        if not stated.reason:
            return stated
        slower = works if works is not None and works.rate_hz < stated_hz else None
        raise _make_refusal(experiment, measurement, stated, slower)
    if works is None:
        raise _make_refusal(experiment, measurement, judged[-1], None)
    return works


def halves(rate_hz: int) -> list[int]:
    """Return a half, a quarter … of a rate (Hz), rounded down to multiples of 50 Hz, if fast enough to identify."""
    slower = (rate_hz >> number for number in range(1, rate_hz.bit_length()))
    return [rate - rate % RATE_STEP for rate in slower if rate - rate % RATE_STEP >= SLOWEST_HZ]


def judge_rate(experiment: Experiment, measurement: LinkMeasurement, rate_hz: int) -> RateChoice:
    """Judge by the measured link if identification works at a rate (Hz): command lifetime, lost samples, capacity."""
    slowed = at_rate(experiment, rate_hz, "the link")
    lifetime_s = command_lifetime_s(slowed)
    pace = pace_of(measurement, rate_hz, experiment.verdict)
    # A device ends an effort whose command has expired: half of the lifetime is a reserve for a longer gap than the
    # measurement contains.
    late_s, silence_s = measurement.late_s, max(measurement.late_s, pace.longest_gap_s)
    capacity = measurement.capacity_bytes_per_s
    reasons = []
    if silence_s > LIFETIME_SHARE * lifetime_s:
        reasons.append(
            f"the loop sent nothing for {1e3 * silence_s:.3g} ms (round trip {1e3 * late_s:.3g} ms in 99.9 % of all "
            f"cases); allowed are {1e3 * LIFETIME_SHARE * lifetime_s:.3g} ms, half of a command's lifetime"
        )
    if pace.lost_share > LOST_MARGIN * MOST_LOST_SHARE:
        reasons.append(
            f"{100 * pace.lost_share:.2g} % of the samples are lost or late, allowed "
            f"{100 * LOST_MARGIN * MOST_LOST_SHARE:.2g} %"
        )
    if capacity is not None and rate_hz * STATE_BYTES > LINK_SHARE * capacity:
        reasons.append(
            f"the capacity of the link is {int(LINK_SHARE * capacity // STATE_BYTES)} samples per second"
        )
    return RateChoice(rate_hz, "; ".join(reasons), silence_s)


def _make_refusal(
    experiment: Experiment, measurement: LinkMeasurement, choice: RateChoice, works: RateChoice | None
) -> PlanError:
    if works is not None:
        remedy = f"choose `rate` {works.rate_hz}, or leave it out"
    else:
        slower = (choice.rate_hz >> number for number in range(1, choice.rate_hz.bit_length()))
        slower = (rate for rate in slower if rate >= LEAST_RATE_HZ)
        carrying = (rate for rate in slower if not judge_rate(experiment, measurement, rate).reason)
        carried = next(carrying, None)
        carry = f"{carried} Hz" if carried else f"less than {LEAST_RATE_HZ} Hz"
        remedy = (
            "end other programs on the computer, or grant real-time scheduling (`rig doctor` shows "
            f"how): computer and link now support {carry}, and an identification needs {SLOWEST_HZ} "
            "Hz or more"
        )
    return PlanError(f"an identification at {choice.rate_hz} Hz would fail: {choice.reason}", remedy=remedy)
