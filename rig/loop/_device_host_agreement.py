"""Compare the current of a law on the device with the current that the same law computes on the host.

The current that is active at a sample is compared with the host's result at the sample before. The two laws use
different arithmetic, so they may differ slightly. Samples are excluded while a limit or a ramp acts, after a gap, and
without a STATE message that covers them. `rig.loop._supervise` calls it. It must not end a run: it only counts.
"""

from typing import Any

from numba import types

from firmware_protocol.faults import LimitFlag
from rig.control.step import CONTROL_TYPE
from rig.loop._supervision import CONTIGUOUS, SUPERVISION_TYPE
from rig.loop.layout import INTS, SETTINGS_TYPE
from rig.realtime.codec import STATE
from rig.realtime.kernel import kernel

# Limits that change the current; the others only warn.
_ACTING = int(
    LimitFlag.CURRENT
    | LimitFlag.SLEW
    | LimitFlag.THERMAL
    | LimitFlag.RAMPING
    | LimitFlag.HOLD_TO_RUN_RELEASED
)


FORGET_PERIODS, FORGET_NS = 50, 20_000_000  # velocity periods, and time, whichever is longer


@kernel(types.void(SUPERVISION_TYPE, SETTINGS_TYPE, CONTROL_TYPE, types.int64, types.int64))
def compare(supervision: Any, settings: Any, control: Any, elapsed: int, applied: int) -> None:
    """Compare the device's active current `applied` (quanta) with the host law's current at the sample before.

    `elapsed` is the number of ticks since that sample; above 1, samples are excluded for a while. The differences count
    only after the next STATE message (`settle`).
    """
    v, s = supervision[0], settings[0]
    if v["comparable"] == 0:
        return
    # After a gap the estimators of host and device have seen different samples: wait until they no longer depend on it.
    if elapsed != 1:
        v["forgetting"] = max(FORGET_PERIODS * control[0]["velocity_divider"], FORGET_NS // s["period_ns"])
    if v["forgetting"] > 0:
        v["forgetting"] -= 1
        v["excluded"] += 1
        return
    difference = abs(applied - v["sent"])
    v["open_compared"] += 1
    if difference > 0:
        v["open_differing"] += 1
        v["open_greatest"] = max(v["open_greatest"], difference)
    if difference > s["agreement_quanta"]:
        v["open_beyond"] += 1


@kernel(types.void(SUPERVISION_TYPE, INTS))
def settle(supervision: Any, state: Any) -> None:
    """Count the comparisons since the last STATE message, or exclude them if the new STATE reports an active limit."""
    # A STATE reports the limits that acted before it, so the samples up to it can be counted only now.
    v = supervision[0]
    limits = state[STATE.limits] & _ACTING
    if state[CONTIGUOUS] == 1 and (limits | v["limits_before"]) == 0:
        v["compared"] += v["open_compared"]
        v["differing"] += v["open_differing"]
        v["beyond"] += v["open_beyond"]
        v["greatest"] = max(v["greatest"], v["open_greatest"])
    else:
        v["excluded"] += v["open_compared"]
    v["limits_before"] = limits
    v["open_compared"] = 0
    v["open_differing"] = 0
    v["open_beyond"] = 0
    v["open_greatest"] = 0
