"""The conformance suite of `rig.devices.device.Link`, in virtual and in real time."""

from collections.abc import Callable
from contextlib import closing
from typing import Any

import numba
import numpy as np
import pytest
from numba import types

from firmware_protocol import messages as m
from rig.core.errors import LinkLostError
from rig.core.sample import TRUTH
from rig.devices.device import Link
from rig.realtime.kernel import kernel, prepare
from rig.realtime.plugs import TRANSFER, WAIT
from tests.conformance.host import Host

MakeLink = Callable[[], Link]
SHORT_S = 0.02
# Plug points are function types of compiled code; else only Python's side runs.
COMPILED = not numba.config.DISABLE_JIT


def check_link(make_link: MakeLink, make_silent_link: MakeLink, *, slack_s: float = 0.0) -> None:
    """Check links to a device that replies to IDENTIFY, and one whose far end sends nothing.

    A call may return `slack_s` later than its timeout: 0 in virtual time.
    """
    prepare(give, listen)  # compiling takes longer than a reply
    checks = (_carries_a_conversation, _carries_single_bytes, _serves_the_compiled_loop, _is_gone_when_closed)
    for check in checks:
        with closing(make_link()) as link:
            check(link)
    with closing(make_silent_link()) as link:
        _waits_no_longer_than_asked(link, slack_s)


def _carries_a_conversation(link: Link) -> None:
    host = Host(link)
    before_ns = link.clock.now_ns()
    host.read_dictionary()
    for _ in range(3):
        host.identify()
    assert link.clock.now_ns() >= before_ns
    assert link.failure() is None
    truth = link.truth()
    assert truth is None or truth.dtype == TRUTH


def _carries_single_bytes(link: Link) -> None:
    host = Host(link)
    nonce = host.nonce()
    for byte in host.connection.send(m.Identify(nonce, 0)):
        link.write(bytes([byte]))
    assert host.answer(nonce).nonce == nonce
    link.write(b"")


def _serves_the_compiled_loop(link: Link) -> None:
    """The same conversation works through the plug functions of the compiled loop."""
    if not COMPILED:
        return
    host = Host(link)
    request = np.frombuffer(host.connection.send(m.Identify(host.nonce(), 0)), np.uint8).copy()
    answer = np.zeros(4096, np.uint8)
    port = link.port()
    assert give(port.write, port.handle, request) == len(request)
    messages: list[object] = []
    for _ in range(100):  # a STATE may come first
        size = listen(port.read, port.wait, port.handle, answer, link.clock.now_ns() + 1_000_000_000)
        assert size > 0, f"errno {-size}"
        host.connection.receive_data(answer[:size].tobytes())
        while (event := host.connection.next_event()) is not None:
            messages.append(event.message)  # type: ignore[union-attr]
        if any(isinstance(message, m.Identity) for message in messages):
            break
    assert any(isinstance(message, m.Identity) for message in messages)
    assert link.failure() is None


def _is_gone_when_closed(link: Link) -> None:
    link.close()
    link.close()
    with pytest.raises(LinkLostError):
        link.read(SHORT_S)
    with pytest.raises(LinkLostError):
        link.write(b"\0")


def _waits_no_longer_than_asked(link: Link, slack_s: float) -> None:
    slack_ns = round(slack_s * 1e9)
    before_ns = link.clock.now_ns()
    assert link.read(SHORT_S) == b""
    assert link.read(0.0) == b""
    waited_ns = link.clock.now_ns() - before_ns
    assert round(SHORT_S * 1e9) - 1_000_000 <= waited_ns <= round(SHORT_S * 1e9) + slack_ns
    if not COMPILED:
        return
    port = link.port()
    nothing = np.zeros(16, np.uint8)
    deadline_ns = link.clock.now_ns() + round(SHORT_S * 1e9)
    got = listen(port.read, port.wait, port.handle, nothing, deadline_ns)
    assert got == 0
    assert deadline_ns <= link.clock.now_ns() <= deadline_ns + slack_ns
    assert port.now(port.clock_handle) >= deadline_ns


_BYTES = types.uint8[::1]


@kernel(types.int64(TRANSFER, types.int64, _BYTES))
def give(write: Any, handle: Any, data: Any) -> Any:  # type: ignore[no-untyped-def]
    """Write once, as the loop does; return the bytes written or negative errno."""
    return write(handle, data.ctypes.data + 0, len(data))


@kernel(types.int64(TRANSFER, WAIT, types.int64, _BYTES, types.int64))
def listen(read: Any, wait: Any, handle: Any, into: Any, deadline_ns: Any) -> Any:  # type: ignore[no-untyped-def]
    """Wait until a deadline and read; return the number of bytes, 0, or negative errno."""
    ready = wait(handle, deadline_ns)
    if ready <= 0:
        return ready
    return read(handle, into.ctypes.data + 0, len(into))  # + 0: an address is unsigned, a plug takes int64
