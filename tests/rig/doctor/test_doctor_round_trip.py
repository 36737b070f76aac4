"""Measured round trips: on a link with known delays, in virtual time, on the simulated device, over a port."""

import ctypes
import errno
import math
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rig.devices
from firmware_protocol import messages as m
from firmware_protocol.counters import LinkStatistics
from firmware_protocol.framing import FrameSplitter, encode_frame
from firmware_protocol.packing import pack, unpack
from rig import config
from rig.config import presets
from rig.core.errors import LinkLostError
from rig.devices.device import DeviceUrl
from rig.devices.port import LoopPort
from rig.doctor._round_trip import TIMEOUT_S, WARM_UP, measure_link
from rig.realtime.clock import VirtualClock
from rig.realtime.plugs import TRANSFER_SIGNATURE, WAIT_SIGNATURE, NativeFunction
from tests.conformance.served import served_rig

UNIT_NS = 62.5


class EchoLink:
    """A far end with known delays: request n is answered after `delays[n]` ns, or never if that is None.

    For `kept` ns of these the device holds the request. Requests before the first that counts are answered at once.
    """

    bytes_per_second = 1e6
    url = DeviceUrl.parse("echo://here")

    def __init__(
        self,
        delays: Any,
        *,
        kept: int = 0,
        noise: bytes = b"",
        broken_after: Any = math.inf,
        takes: Any = None,
    ) -> None:
        self.clock = VirtualClock(start_ns=1_000_000)
        self.delays = [0] * WARM_UP + list(delays)
        self.kept, self.noise, self.broken_after = kept, noise, broken_after
        self.takes = takes or (lambda size: size)
        self.asked_at = []
        self._splitter = FrameSplitter(LinkStatistics())
        self._coming = []  # (when, bytes)
        self._there = b""

    def failure(self) -> None:
        return None

    def port(self) -> Any:
        def native(kind: Any, function: Any, signature: Any) -> Any:
            callback = kind(function)
            address = ctypes.cast(callback, ctypes.c_void_p).value
            return NativeFunction(address, signature, keep=callback)

        word = ctypes.c_int64
        transfer = ctypes.CFUNCTYPE(word, word, word, word)
        return LoopPort.on(
            self.clock,
            read=native(transfer, self._read, TRANSFER_SIGNATURE),
            write=native(transfer, self._write, TRANSFER_SIGNATURE),
            wait=native(ctypes.CFUNCTYPE(word, word, word), self._wait, WAIT_SIGNATURE),
            handle=0,
        )

    def _write(self, handle: Any, address: Any, size: Any) -> Any:
        if len(self.asked_at) >= self.broken_after:
            return -errno.ENODEV
        now = self.clock.now_ns()
        taken = self.takes(size)
        if taken < size:
            return taken
        for raw in self._splitter.feed(ctypes.string_at(address, size)):
            _, asked = unpack(raw)
            delay = self.delays[len(self.asked_at)] if len(self.asked_at) < len(self.delays) else 0
            self.asked_at.append(now)
            if delay is None:
                continue
            received = round((now + (delay - self.kept) / 2) / UNIT_NS)
            sent = received + round(min(self.kept, delay) / UNIT_NS)
            answer = m.Time(asked.nonce, asked.host_sent, received, sent)
            self._coming.append((now + delay, self.noise + encode_frame(pack(answer))))
        return size

    def _wait(self, handle: Any, deadline: Any) -> Any:
        self._coming.sort(key=lambda item: item[0])
        if self._coming and self._coming[0][0] <= deadline:
            when, data = self._coming.pop(0)
            self.clock.sleep_until(when)
            self._there += data
        if self._there:
            return 1
        self.clock.sleep_until(deadline)
        return 0

    def _read(self, handle: Any, address: Any, size: Any) -> Any:
        data, self._there = self._there[:size], self._there[size:]
        ctypes.memmove(address, data, len(data))
        return len(data)


def around(link: Any) -> Any:
    dictionary = SimpleNamespace(simulated=False, time_unit_ns=UNIT_NS)
    connection = SimpleNamespace(session=0, statistics=LinkStatistics())
    return SimpleNamespace(link=link, dictionary=dictionary, connection=connection)


def measured(link: Any, seconds: float = 1.0, rate: int = 1000, **more: Any) -> Any:
    return measure_link(around(link), seconds, rate, **more)


def test_delays_come_back_as_they_are() -> None:
    """990 delays of 200 µs, 9 of 500 µs and one of 3 ms, so every quantile is known."""
    delays = np.full(1000, 200_000)
    delays[5:955:106] = 500_000
    delays[500] = 3_000_000
    link = EchoLink(delays)
    found = measured(link, 1.01)
    assert found.sent >= 1000
    trip = found.round_trip_s
    assert (trip.p50.value, trip.p99.value) == (pytest.approx(200e-6), pytest.approx(200e-6))
    assert trip.p999.value == pytest.approx(500e-6)
    assert trip.maximum == pytest.approx(3e-3)
    assert (found.lost, found.late, found.bad_frames) == (0, 0, 0)
    host_sent = found.exchanges[:, 0]
    assert (host_sent == link.asked_at[WARM_UP:]).all()
    expected = np.append(delays, np.zeros(20))[: len(host_sent)]
    assert found.exchanges[:, 3] - host_sent == pytest.approx(expected)


