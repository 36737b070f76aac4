"""What a link and this computer make of a loop's rate: how many of its samples are lost, and which rate keeps them.

Clock stamps are exchanged at the loop's own rate, in a thread that is scheduled like the loop. An answer that travels
longer than two periods is a loop that has missed the samples of all periods but one; so the same answers say what a
lower rate would lose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig.bench.doctor.gate import LOST_SHARE
from rig.bench.doctor.ping import EXCHANGE
from rig.bench.doctor.round_trip import LinkMeasurement, measure_link
from rig.core.present import reported
from rig.devices.framed import FramedDevice
from rig.realtime.scheduling import Request, obtained

SECONDS = 2.0
QUARTERS = 4  # a bad moment is not a bad machine: what counts is lost in each quarter of the measurement
SLOWEST_HZ = 100  # nobody feels a stiff wall below


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """What was lost at a rate.

    Attributes
    ----------
    rate_hz
        Of the loop.
    lost_share
        Share of its samples that were lost.
    least_share
        The same in the best quarter of the measurement.
    kept_hz
        Highest of the halves of the rate that loses no more than `LOST_SHARE`, by the same answers; None where none
        above `SLOWEST_HZ` does.
    limit
        Share of lost samples that leaves nearly no trial valid, when every quarter reaches it.
    """

    rate_hz: int
    lost_share: float
    least_share: float
    kept_hz: int | None
    limit: float

    @reported
    def refused(self) -> bool:
        """Whether nearly every trial would be invalid: every quarter of the measurement lost the limit or more."""
        return self.least_share >= self.limit

    @property
    def text(self) -> str:
        """What was measured, where something was lost; empty where nothing was."""
        if self.lost_share == 0.0:
            return ""
        share = f"{100 * self.lost_share:.2g} %"
        return f"this computer or the link loses {share} of the samples at {self.rate_hz} Hz"


def measured_pace(device: FramedDevice, request: Request, rate_hz: int, limit: float) -> Pace | None:
    """Measure an open device for `SECONDS`; None in virtual time, where nothing is late.

    Parameters
    ----------
    device
        Open, and not in a run. Nothing moves.
    request
        Scheduling of the loop.
    rate_hz
        Of the loop.
    limit
        As in `Pace`.

    Raises
    ------
    LinkLostError
        The device does not answer.
    RealtimeError
        Scheduling is demanded and not granted.
    """
    if device.link.clock.virtual:
        return None
    with obtained(request) as realtime:
        return pace_of(measure_link(device, SECONDS, rate_hz, realtime=realtime), rate_hz, limit)


def pace_of(measurement: LinkMeasurement, rate_hz: int, limit: float) -> Pace:
    """What a measurement says of a rate."""
    exchanges = measurement.exchanges
    sent, received = exchanges[:, EXCHANGE.host_sent], exchanges[:, EXCHANGE.host_received]
    kept = exchanges[:, EXCHANGE.device_sent] - exchanges[:, EXCHANGE.device_received]
    travel_s = 1e-9 * np.maximum(received - sent - (kept if measurement.stamps_trusted else 0), 0)
    quarter = np.minimum(QUARTERS * (sent - sent[0]) // max(1, sent[-1] - sent[0]), QUARTERS - 1)

    def lost(rate: float) -> float:
        missed = np.maximum(np.floor(travel_s * rate) - 1.0, 0.0).sum() + measurement.lost
        return min(1.0, float(missed) / (rate * measurement.duration_s))

    of_quarter = rate_hz * measurement.duration_s / QUARTERS
    missed = np.bincount(quarter, np.maximum(np.floor(travel_s * rate_hz) - 1.0, 0.0), QUARTERS)
    slower = (rate_hz >> halves for halves in range(1, rate_hz.bit_length()))
    return Pace(
        rate_hz=rate_hz,
        lost_share=lost(rate_hz),
        least_share=min(1.0, float(missed.min()) / of_quarter),
        kept_hz=next((rate for rate in slower if rate >= SLOWEST_HZ and lost(rate) <= LOST_SHARE), None),
        limit=limit,
    )
