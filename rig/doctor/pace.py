"""Measure how many samples a loop would lose at its rate with this computer and link, and which lower rate loses none.

Time stamps are exchanged at the loop's rate, in a thread scheduled like the loop. A reply that arrives n whole periods
late means that a loop would have missed the samples of these n periods, or received them late if the device paused as
well; the measurement cannot distinguish the two causes. The same replies show what a lower rate would lose.

Identification and sessions call `measured_pace` between runs. It must not move the motor, and in virtual time it
measures nothing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.config import Host, VerdictLimits
from rig.devices.framed import FramedDevice
from rig.devices.local import host_beside
from rig.doctor._ping import EXCHANGE
from rig.doctor._round_trip import TIMEOUT_S, LinkMeasurement, measure_link
from rig.doctor.gate import LOST_SHARE
from rig.realtime.scheduling import obtained

__all__ = [
    "QUARTERS",
    "SECONDS",
    "SLOWEST_HZ",
    "LinkMeasurement",
    "Pace",
    "measure_link",
    "measured_pace",
    "pace_of",
]

SECONDS = 2.0
# Judged by the losses in each quarter of the measurement: one bad moment is not a slow machine.
QUARTERS = 4
# Below this rate (Hz) no wall feels stiff, so a lower rate is not offered.
SLOWEST_HZ = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """Samples that a loop at one rate would lose, or receive late by at least one period.

    Attributes
    ----------
    rate_hz
        Rate of the loop (Hz).
    lost_share
        Share of the samples that were lost or late, 0 to 1.
    longest_gap_s
        Longest time without a sample (s).
    hopeless
        True if each quarter of the measurement lost more samples than a valid trial may lose.
    kept_hz
        Highest of the rates rate/2, rate/4, … (Hz) that loses at most the share `LOST_SHARE` of the samples; None if
        every rate from `SLOWEST_HZ` on loses more.
    """

    rate_hz: int
    lost_share: float
    longest_gap_s: float
    hopeless: bool
    kept_hz: int | None

    @property
    def text(self) -> str:
        """Return a sentence about the samples that the loop would lose or receive late; empty if none."""
        if self.lost_share == 0.0:
            return ""
        lost = f"{100 * self.lost_share:.2g} % of the samples at {self.rate_hz} Hz, or is late with them"
        return (
            f"this computer or the link loses {lost}, for up to {1e3 * self.longest_gap_s:.3g} ms at a time"
        )


def measured_pace(device: FramedDevice, host: Host, rate_hz: int, limits: VerdictLimits) -> Pace | None:
    """Measure for `SECONDS` how many samples a loop would lose at `rate_hz`; return None in virtual time.

    Parameters
    ----------
    device
        Open device that is not in a run; the motor does not move.
    host
        Real-time scheduling of the loop on this computer (section ``[host]`` of the experiment).
    rate_hz
        Rate of the loop (Hz).
    limits
        Largest share of lost samples, and longest gap, of a valid trial.

    Raises
    ------
    LinkLostError
        The device does not reply.
    RealtimeError
        The experiment requires a scheduling that the kernel does not grant.
    """
    if device.link.clock.virtual:
        return None
    with obtained(host_beside(host, device.link)) as realtime:
        return pace_of(measure_link(device, SECONDS, rate_hz, realtime=realtime), rate_hz, limits)


def pace_of(measurement: LinkMeasurement, rate_hz: int, limits: VerdictLimits) -> Pace:
    """Return how many samples a loop at `rate_hz` (Hz) would lose, from a measurement of the link at this rate."""
    received_ns = measurement.exchanges[:, EXCHANGE.host_received]
    apart_ns = np.diff(received_ns)
    late_ns = np.maximum(apart_ns - int(np.median(apart_ns)), 0)
    # An answer that never came was waited for, which a loop does not do: it loses one sample.
    never = np.flatnonzero(late_ns >= 1e9 * TIMEOUT_S)[: max(0, measurement.lost - measurement.late)]

    def missed(rate: int) -> NDArray[np.int64]:
        samples: NDArray[np.int64] = late_ns * rate // 1_000_000_000
        samples[never] = 1
        return samples

    def share(samples: NDArray[np.int64], rate: int) -> float:
        return min(1.0, float(samples.sum()) / (rate * measurement.duration_s))

    samples = missed(rate_hz)
    quarter = np.minimum(QUARTERS * (received_ns[1:] - received_ns[0]) // apart_ns.sum(), QUARTERS - 1)
    lost = np.array([samples[quarter == number].sum() for number in range(QUARTERS)])
    longest = np.array([samples[quarter == number].max(initial=0) for number in range(QUARTERS)])
    most = limits.lost_fraction * rate_hz * measurement.duration_s / QUARTERS
    spoiled = (lost > most) | (longest > limits.longest_gap)
    slower = (rate_hz >> halvings for halvings in range(1, rate_hz.bit_length()))
    return Pace(
        rate_hz=rate_hz,
        lost_share=share(samples, rate_hz),
        longest_gap_s=float(samples.max()) / rate_hz,
        hopeless=bool(spoiled.all()),
        kept_hz=next((r for r in slower if r >= SLOWEST_HZ and share(missed(r), r) <= LOST_SHARE), None),
    )
