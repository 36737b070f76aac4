"""A USB bus in this process, to which Linux attaches a device by USB/IP: enumeration, packets, and faults.

The device has a bulk endpoint each way; its packets pass a SOCK_SEQPACKET, one message each. Format of the messages:
the kernel's Documentation/usb/usbip_protocol.rst, after OP_REP_IMPORT. As on the wire, a transfer in ends with a short
packet, a full buffer or an idle device.
"""

import contextlib
import errno
import select
import socket
import struct
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
HEAD_BYTES = 48
IN_BIT = 0x80
MESSAGE_BYTES = 16384
_BASIC = struct.Struct(">5I")  # command, sequence number, device, direction, endpoint
_SUBMIT = struct.Struct(">Iiiii8s")  # flags, length, start frame, packets, interval, SETUP
_SUBMITTED = struct.Struct(">5I5i8x")  # as _BASIC, then status, length, start frame, packets, errors
_UNLINKED = struct.Struct(">5Ii24x")
_SETUP = struct.Struct("<BBHHH")
_STANDARD_TO_ENDPOINT, _CLEAR_FEATURE, _ENDPOINT_HALT = 0x02, 1, 0


class Shape(Protocol):
    packet: int

    def control(self, setup: bytes) -> bytes | None:
        """Return the data stage of a control request (the 8 bytes of a SETUP packet), or None to stall."""
        ...


@dataclass(slots=True)
class _Transfer:
    sequence: int
    length: int
    data: bytes = b""
    moved: int = 0


@dataclass(slots=True)
class _Endpoint:
    address: int
    waiting: deque[_Transfer] = field(default_factory=deque)
    halted: bool = False
    silent: bool = False

    @property
    def direction_in(self) -> bool:
        return bool(self.address & IN_BIT)


