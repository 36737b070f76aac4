"""The Pico's serial line (whole binary): 3 Mbaud in both directions without a gap."""

from collections.abc import Callable

import numpy as np
import pytest

from firmware_protocol import messages as m
from tests.firmware.rp2040.session import Session

Powered = Callable[..., Session]
BAUD = 3_000_000


def test_the_line_runs_at_the_rate_that_was_asked_for(powered: Powered) -> None:
    # A PL011 requires both ends within 2 %; a USB adapter has an exact rate.
    assert powered().pico.look()["baud"] == pytest.approx(BAUD, rel=0.003)


def test_flood_of_a_host_does_not_stop_the_tick(powered: Powered) -> None:
    session = powered()
    session.configure(position_rate=20_000)
    session.ticks()
    session.pico.send(bytes(range(1, 256)) * 20 + b"\0")
    session.listen(0.02)
    ticks = session.ticks()
    assert np.ptp(np.diff(ticks.at)) <= 12  # cycles
    statistics = session.host.ask(m.GetStatistics(session.host.nonce()))
    assert statistics.framing_errors > 0
    assert session.pico.look()["overruns"] == 0
