"""The port to this computer keeps its duties, and each wrong one is found by the duty that it breaks, in its words."""

from __future__ import annotations

import ctypes
import re

import pytest

from firmware_protocol.duties import Duty, duties
from rig.bench.firmware.port_check import STEPS, PortCheck, PortCheckRequest, check_port, failure
from rig.core.check import Check, Outcome
from tests.firmware import simulated_port
from tests.firmware.simulated_port import SimulatedPort, wrong_ports

REQUEST = PortCheckRequest(current=400, wired=True, seconds=1.1, bootloader=True)
DUTIES = {duty.name: duty for duty in duties()}


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory, library: ctypes.CDLL) -> ctypes.CDLL:
    return simulated_port.compile_board(tmp_path_factory.mktemp("board"), library)


def checked(board: ctypes.CDLL, wrong: str = "", request: PortCheckRequest = REQUEST) -> PortCheck:
    link = SimulatedPort(board, wrong)
    return check_port(lambda: link, request)  # type: ignore[arg-type, return-value]


def broken(found: PortCheck) -> dict[str, Check]:
    return {one.name.replace(" ", "_"): one for one in found.checks if one.outcome is Outcome.REFUSED}


def test_every_duty_has_a_check_and_a_port_that_breaks_it() -> None:
    assert sorted(name for names in STEPS.values() for name in names) == sorted(DUTIES)
    assert {name.partition("__")[0] for name in wrong_ports()} == set(DUTIES)


def test_the_port_to_this_computer_keeps_every_duty(board: ctypes.CDLL) -> None:
    found = checked(board)
    assert [one for one in found.checks if one.outcome is not Outcome.OK] == []
    assert len(found.checks) == len(DUTIES)
    assert found.passed
    assert failure(found) is None


def said(duty: Duty, text: str) -> bool:
    """Whether a sentence is the duty's own, with numbers in it."""
    pieces = map(re.escape, re.split(r"\{[^}]*\}", duty.broken))
    return re.fullmatch(".*".join(pieces), text) is not None


@pytest.mark.parametrize("wrong", wrong_ports())
def test_a_wrong_port_is_found_by_the_duty_that_it_breaks(board: ctypes.CDLL, wrong: str) -> None:
    found = checked(board, wrong)
    duty = DUTIES[wrong.partition("__")[0]]
    reasons = broken(found)
    assert list(reasons) == [duty.name], {name: one.text for name, one in reasons.items()}
    assert said(duty, reasons[duty.name].text)
    print(reasons[duty.name].text)
    error = failure(found)
    assert error is not None
    assert error.message == f"duty broken: {reasons[duty.name].text}"
    assert error.remedy == duty.remedy
