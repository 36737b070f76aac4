"""The simulated rig as a USB device: its descriptors, parsed independently, and its pipes."""

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import messages as m
from firmware_protocol.connection import Connection
from rig.core.errors import ConfigError
from sim_backend.ends import usb
from sim_backend.ends.usb import HIGH_SPEED_PACKET, UsbPort, UsbShape
from tests.conformance.rigs import rotary_rig
from tests.conformance.started import WAIT_S


@pytest.fixture
def pipe() -> Iterator[Any]:
    """Yield the device's end and the host's end of a USB pipe."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    yield ours, theirs
    ours.close()
    theirs.close()


def descriptors(data: bytes) -> list[bytes]:
    """Split a configuration into descriptors by their length bytes."""
    parts = []
    while data:
        assert 2 <= data[0] <= len(data)
        parts.append(data[: data[0]])
        data = data[data[0] :]
    return parts


@pytest.mark.parametrize("packet", [64, 512])
def test_the_configuration_is_one_vendor_interface_with_a_bulk_endpoint_each_way(packet: int) -> None:
    whole = UsbShape(packet=packet).configuration()
    configuration, interface, incoming, outgoing = descriptors(whole)
    assert configuration[1] == 2
    assert struct.unpack_from("<H", configuration, 2) == (len(whole),)
    assert (interface[1], interface[4], interface[5]) == (4, 2, 0xFF)
    for end, address in ((incoming, 0x81), (outgoing, 0x01)):
        assert (end[1], end[2], end[3] & 3) == (5, address, 2)
        assert struct.unpack_from("<H", end, 4) == (packet,)


def test_the_device_descriptor_names_vendor_product_and_strings() -> None:
    shape = UsbShape(vendor=0xABCD, product=0x1234, serial="Ä7")
    device = shape.device()
    assert (len(device), device[0], device[1]) == (18, 18, 1)
    assert struct.unpack_from("<HH", device, 8) == (0xABCD, 0x1234)
    for index in device[14:17]:
        text = shape.string(index)
        assert text is not None
        assert (text[0], text[1]) == (len(text), 3)
    assert shape.string(device[16])[2:].decode("utf-16-le") == "Ä7"
    assert shape.string(9) is None


def setup(direction: int, request: int, value: int = 0, length: int = 0) -> bytes:
    return struct.pack("<BBHHH", direction, request, value, 0, length)


def test_standard_requests_are_answered_and_others_stalled() -> None:
    shape = UsbShape()
    assert shape.control(setup(0x80, 6, 0x0100, 64)) == shape.device()
    assert shape.control(setup(0x80, 6, 0x0100, 8)) == shape.device()[:8]
    assert shape.control(setup(0x80, 6, 0x0200, 255)) == shape.configuration()
    assert shape.control(setup(0x80, 6, 0x0303, 255)) == shape.string(3)
    assert shape.control(setup(0x80, 6, 0x0600, 10)) is None  # no qualifier: one speed only
    assert shape.control(setup(0x80, 0, 0, 2)) == b"\0\0"
    assert shape.control(setup(0x80, 8, 0, 1)) == b"\x01"
    assert shape.control(setup(0x00, 9, 1)) == b""
    assert shape.control(setup(0x02, 1)) == b""
    assert shape.control(setup(0xC0, 0x51)) is None


@given(st.binary(min_size=8, max_size=8))
def test_no_request_is_answered_with_more_than_it_asks_for(request: bytes) -> None:
    answer = UsbShape().control(request)
    assert answer is None or len(answer) <= struct.unpack_from("<H", request, 6)[0]


def test_frames_are_cut_into_packets_and_keep_their_order(pipe: Any) -> None:
    ours, theirs = pipe
    port = UsbPort(ours)
    port.write(bytes(range(150)))
    assert [theirs.recv(4096) for _ in range(3)] == [
        bytes(range(64)),
        bytes(range(64, 128)),
        bytes(range(128, 150)),
    ]


def test_a_host_that_fetches_nothing_costs_the_device_nothing(pipe: Any) -> None:
    """A few packets stay queued, newer ones are dropped whole, and the queued ones arrive in order."""
    ours, theirs = pipe
    port = UsbPort(ours)
    for number in range(1000):
        port.write_if_free(bytes([number % 256]) * 44)
    theirs.setblocking(False)
    got = []
    with contextlib.suppress(BlockingIOError):
        while True:
            got.append(theirs.recv(4096))
    assert 1 <= len(got) < 100
    assert [packet[0] for packet in got] == list(range(len(got)))
    assert all(len(packet) == 44 for packet in got)


def test_answers_wait_for_the_host_up_to_a_limit(pipe: Any) -> None:
    ours, theirs = pipe
    port = UsbPort(ours, HIGH_SPEED_PACKET)
    for _ in range(100):
        port.write(bytes(500))
    assert len(port._pending) <= usb.PENDING_BYTES
    theirs.recv(4096)
    waiting = len(port._pending)
    port.write(b"")
    assert len(port._pending) < waiting


def test_reading_ends_at_the_deadline_and_an_unplugged_bus_is_silence(pipe: Any) -> None:
    ours, theirs = pipe
    port = UsbPort(ours)
    deadline_ns = time.monotonic_ns() + 20_000_000
    assert port.read(deadline_ns) == b""
    assert time.monotonic_ns() >= deadline_ns
    theirs.send(b"packet")
    assert port.read(time.monotonic_ns() + 1_000_000_000) == b"packet"
    theirs.close()
    assert port.read(time.monotonic_ns() + 1_000_000_000) == b""
    assert port.unplugged
    deadline_ns = time.monotonic_ns() + 20_000_000
    assert port.read(deadline_ns) == b""
    assert time.monotonic_ns() >= deadline_ns
    port.write(b"lost")


def test_a_rig_answers_through_the_pipes(pipe: Any) -> None:
    ours, theirs = pipe
    stop = threading.Event()
    rig = threading.Thread(
        target=usb.serve, args=(rotary_rig(), ours), kwargs={"stop_event": stop}, daemon=True
    )
    rig.start()
    connection = Connection(m.Role.HOST)
    theirs.settimeout(WAIT_S)
    theirs.send(connection.send(m.Identify(7, 0)))
    answer = None
    while not isinstance(getattr(answer, "message", None), m.Identity):
        connection.receive_data(theirs.recv(4096))
        answer = connection.next_event()
    assert answer.message.nonce == 7
    stop.set()
    rig.join(WAIT_S)
    assert not rig.is_alive()
    with pytest.raises(ConfigError, match="4001 Hz is outside 50 … 4000"):
        usb.serve(rotary_rig(), ours, rate=4_001)
