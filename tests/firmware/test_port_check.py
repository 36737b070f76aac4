"""The port to this computer fulfils its duties, and each defective port is detected by the duty that it violates."""

import ctypes
import re
from ctypes import CDLL

import pytest

import rig.cli
from firmware_protocol.duties import Duty, duties
from rig.core.check import Check, Outcome
from rig.core.errors import ConfigError, LinkLostError
from rig.firmware._port_check import STEPS, PortCheck, PortCheckRequest, check_port, failure
from tests.conformance.tiers import first_by_default
from tests.firmware import simulated_port
from tests.firmware.simulated_port import Run, SimulatedPort, powered_up, wrong_ports

REQUEST = PortCheckRequest(current=400, wired=True, seconds=0.5, bootloader=True)
DUTIES = {duty.name: duty for duty in duties()}


@pytest.fixture(scope="module")
def board(library: CDLL) -> CDLL:
    return simulated_port.board_with(library)


def checked(board: CDLL, spoilt: str = "", request: PortCheckRequest = REQUEST) -> PortCheck:
    link = SimulatedPort(powered_up(board, spoilt))
    return check_port(lambda: link, request)


def broken(found: PortCheck) -> dict[str, Check]:
    return {one.name.replace(" ", "_"): one for one in found.checks if one.outcome is Outcome.REFUSED}


def test_every_duty_has_a_check_and_a_port_that_breaks_it() -> None:
    assert sorted(name for names in STEPS.values() for name in names) == sorted(DUTIES)
    assert {name.partition("__")[0] for name in wrong_ports()} == set(DUTIES)


def test_the_port_to_this_computer_keeps_every_duty(board: CDLL) -> None:
    found = checked(board)
    assert [one for one in found.checks if one.outcome is not Outcome.OK] == []
    assert len(found.checks) == len(DUTIES)
    assert found.passed
    assert failure(found) is None


def is_message_of(duty: Duty, text: str) -> bool:
    """Return True if a text is the message of a duty, with numbers filled in."""
    pieces = map(re.escape, re.split(r"\{[^}]*\}", duty.broken))
    return re.fullmatch(".*".join(pieces), text) is not None


FIRST = {name.partition("__")[0]: name for name in reversed(wrong_ports())}  # of each duty


@pytest.mark.parametrize(
    "wrong", first_by_default(sorted(wrong_ports(), key=lambda n: n not in FIRST.values()), len(FIRST))
)
def test_a_wrong_port_is_found_by_the_duty_that_it_breaks(board: CDLL, wrong: str) -> None:
    found = checked(board, f"wrong_{wrong}")
    duty = DUTIES[wrong.partition("__")[0]]
    reasons = broken(found)
    assert list(reasons) == [duty.name], {name: one.text for name, one in reasons.items()}
    assert is_message_of(duty, reasons[duty.name].text)
    error = failure(found)
    assert error is not None
    assert error.message == f"duty broken: {reasons[duty.name].text}"
    assert error.remedy == duty.remedy


def was_on(board: CDLL) -> tuple[bool, bool]:
    """Return whether the amplifier was ever on, and whether it is on."""
    ever, now = (ctypes.c_bool.in_dll(board, name).value for name in ("ever_on", "is_on"))
    return ever, now


def test_check_without_consent_switches_nothing_on_and_names_the_missing_options(board: CDLL) -> None:
    found = checked(board, "watch_enable", PortCheckRequest(seconds=0.1))
    assert was_on(board) == (False, False)
    unseen = {one.name: one.text for one in found.checks if one.outcome is not Outcome.OK}
    assert found.passed
    for name, option in (
        ("time width", "`seconds`"),
        ("edge time", "`wired`"),
        ("zero at once", "`current`"),
        ("bootloader", "`bootloader`"),
    ):
        assert option in unseen[name]


def test_behind_a_check_with_a_current_the_amplifier_is_off(board: CDLL) -> None:
    checked(board, "watch_enable")
    assert was_on(board) == (True, False)


@pytest.mark.parametrize("wrong", ["time_unit", "tick_rate", "watchdog_bites__never"])
def test_no_current_flows_before_time_tick_and_watchdog_are_right(board: CDLL, wrong: str) -> None:
    found = checked(board, f"wrong_{wrong}")
    current = [one for one in found.checks if one.name in ("zero at once", "measured flows")]
    assert [one.outcome for one in current] == [Outcome.SKIPPED] * 2


def test_a_current_above_the_rigs_limit_is_refused(board: CDLL) -> None:
    with pytest.raises(ConfigError, match="current = 2001"):
        checked(board, "watch_enable", PortCheckRequest(current=2_001))
    assert was_on(board) == (False, False)


def silent_after(run: Run, questions: int) -> Run:
    """Return a board that stops replying after some requests."""
    asked = 0

    def reply(us: int, data: bytes) -> bytes:
        nonlocal asked
        asked += bool(data)
        sent = run(us, data)
        return sent if asked <= questions else b""

    return reply


def test_board_that_stops_replying_breaks_the_duty_in_test_and_skips_the_rest(board: CDLL) -> None:
    link = SimulatedPort(silent_after(powered_up(board), 3))
    found = check_port(lambda: link, PortCheckRequest(seconds=0.1))
    texts = {one.name: one.text for one in found.checks}
    assert list(broken(found)) == ["time_of_timer", "tick_rate", "tick_grid"]
    assert texts["tick rate"].startswith("no reply during the test of set_rate")
    assert texts["write whole"] == "the board no longer replies"


def test_silent_port_is_a_lost_link_with_the_image_to_flash(board: CDLL) -> None:
    link = SimulatedPort(silent_after(powered_up(board), 0))
    with pytest.raises(LinkLostError, match="no reply at") as caught:
        check_port(lambda: link, PortCheckRequest())
    assert "--check-port" in caught.value.remedy


def test_the_command_says_the_duty_that_is_broken(
    board: CDLL, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    link = SimulatedPort(powered_up(board, "wrong_zero_at_once"))
    monkeypatch.setattr("rig.cli.firmware.open_link", lambda _url: link)
    code = rig.cli.run(["firmware", "check-port", "test://", "--current", "400", "--seconds", "0.5"])
    out, err = capfd.readouterr()
    assert code == 5
    assert "ok off at once" in out
    assert "duty broken: set_current(0) does not act at once: 2 ms" in err
