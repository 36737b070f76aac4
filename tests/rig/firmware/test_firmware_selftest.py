"""The self-test passes on a sound device and finds each defect; the motor never moves."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.dictionary import build
from firmware_protocol.faults import Fault, Status
from firmware_protocol.packing import pack_batch_samples
from rig.config import presets
from rig.core.check import Outcome
from rig.core.errors import DeviceRefusedError
from rig.core.present import plain
from rig.devices import open_device
from rig.firmware._selftest import SelfTestRequest, failure, selftest
from rig.firmware._stream import judge_stream

DICTIONARY = build(device="mine", firmware="1", simulated=False, current_quantum_a=0.001)
REQUEST = SelfTestRequest(rate=2_000, seconds=0.1)


@pytest.fixture
def device() -> Iterator[Any]:
    with open_device("sim://koul-rigid") as opened:
        yield opened


def outcome(device: Any, name: Any, request: Any = REQUEST) -> Any:
    found = {check.name: check for check in selftest(device, request).checks}
    return found[name]


def test_a_sound_device_passes_and_is_left_as_it_was(device: Any) -> None:
    before = device.active_parameters()
    steps = []
    request = replace(REQUEST, experiment=presets.load("koul-rigid"))
    found = selftest(device, request, lambda what, share: steps.append((what, share)))
    assert found.passed
    assert failure(found) is None
    assert [check.outcome for check in found.checks if check.name not in ("encoder", "stream")] == [
        Outcome.OK
    ] * 9
    assert device.active_parameters() == before
    assert [what for what, _ in steps] == [check.name for check in found.checks]
    assert plain(found)["passed"] is True


def test_a_check_without_reply_does_not_fail_the_next(device: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    silent = False
    write = device.link.write
    monkeypatch.setattr(device.link, "write", lambda frame: None if silent else write(frame))

    def progress(what: str, _share: float) -> None:
        nonlocal silent
        silent = what == "parameters"

    found = {check.name: check for check in selftest(device, REQUEST, progress).checks}
    assert "no reply to" in found.pop("parameters").text
    assert [check for check in found.values() if check.outcome == Outcome.REFUSED] == []


def test_the_image_of_another_rig_is_found(device: Any) -> None:
    check = outcome(device, "rig", replace(REQUEST, experiment=presets.load("chawda-linear")))
    assert check.outcome == Outcome.REFUSED
    assert "motion" in check.text
    assert "--rig chawda-linear" in check.remedy


def test_a_fault_of_an_earlier_run_is_reported_and_cleared(device: Any) -> None:
    device.link.device.inject_fault(Fault.OVER_CURRENT)
    check = outcome(device, "fault memory")
    assert check.outcome == Outcome.OK
    assert "OVER_CURRENT" in check.text
    assert device.connection.state == State.CONFIGURED


@pytest.mark.parametrize(
    ("name", "method", "value"), [("refusals", "status_of", Status.OK), ("ticks", "states", [])]
)
def test_a_defect_is_found(
    device: Any, monkeypatch: pytest.MonkeyPatch, name: str, method: str, value: Any
) -> None:
    monkeypatch.setattr(device, method, lambda *_args, **_named: value)
    monkeypatch.setattr(device, "disarm", lambda **_named: None)
    check = outcome(device, name)
    assert check.outcome == Outcome.REFUSED
    assert check.remedy


@pytest.mark.parametrize(
    "spoil",
    [
        lambda state: replace(
            state, device_time=(state.device_time + 90 * (state.sample_index % 64)) % 2**32
        ),
        lambda state: replace(state, device_time=state.device_time * 1001 // 1000 % 2**32),
        lambda state: replace(state, missed_ticks=state.sample_index % 1000),
    ],
    ids=["jitter", "rate", "missed"],
)
def test_irregular_ticks_are_found(device: Any, monkeypatch: pytest.MonkeyPatch, spoil: Any) -> None:
    honest = device.states
    monkeypatch.setattr(device, "states", lambda seconds: [spoil(state) for state in honest(seconds)])
    assert outcome(device, "ticks").outcome == Outcome.REFUSED


def test_damaged_frames_are_found(device: Any) -> None:
    device.identify()
    device.link.write(b"\x03\x05\x07\x00")
    check = outcome(device, "link")
    assert check.outcome == Outcome.REFUSED
    assert "1 frames that the device could not read" in check.text
    error = failure(selftest(device, REQUEST))
    assert isinstance(error, DeviceRefusedError)
    assert "link" in error.message


def test_a_hand_on_the_handle_is_seen(device: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.firmware._selftest.MOVE_LOOKS", 10)
    request = replace(REQUEST, move=True)
    assert outcome(device, "encoder", request).outcome == Outcome.REFUSED
    device.link.device.hardware.external_effort = 0.5
    check = outcome(device, "encoder", request)
    assert check.outcome == Outcome.OK, check.text
    device.link.device.hardware.external_effort = 0.0


def batch(first: Any, samples: Any, base: int = 100) -> Any:
    return m.Batch(first, 0, base, 0, pack_batch_samples(0, samples))


def state(index: Any, **fields: Any) -> Any:
    values = dict.fromkeys(m.State.__dataclass_fields__, 0)
    return m.State(**{**values, "sample_index": index, **fields})


WHOLE = [batch(2**32 - 2, [(1, 0, 3)] * 2), state(1, count=104), batch(0, [(1, 0, 3)] * 2, 102)]


@pytest.mark.parametrize(
    ("messages", "ticks", "outcome", "text"),
    [
        (WHOLE, 4, Outcome.OK, "4 samples in 2 frames, 0 gaps"),
        (WHOLE, 40, Outcome.REFUSED, "instead of 40"),
        ([WHOLE[0], batch(1, [(0, 0, 0)])], 3, Outcome.REFUSED, "1 gaps"),
        ([*WHOLE, state(0, count=9)], 4, Outcome.REFUSED, "different counts in 1 ticks"),
        ([*WHOLE, batch(2, [(0, 5, 0)])], 4, Outcome.REFUSED, "set a current"),
        ([*WHOLE, state(7, fault=int(Fault.LINK_LOST))], 4, Outcome.REFUSED, Fault.LINK_LOST.text),
    ],
)
def test_samples_of_its_own_law_are_judged(messages: list[str], ticks: int, outcome: Any, text: Any) -> None:
    check = judge_stream(messages, ticks, 1_000, DICTIONARY)
    assert check.outcome == outcome
    assert text in check.text


@pytest.mark.parametrize(("share", "outcome"), [(0.79, Outcome.OK), (0.81, Outcome.REFUSED)])
def test_a_law_that_leaves_too_little_of_a_period_is_found(share: float, outcome: Any) -> None:
    period = 1e9 / DICTIONARY.time_unit_ns / 1_000
    worst = state(0, count=103, execution_time=round(share * period))
    check = judge_stream([*WHOLE, worst, state(7)], 4, 1_000, DICTIONARY)
    assert check.outcome == outcome
    assert f"{100 * share:.0f} % of a period (homing only" in check.text
