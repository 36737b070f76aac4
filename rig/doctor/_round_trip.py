"""Measure the round trip of a link: time from request to reply, lost requests, and the highest rate for a loop.

A reply contains the device's two time stamps, of the received request and of the sent reply. The round trip minus the
time between these stamps is the time on the link, which decides the delay of a loop. The arming gate and `rig doctor`
call it.
"""

import math
import os
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages
from rig.core.errors import LinkLostError
from rig.core.present import Row, reported
from rig.devices.framed import FramedDevice
from rig.doctor._ping import EXCHANGE, TALLY, PingBuffers, ping
from rig.doctor.gate_result import ticks_late
from rig.realtime.handlers import take_no_signals
from rig.realtime.scheduling import Realtime
from rig.recording.quantiles import Distribution, Quantile, values_needed

# Number of exchanges that give p99.9 an upper bound.
ENOUGH = values_needed(0.999)
# Silence (s) that ends a run of the loop (`rig.experiments.trials._trial`).
TIMEOUT_S = 0.05
# The compiled function returns this often, so that Python can stop it.
SLICE_S = 0.05
POLL_S = 0.05
# The first exchanges touch memory and code for the first time, so these are not counted.
WARM_UP = 8
LARGEST_TABLE = 200_000
# Highest rate of requests if no rate is given: no link is faster.
FASTEST_HZ = 50_000.0
# Largest plausible time between the device's two stamps, over the round trip that contains it. It may exceed 1 a little
# because the device's clock drifts and has steps.
HONEST = 1.01

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True, eq=False)
class LinkMeasurement:
    """Measured round trips, losses and throughput of one link.

    Attributes
    ----------
    url, virtual, simulated
        URL of the device; True if the link's clock is virtual (simulated time); True if the device is simulated.
    duration_s
        Length of the measurement (s, by the link's clock).
    asked_rate_hz
        Highest rate of requests (Hz); None to send each request as soon as the previous reply arrives.
    sent, unsent, bad_frames
        Numbers of requests that were sent, of requests that the port did not accept, and of damaged frames.
    lost, late
        Numbers of requests without a reply within `TIMEOUT_S`, and of replies that arrived later.
    round_trip_s
        Distribution of the time from a request to its reply (s).
    travel_s
        Distribution of the time on the link alone (s): each round trip minus the time between the device's two stamps.
    stamps_trusted
        True if the device's time stamps are plausible; if False, `travel_s` is equal to `round_trip_s`.
    bytes_to_device_per_s, bytes_to_host_per_s
        Bytes per second on the link, including frames that the device sends without a request.
    capacity_bytes_per_s
        Capacity of the link in each direction (bytes/s); None if unknown.
    states
        Number of State messages received during the measurement.
    exchanges
        Four time stamps of each exchange (ns): host sends, device receives, device sends, host receives; shape (n, 4).
    drive
        Statistics of the bus between a bridge (firmware on this computer) and its motor drive since it was opened (such
        as ``median_us``, the median reply time in µs); empty for a device without a bridge.
    """

    url: str
    virtual: bool
    simulated: bool
    duration_s: float
    asked_rate_hz: float | None
    sent: int
    lost: int
    late: int
    unsent: int
    bad_frames: int
    round_trip_s: Distribution
    travel_s: Distribution
    stamps_trusted: bool
    bytes_to_device_per_s: float
    bytes_to_host_per_s: float
    capacity_bytes_per_s: float | None
    states: int
    exchanges: NDArray[np.int64] = field(repr=False)
    drive: Mapping[str, float] = field(default_factory=dict)

    @reported
    def loss_share(self) -> float:
        """Return the share of requests without a reply within `TIMEOUT_S`, from 0 to 1."""
        return self.lost / self.sent

    @reported
    def loop_rate_hz(self) -> float:
        """Return the highest loop rate (Hz) at which 99.9 % of commands arrive within one tick; ∞ in virtual time.

        Behind a drive that sends samples on its own, the tick is a multiple of the period of these messages.
        """
        if self.late_s <= 0.0:
            return math.inf
        message_s = 1e-6 * self.drive.get("cycle_us", 0.0)
        return 1.0 / (math.ceil(self.late_s / message_s) * message_s if message_s else self.late_s)

    @property
    def sample_delay_s(self) -> float:
        """Return the time (s) that a motor drive on a bus takes for a sample (99.9 % quantile); 0 without a bus."""
        return 1e-6 * self.drive.get("p999_us", 0.0)

    @property
    def late_s(self) -> float:
        """Return the time (s) from a device's tick to the arrival of its command, not exceeded in 99.9 % of ticks."""
        return self.travel_s.almost_all + self.sample_delay_s

    def delay_ticks(self, rate: float, pacing: str = "device") -> int:
        """Return the delay from a sample to its command in ticks of `rate` (Hz), not exceeded in 99.9 % of ticks.

        `pacing` is ``device`` or ``host``: the side whose clock starts each tick. The delay is 0 in virtual time.
        """
        return 0 if self.virtual else ticks_late(self.late_s, rate, pacing)

    def rows(self) -> list[Row]:
        """Return the measurement of a link as rows of a printed table: name, text and note."""
        asked = (
            "as fast as the device replies" if self.asked_rate_hz is None else f"at {self.asked_rate_hz:g} Hz"
        )
        known = (
            _times(self.travel_s) if self.stamps_trusted else "unknown: the device's time stamps are invalid"
        )
        carries = (
            "" if self.capacity_bytes_per_s is None else f"of {self.capacity_bytes_per_s / 1e3:.1f} kB/s"
        )
        there, back = self.bytes_to_device_per_s / 1e3, self.bytes_to_host_per_s / 1e3
        lost = f"{100 * self.loss_share:.2g} %; {self.late} late, {self.unsent} not sent, {self.bad_frames} bad frames"
        rate = f"{self.loop_rate_hz:.0f} Hz with at most one tick of delay for 99.9 % of the commands"
        return [
            Row("requests", self.sent, note=f"in {self.duration_s:.1f} s, {asked}"),
            Row("round trip", _times(self.round_trip_s)),
            Row("thereof the link", known),
            *([Row("drive", _drive(self.drive))] if self.drive else []),
            *([] if self.virtual else [Row("loop rate", f"up to {rate}")]),
            Row("lost", self.lost, note=lost),
            Row("bytes", f"{there:.1f} kB/s to the device, {back:.1f} kB/s to the host", note=carries),
        ]