class Bus:
    """A bus with one device; a thread serves it from `start` to `unplug`.

    The other end of `host`, a stream socket that is closed here, goes to vhci_hcd, that of `device` to the device.
    """

    def __init__(self, host: socket.socket, device: socket.socket, shape: Shape) -> None:
        self._host = host
        self._device = device
        self._device.setblocking(False)
        self._shape = shape
        self._endpoints = {address: _Endpoint(address) for address in (0x81, 0x01)}
        self._received = b""
        self._lock = threading.Lock()
        self._wake, self._woken = socket.socketpair()
        self._ending = False
        self._thread = threading.Thread(target=self._serve, name="usb-bus", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def unplug(self) -> None:
        with self._lock:
            self._ending = True
        self._nudge()
        if self._thread.is_alive():
            self._thread.join()
        with contextlib.suppress(OSError):
            self._host.shutdown(socket.SHUT_RDWR)  # a forked process may have inherited it
        for end in (self._host, self._wake, self._woken):
            end.close()

    # ------------------------------------------------------------------ what breaks

    def halt(self, address: int) -> None:
        """Stall an endpoint, until the host clears it."""
        with self._changed(address) as endpoint:
            endpoint.halted = True

    def silence(self, address: int) -> None:
        """Keep the transfers of an endpoint pending, as a device that replies NAK does."""
        with self._changed(address) as endpoint:
            endpoint.silent = True

    @contextlib.contextmanager
    def _changed(self, address: int) -> Iterator[_Endpoint]:
        with self._lock:
            yield self._endpoints[address]
        self._nudge()

    def _nudge(self) -> None:
        with contextlib.suppress(OSError):
            self._wake.send(b"\0")

    # ------------------------------------------------------------------ the bus

    def _serve(self) -> None:
        poll = select.poll()
        poll.register(self._woken, select.POLLIN)
        poll.register(self._host, select.POLLIN)
        # Poll the device's socket only for events that a transfer waits for, or the thread would spin.
        while True:
            with self._lock:
                events = self._device_events()
            if events:
                poll.register(self._device, events)
            ready = {descriptor for descriptor, _ in poll.poll()}
            if events:
                poll.unregister(self._device)
            with self._lock:
                if self._woken.fileno() in ready:
                    self._woken.recv(64)
                if self._ending or not self._step(self._host.fileno() in ready):
                    return

    def _device_events(self) -> int:
        events = 0
        for endpoint in self._endpoints.values():
            if endpoint.waiting and not endpoint.silent:
                events |= select.POLLIN if endpoint.direction_in else select.POLLOUT
        return events

    def _step(self, host_ready: bool) -> bool:
        """Receive from the host and move packets; return False when the host has closed."""
        try:
            if host_ready:
                data = self._host.recv(MESSAGE_BYTES)
                if not data:
                    return False
                self._received += data
                while self._take_message():
                    pass
            for endpoint in self._endpoints.values():
                self._move(endpoint)
        except OSError:
            return False
        return True

    def _take_message(self) -> bool:
        """Remove one complete message from the buffer; return False without one."""
        if len(self._received) < HEAD_BYTES:
            return False
        command, sequence, _, direction_in, number = _BASIC.unpack_from(self._received)
        flags, length, _, _, _, setup = _SUBMIT.unpack_from(self._received, _BASIC.size)
        sent = length if command == SUBMIT and not direction_in else 0
        if len(self._received) < HEAD_BYTES + sent:
            return False
        data = self._received[HEAD_BYTES : HEAD_BYTES + sent]
        self._received = self._received[HEAD_BYTES + sent :]
        if command == UNLINK:
            self._withdraw(sequence, flags)  # the first word is the sequence number of the other
        elif number == 0:
            self._control(sequence, setup, length)
        else:
            endpoint = self._endpoints.get(number | (IN_BIT if direction_in else 0))
            if endpoint is None:
                self._answer(sequence, -errno.EPIPE, 0)
            else:
                endpoint.waiting.append(_Transfer(sequence, length, data))
        return True

    def _control(self, sequence: int, setup: bytes, length: int) -> None:
        kind, request, value, index, _ = _SETUP.unpack(setup)
        cleared = (kind, request, value) == (_STANDARD_TO_ENDPOINT, _CLEAR_FEATURE, _ENDPOINT_HALT)
        if cleared and index in self._endpoints:
            self._endpoints[index].halted = False
        reply = self._shape.control(setup)
        if reply is None:
            self._answer(sequence, -errno.EPIPE, 0)
        elif kind & IN_BIT:
            self._answer(sequence, 0, len(reply[:length]), reply[:length])
        else:
            self._answer(sequence, 0, length)

    def _withdraw(self, sequence: int, withdrawn: int) -> None:
        """Reply to an UNLINK: -ECONNRESET if the transfer was pending, 0 if its reply was already sent."""
        status = 0
        for endpoint in self._endpoints.values():
            for transfer in endpoint.waiting:
                if transfer.sequence == withdrawn:
                    endpoint.waiting.remove(transfer)
                    status = -errno.ECONNRESET
                    break
        self._host.sendall(_UNLINKED.pack(UNLINKED, sequence, 0, 0, 0, status))

    def _move(self, endpoint: _Endpoint) -> None:
        while endpoint.waiting and not endpoint.silent:
            transfer = endpoint.waiting[0]
            if endpoint.halted:
                status, data, length = -errno.EPIPE, b"", 0
            elif endpoint.direction_in:
                done = self._fetch(transfer)
                if done is None:
                    return
                status, data, length = done, transfer.data, len(transfer.data)
            else:
                if not self._deliver(transfer):
                    return
                status, data, length = 0, b"", transfer.moved
            endpoint.waiting.popleft()
            self._answer(transfer.sequence, status, length, data)

    def _fetch(self, transfer: _Transfer) -> int | None:
        """Read packets from the device; return the transfer's status when it is complete, else None."""
        while len(transfer.data) < transfer.length:
            try:
                packet = self._device.recv(self._shape.packet)
            except BlockingIOError:
                return 0 if transfer.data else None
            room = transfer.length - len(transfer.data)
            transfer.data += packet[:room]
            if len(packet) > room:
                return -errno.EOVERFLOW  # "babble": the device sends whole packets, whatever was requested
            if len(packet) < self._shape.packet:
                break
        return 0

    def _deliver(self, transfer: _Transfer) -> bool:
        """Write packets to the device, as many as it accepts; return True when the transfer is complete."""
        while True:
            packet = transfer.data[transfer.moved : transfer.moved + self._shape.packet]
            if not packet:
                return True
            try:
                self._device.send(packet)
            except BlockingIOError:
                return False
            transfer.moved += len(packet)

    def _answer(self, sequence: int, status: int, length: int, data: bytes = b"") -> None:
        head = _SUBMITTED.pack(SUBMITTED, sequence, 0, 0, 0, status, length, 0, 0, 0)
        self._host.sendall(head + data)
