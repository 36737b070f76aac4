"""Measure how late this computer wakes a sleeping thread, with the sleep function of the real-time loop."""

import sys
import threading
from dataclasses import dataclass, replace

import numpy as np
from numba import types
from numpy.typing import NDArray

from rig.core.answers import ok, question, warning
from rig.core.check import Check
from rig.realtime.handlers import take_no_signals
from rig.realtime.kernel import kernel
from rig.realtime.scheduling import RealtimeRequest, obtained
from rig.realtime.system import monotonic_now, sleep_until

if sys.platform == "linux":
    from rig.realtime.scheduling import ThreadState

# `rig.doctor.interface` imports this file on Linux only; elsewhere mypy skips it from here on.
assert sys.platform == "linux"

RATE_HZ = 1000
# Largest p99 of the wake-up latency without a warning (s): a fifth of the period at `RATE_HZ`.
LATE_S = 0.0002


@kernel(types.int64(types.int64, types.int64[::1]))
def wake_ups(period_ns: int, late_ns: NDArray[np.int64]) -> int:
    """Sleep until each of a series of deadlines `period_ns` (ns) apart, and measure how late each wake-up is.

    Write each lateness (ns) into the array `late_ns`; return the number of whole periods that were missed.
    """
    skipped = 0
    deadline = monotonic_now(0) + period_ns
    for index in range(late_ns.size):
        sleep_until(deadline)
        late = monotonic_now(0) - deadline
        late_ns[index] = late
        missed = late // period_ns
        skipped += missed
        deadline += (1 + missed) * period_ns
    return skipped


@dataclass(frozen=True, slots=True, kw_only=True)
class WakeUps:
    """Measured lateness of wake-ups: median, 99 % quantile and maximum (s), and number of missed periods."""

    rate_hz: int
    count: int
    p50_s: float
    p99_s: float
    worst_s: float
    skipped: int
    thread: ThreadState
    refusals: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _BestEffortRequest:
    """Request for real-time scheduling that is best effort: a refusal by the kernel is accepted."""

    priority: int
    cpu: int | None
    realtime: str


def measure(request: RealtimeRequest, seconds: float = 1.0, rate_hz: int = RATE_HZ) -> WakeUps:
    """Measure for `seconds` how late wake-ups at `rate_hz` (Hz) are, with the requested scheduling if it is granted."""
    asked = "try" if request.realtime == "enforce" else request.realtime
    late = np.zeros(max(round(seconds * rate_hz), 2), np.int64)
    ran: list[tuple[ThreadState, int]] = []
    with obtained(_BestEffortRequest(request.priority, request.cpu, asked)) as realtime:
        realtime.prefault(late)

        def body() -> None:
            take_no_signals()
            state = realtime.enter_thread() or ThreadState.here()
            ran.append((state, wake_ups(1_000_000_000 // rate_hz, late)))

        thread = threading.Thread(target=body, name="rig-wake-up", daemon=True)
        thread.start()
        thread.join()
    state, skipped = ran[0]
    p50, p99 = (float(value) * 1e-9 for value in np.quantile(late, (0.5, 0.99)))
    return WakeUps(
        rate_hz=rate_hz,
        count=late.size,
        p50_s=p50,
        p99_s=p99,
        worst_s=float(late.max()) * 1e-9,
        skipped=skipped,
        thread=state,
        refusals=tuple(refusal.text for refusal in realtime.refusals),
    )


@question("wake-ups", "wake-up latency shortens each period and varies from tick to tick")
def judge(woken: WakeUps) -> Check:
    """Return a check of the measured wake-ups: a warning if p99 exceeds `LATE_S` or a period was missed."""
    thread = woken.thread
    policy = f"{thread.name} {thread.priority}" if thread.priority else thread.name
    p50, p99, worst = (f"{value * 1e6:.0f} µs" for value in (woken.p50_s, woken.p99_s, woken.worst_s))
    text = f"{woken.count} at {woken.rate_hz / 1000:g} kHz as {policy}: 50 % within {p50}, 99 % within {p99}"
    text += f", longest {worst}" + (f"; {woken.skipped} periods missed" if woken.skipped else "")
    text += "".join(f"; {refusal}" for refusal in woken.refusals)
    found = warning(text) if woken.p99_s > LATE_S or woken.skipped else ok(text)
    names = ("count", "rate_hz", "p50_s", "p99_s", "worst_s", "skipped")
    return replace(found, numbers={name: getattr(woken, name) for name in names})