def _drive(facts: Mapping[str, float]) -> str:
    """Return a sentence about the bus to a motor drive: reply times (ms), lost replies, drive temperature (°C)."""
    named = (("p50", "median_us"), ("p99.9", "p999_us"), ("longest", "longest_us"))
    times = ", ".join(f"{name} {1e-3 * facts[key]:.3g} ms" for name, key in named)
    asked = facts["replies"] + facts["lost"]
    kind = "samples after" if facts.get("cycle_us") else "replies after"
    return f"{kind} {times}; {facts['lost']:.0f} of {asked:.0f} replies lost; {facts['temperature']:.0f} °C"


def _times(times: Distribution) -> str:
    named = (("p50", times.p50), ("p99", times.p99), ("p99.9", times.p999))
    return f"{', '.join(f'{name} {_time(q)}' for name, q in named)}, longest {1e3 * times.maximum:.3g} ms"


def _time(quantile: Quantile) -> str:
    low, high = ("?" if bound is None else f"{1e3 * bound:.3g}" for bound in (quantile.low, quantile.high))
    return f"{1e3 * quantile.value:.3g} ms ({low} … {high})"


def measure_link(
    device: FramedDevice,
    seconds: float = 2.0,
    rate: float | None = None,
    *,
    realtime: Realtime | None = None,
    progress: Progress | None = None,
) -> LinkMeasurement:
    """Measure the link to an open device by exchanging time stamps; the device must not be in a run.

    Parameters
    ----------
    device
        Open device; no other thread may use it during the measurement.
    seconds
        Duration of the measurement (s, by the link's clock).
    rate
        Highest rate of requests (Hz); None to send each request as soon as the previous reply arrives.
    realtime
        Scheduling of the measuring thread, from `rig.realtime.scheduling.obtained`; use the loop's scheduling.
    progress
        Function that receives the completed share of the measurement (0 to 1), several times per second.

    Raises
    ------
    LinkLostError
        The device does not reply, or the link is lost.
    """
    # Read it first: a device that has just started replies to IDENTIFY only.
    dictionary = device.dictionary
    run = _Run(device, seconds, rate)
    run.warm_up()
    run.perform(realtime, progress)
    return run.measured(dictionary.simulated, dictionary.time_unit_ns)


