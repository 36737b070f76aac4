"""Made-up link measurements, for code that decides by one."""

from typing import Any

import numpy as np

from rig.doctor._round_trip import LinkMeasurement
from rig.recording.quantiles import Distribution


def link(travel_s: float = 30e-6, *, number: int = 4000, capacity: Any = None, **changes: Any) -> Any:
    """Return the measurement of a link on which every trip takes the same time, with changes of its fields."""
    times = Distribution.of(np.full(number, travel_s))
    counted = dict.fromkeys(("lost", "late", "unsent", "bad_frames", "states"), 0) | {"sent": 4000}
    values = counted | {
        "url": "made://up",
        "virtual": False,
        "simulated": False,
        "duration_s": 1.0,
        "drive": {},
    }
    return LinkMeasurement(
        **{**values, **changes},
        asked_rate_hz=None,
        round_trip_s=times,
        travel_s=times,
        stamps_trusted=True,
        bytes_to_device_per_s=1.0,
        bytes_to_host_per_s=1.0,
        capacity_bytes_per_s=capacity,
        exchanges=np.zeros((0, 4), np.int64),
    )
