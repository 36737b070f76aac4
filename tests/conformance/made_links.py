"""Made-up link measurements, for code that decides by one."""

from typing import Any

import numpy as np

from rig.doctor._round_trip import LinkMeasurement
from rig.recording.quantiles import Distribution


def link(
    travel_s: float = 30e-6,
    *,
    number: int = 4000,
    lost: int = 0,
    sent: int = 4000,
    capacity: Any = None,
    simulated: bool = False,
    virtual: bool = False,
    drive: Any = None,
) -> Any:
    """Return the measurement of a link on which every trip takes the same time."""
    times = Distribution.of(np.full(number, travel_s))
    return LinkMeasurement(
        url="made://up",
        virtual=virtual,
        simulated=simulated,
        duration_s=1.0,
        asked_rate_hz=None,
        sent=sent,
        lost=lost,
        late=0,
        unsent=0,
        bad_frames=0,
        round_trip_s=times,
        travel_s=times,
        stamps_trusted=True,
        bytes_to_device_per_s=1.0,
        bytes_to_host_per_s=1.0,
        capacity_bytes_per_s=capacity,
        states=0,
        exchanges=np.zeros((0, 4), np.int64),
        drive=drive or {},
    )