class _Run:
    def __init__(self, device: FramedDevice, seconds: float, rate: float | None) -> None:
        self._device = device
        self._port = device.link.port()
        self._clock = device.link.clock
        self._duration_ns = round(seconds * 1e9)
        self._rate = rate
        self._period_ns = round(1e9 / (FASTEST_HZ if rate is None else min(rate, FASTEST_HZ)))
        rows = min(LARGEST_TABLE, self._duration_ns // self._period_ns + 1)
        self._exchanges = np.zeros((max(1, rows), len(EXCHANGE)), np.int64)
        self._tally = np.zeros(len(TALLY), np.int64)
        self._tally[TALLY.session] = device.connection.session
        self._tally[TALLY.state_sequence] = -1
        self._buffers = PingBuffers.allocate()
        self._begun_ns = self._ended_ns = 0
        self._stop = threading.Event()
        self._done = threading.Event()
        self._error: BaseException | None = None

    def warm_up(self) -> None:
        """Exchange `WARM_UP` time stamps and reset the counters, so that the costs of first calls are not measured."""
        few = np.zeros((WARM_UP, len(EXCHANGE)), np.int64)
        self._ping(few, self._clock.now_ns() + round(4 * TIMEOUT_S * 1e9))
        kept = (
            TALLY.filled,
            TALLY.session,
            TALLY.sequence,
            TALLY.nonce,
            TALLY.last_sent,
            TALLY.state_sequence,
        )
        for place in set(TALLY) - set(kept):
            self._tally[place] = 0

    def perform(self, realtime: Realtime | None, progress: Progress | None) -> None:
        """Measure the link in a separate thread, as the loop would run, and wait for the end of the measurement."""
        thread = threading.Thread(target=self._body, args=(realtime,), name="rig-ping", daemon=True)
        self._begun_ns = self._clock.now_ns()
        thread.start()
        try:
            while not self._done.wait(POLL_S):
                if progress is not None:
                    progress(min(1.0, (self._clock.now_ns() - self._begun_ns) / self._duration_ns))
        finally:
            self._stop.set()
            # Takes one slice and one timeout at most, after which the compiled function has returned.
            self._done.wait()
            thread.join()
            self._return_link()
        if self._error is not None:
            raise self._error
        if progress is not None:
            progress(1.0)

    def _body(self, realtime: Realtime | None) -> None:
        try:
            take_no_signals()
            if realtime is not None:
                realtime.prefault(self._exchanges)
                realtime.enter_thread()
            end_ns = self._begun_ns + self._duration_ns
            while not self._stop.is_set():
                now_ns = self._clock.now_ns()
                if now_ns >= end_ns or self._tally[TALLY.answered] >= len(self._exchanges):
                    break
                self._ping(self._exchanges, min(end_ns, now_ns + round(SLICE_S * 1e9)))
        except BaseException as error:
            self._error = error
        finally:
            self._ended_ns = self._clock.now_ns()
            self._done.set()

    def _ping(self, exchanges: NDArray[np.int64], until_ns: int) -> None:
        timeout_ns = round(TIMEOUT_S * 1e9)
        result = ping(
            self._port, self._buffers, exchanges, self._tally, until_ns, self._period_ns, timeout_ns
        )
        if result < 0:
            failure = self._device.link.failure()
            raise LinkLostError(
                f"the link to {self._device.link.url.text} was lost ({os.strerror(-result)})",
                remedy="check cable and power, then start again",
                statistics=self._device.connection.statistics,
            ) from failure

    def _return_link(self) -> None:
        """Pass the newest State message's number to the connection, or it counts messages read here as lost."""
        connection, newest = self._device.connection, int(self._tally[TALLY.state_sequence])
        if newest >= 0:
            self._device.take_back(
                next_command=connection.sequence_to_send(messages.Command),
                newest_state=newest,
                state=int(connection.state),
                nonce=self._device.nonce,
            )

    def measured(self, simulated: bool, time_unit_ns: float) -> LinkMeasurement:
        """Return the statistics of the measured round trips; raise `LinkLostError` if the device sent no reply."""
        tally = dict(zip(TALLY._fields, self._tally.tolist(), strict=True))
        if not tally["answered"]:
            raise LinkLostError(
                f"the device at {self._device.link.url.text} did not reply to GetTime within {TIMEOUT_S * 1e3:g} ms",
                remedy="check cable and power, and that the right firmware runs on the device",
                statistics=self._device.connection.statistics,
            )
        exchanges = self._exchanges[: tally["answered"]].copy()
        on_device = (EXCHANGE.device_received, EXCHANGE.device_sent)
        exchanges[:, on_device] = np.rint(exchanges[:, on_device] * time_unit_ns).astype(np.int64)
        whole_ns = exchanges[:, EXCHANGE.host_received] - exchanges[:, EXCHANGE.host_sent]
        kept_ns = exchanges[:, EXCHANGE.device_sent] - exchanges[:, EXCHANGE.device_received]
        trusted = bool((kept_ns >= 0).all() and (kept_ns <= HONEST * whole_ns + 2.0 * time_unit_ns).all())
        travel_ns = np.maximum(whole_ns - kept_ns, 0) if trusted else whole_ns
        duration_s = max(1, self._ended_ns - self._begun_ns) * 1e-9
        return LinkMeasurement(
            url=self._device.link.url.text,
            virtual=self._clock.virtual,
            simulated=simulated,
            duration_s=duration_s,
            asked_rate_hz=self._rate,
            sent=tally["sent"],
            lost=tally["lost"],
            late=tally["late"],
            unsent=tally["unsent"],
            bad_frames=tally["bad_frames"],
            round_trip_s=Distribution.of(whole_ns * 1e-9),
            travel_s=Distribution.of(travel_ns * 1e-9),
            stamps_trusted=trusted,
            bytes_to_device_per_s=tally["bytes_out"] / duration_s,
            bytes_to_host_per_s=tally["bytes_in"] / duration_s,
            capacity_bytes_per_s=self._device.link.bytes_per_second,
            states=tally["states"],
            exchanges=exchanges,
            drive=facts() if (facts := getattr(self._device.link, "bus_facts", None)) else {},
        )