@pytest.mark.parametrize("rate", [100, 1000, 7000])
def test_the_host_asks_at_the_given_rate_for_the_given_time(rate: int) -> None:
    link = EchoLink([10_000] * 8000)
    found = measured(link, 0.5, rate)
    assert found.duration_s == pytest.approx(0.5, abs=2e-3)
    assert found.sent == pytest.approx(0.5 * rate, abs=1 + 0.002 * rate)
    assert np.diff(link.asked_at[WARM_UP:]).min() >= 1e9 // rate - 1
    assert found.bytes_to_device_per_s == pytest.approx(22 * rate, rel=0.03)
    assert found.capacity_bytes_per_s == 1e6


def test_time_in_the_device_is_not_travel() -> None:
    found = measured(EchoLink([900_000] * 1000, kept=800_000))
    assert found.stamps_trusted
    assert found.round_trip_s.p50.value == pytest.approx(900e-6)
    assert found.travel_s.p50.value == pytest.approx(100e-6, abs=1e-6)
    assert [found.delay_ticks(rate) for rate in (1000, 9000, 11_000)] == [0, 0, 0]  # virtual time has none


def test_impossible_stamps_are_not_trusted() -> None:
    """The device's stamps give a longer time than the whole round trip."""
    device = around(EchoLink([100_000] * 1000, kept=50_000))
    device.dictionary.time_unit_ns = -UNIT_NS  # its time runs backwards
    found = measure_link(device, 1.0, 1000)
    assert not found.stamps_trusted
    assert found.travel_s == found.round_trip_s


def test_questions_without_an_answer_are_lost_and_answers_behind_the_time_are_late() -> None:
    delays = [100_000] * 1000
    delays[10] = delays[20] = None
    delays[30] = round((TIMEOUT_S + 0.01) * 1e9)
    found = measured(EchoLink(delays))
    assert (found.lost, found.late) == (3, 1)
    assert found.loss_share == pytest.approx(3 / found.sent)
    assert found.round_trip_s.maximum < TIMEOUT_S


def test_noise_between_the_frames_is_counted_and_hurts_nothing() -> None:
    found = measured(EchoLink([100_000] * 500, noise=b"\x07noise\0"))
    assert found.bad_frames == found.sent
    assert found.lost == 0


def test_a_line_that_is_full_now_and_then_is_counted_apart_from_losses() -> None:
    calls = iter(range(100_000))
    found = measured(EchoLink([100_000] * 2000, takes=lambda size: 0 if next(calls) % 10 == 0 else size))
    assert found.unsent > 50
    assert found.lost == 0


def test_a_broken_link_is_an_error_with_a_remedy() -> None:
    with pytest.raises(LinkLostError, match="the link to echo://here was lost") as caught:
        measured(EchoLink([0] * 1000, broken_after=100))
    assert "cable" in caught.value.remedy


def test_a_link_without_replies_ends_in_time() -> None:
    link = EchoLink([None] * 1000)
    with pytest.raises(LinkLostError, match="did not reply"):
        measured(link, 0.3)
    assert link.clock.now_ns() < 2e9


def test_progress_rises_to_one_and_what_it_raises_ends_the_measurement() -> None:
    shares = []
    measured(EchoLink([100_000] * 100), 0.1, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0

    def stop(share: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        measured(EchoLink([100_000] * 700_000), 600.0, progress=stop)
    assert not [thread for thread in threading.enumerate() if thread.name == "rig-ping"]


# ---------------------------------------------------------------------- the simulated device


def test_virtual_time_has_no_delay_and_the_device_is_as_before() -> None:
    with rig.devices.open_device("sim://koul-compliant") as device:
        found = measure_link(device, 0.5, 2000)
        assert found.virtual
        assert found.simulated
        assert found.round_trip_s.maximum == 0.0
        assert found.delay_ticks(20_000) == 0
        assert math.isinf(found.loop_rate_hz)
        assert found.sent == pytest.approx(1000, abs=3)
        assert found.states == pytest.approx(50, abs=2)  # an unarmed device sends STATE at 100 Hz
        assert device.count() == 0
        assert device.connection.statistics.lost == 0


@pytest.fixture
def port() -> Iterator[Any]:
    """Serve a simulated rig behind a pseudo-terminal and yield its URL."""
    with served_rig(config.rig_model(presets.load("koul-compliant")), rate=1000) as path:
        yield f"serial://{path}"


def test_over_a_port_a_trip_takes_some_time_and_the_line_is_in_order_afterwards(port: Any) -> None:
    with rig.devices.open_device(port) as device:
        found = measure_link(device, 0.2)
        assert not found.virtual
        assert found.sent > 5
        assert found.round_trip_s.p50.value > 0.0
        assert found.travel_s.maximum <= found.round_trip_s.maximum
        assert found.delay_ticks(1000) >= 1
        assert found.delay_ticks(1000) == math.ceil(1000 * found.travel_s.almost_all)
        assert device.count() == 0
        assert len(device.exchange_clock(4)) == 4
    assert not [thread for thread in threading.enumerate() if thread.name == "rig-ping"]


class Babbler(EchoLink):
    """A far end that sends without pause: after each read more bytes are available."""

    def _wait(self, handle: Any, deadline: Any) -> Any:
        return 1

    def _read(self, handle: Any, address: Any, size: Any) -> Any:
        self.clock.sleep_until(self.clock.now_ns() + 100_000)
        ctypes.memset(address, 1, size)
        return size


def test_a_far_end_that_never_pauses_ends_the_measurement_and_does_not_hold_it() -> None:
    with pytest.raises(LinkLostError, match="did not reply"):
        measure_link(around(Babbler([])), 0.1)
