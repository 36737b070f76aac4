"""`rig doctor`, the check before arming and `rig hit` agree on all simulated boards, loops, rates and walls."""

import json
from collections.abc import Callable, Iterator
from itertools import cycle, product
from pathlib import Path
from typing import Any, cast

import pytest

import rig
from rig import config
from rig.cli.hit import hit as command
from rig.config import presets
from rig.core.check import refuse
from rig.core.errors import PlanError
from rig.devices.framed import FramedDevice
from rig.doctor import gate as gates
from rig.doctor.gate import check_armable
from rig.experiments.hits import examine as examining
from rig.experiments.hits import hit as hits
from rig.experiments.hits._on_device import OnDevice, Trials
from rig.experiments.hits.admission import admission_checks, admit
from rig.experiments.hits.examine import Examination, ExaminationRequest
from rig.experiments.hits.hit import HitRequest, in_effect
from rig.experiments.trials.preparation import prepared_on
from rig.session.engine._hits import DeviceRunner
from rig.testing import hits as hits_of_tests
from sim_backend.board.make_device import make_device
from sim_backend.ends.link import MemoryLink
from sim_backend.ends.pty import FIRMWARE_RATE_MAXIMUM, POSITION_RATE_MAXIMUM
from tests.conformance.claimed import claim_to_be_real
from tests.conformance.firmware import need_compiler
from tests.conformance.gated import REFUSED, SLOW_S, Pushed, Started, end_before_the_pulse, open_as_real
from tests.conformance.made_links import link as made_link
from tests.conformance.tiers import first_by_default

RUN_BY = (("host", 1000), ("host", 20_000), ("device", 20_000))
MOTOR = {"host.realtime": "off", "trial.minimum_rest_counts": 0.0}
WALLS = {"calm": (20.0, 0.02), "unstable": (5000.0, 0.1), "deeper than the window": (0.05, 0.0)}
SLOW_PORT = 92_160.0  # bytes/s, of a serial line at 921600 baud
FIRMWARE = "rig serve rig --firmware"
SERVED = {  # `rig serve rig`, with and without --firmware, over a fast and a slow port; and without a compiler
    "rig serve rig": (None, POSITION_RATE_MAXIMUM, None),
    "rig serve rig, slow port": (None, POSITION_RATE_MAXIMUM, SLOW_PORT),
    FIRMWARE: (True, FIRMWARE_RATE_MAXIMUM, None),
    "rig serve rig --firmware, slow port": (True, FIRMWARE_RATE_MAXIMUM, SLOW_PORT),
    "without a compiler": (False, POSITION_RATE_MAXIMUM, None),
}


def board_behind_link(
    experiment: config.Experiment, firmware: bool | None, maximum: int, capacity: float | None
) -> FramedDevice:
    """Return a simulated board behind a link whose time counts as real."""
    if firmware is not False:
        need_compiler()
    device, _ = make_device(
        config.rig_model(experiment), firmware, position_rate_default=1000, position_rate_maximum=maximum
    )
    link = MemoryLink(device)
    link.clock.virtual = False  # type: ignore[attr-defined]
    link.bytes_per_second = capacity
    return FramedDevice(link)


@pytest.fixture
def fake_link(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Replace the measured link by one of 0.1 ms without waiting, and stop before a trial begins."""

    def measured(device: FramedDevice, *_: Any, **__: Any) -> Any:
        return made_link(1e-4, simulated=device.dictionary.simulated)

    def started(*_: Any) -> Any:
        raise Started

    for module in (examining, gates):
        monkeypatch.setattr(module, "measure_link", measured)
    monkeypatch.setattr(examining, "supported_walls", lambda *_: [])
    monkeypatch.setattr(hits, "run_trial", started)
    gates._MEASURED.clear()
    yield
    gates._MEASURED.clear()


def by_doctor(x: config.Experiment, changes: dict[str, Any], device: FramedDevice) -> bool | None:
    asked = ExaminationRequest(experiment=x, changes=changes, url="serial:///dev/rig")
    return examining._with_device(asked, device, Examination(checks=(), ports=()), lambda *_: None).armable


def by_gate(x: config.Experiment, changes: dict[str, Any], device: FramedDevice) -> bool:
    effective = in_effect(x, device, changes)
    try:
        refuse(admission_checks(prepared_on(device, effective), device))
        check_armable(device, effective)
    except PlanError:
        return False
    return True


def by_hit(x: config.Experiment, changes: dict[str, Any], device: FramedDevice, output: Path) -> bool:
    request = HitRequest(
        experiment=x, changes=changes, device=device, verified=True, reference_count=0, output=output
    )
    try:
        next(hits.hit(request, admit))
    except Started:
        return True
    except PlanError:
        return False
    raise AssertionError("a hit begins or is refused")


@pytest.mark.parametrize(
    ("board", "claims"),
    first_by_default([(FIRMWARE, "simulated"), *zip(SERVED, cycle(("real", "simulated")), strict=False)]),
)
def test_doctor_gate_and_hit_agree(
    board: str, claims: str, fake_link: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if claims == "real":
        claim_to_be_real(monkeypatch)
    x = config.override(presets.load("koul-compliant"), MOTOR)
    answers = {}
    with board_behind_link(x, *SERVED[board]) as device:
        assert device.dictionary.simulated is (claims == "simulated")
        for (loop, rate), wall in product(RUN_BY, WALLS):
            stiffness, damping = WALLS[wall]
            changes = {
                "controller.loop": loop,
                "controller.position_rate": rate,
                "controller.velocity_rate": rate,
                "controller.parameters": {"cutoff_hz": rate / 10},
                "wall.stiffness": stiffness,
                "wall.damping": damping,
                "verdict.highpass_hz": 20.0,
                "verdict.lowpass_hz": rate / 5,
            }
            answers[loop, rate, wall] = (
                by_doctor(x, changes, device),
                by_gate(x, changes, device),
                by_hit(x, changes, device, tmp_path),
            )
    assert not {case: found for case, found in answers.items() if len(set(found)) > 1}
    if claims == "simulated" or board == FIRMWARE:  # of the real ones it alone admits hits
        assert {found[0] for found in answers.values()} == {True, False}, "the cases hold both answers"


def test_a_rate_that_a_served_board_does_not_run_is_refused_by_doctor_too(fake_link: None) -> None:
    """`rig doctor` once printed `may be armed` for a rate that `rig hit` rejected."""
    x = config.override(presets.load("koul-compliant"), {"host.realtime": "off"})
    changes = {
        "controller.loop": "device", "controller.position_rate": 10_000, "controller.velocity_rate": 1000,
    }  # fmt: skip
    with board_behind_link(x, False, 4000, None) as framed:
        asked = ExaminationRequest(experiment=x, changes=changes, url="serial:///dev/rig")
        found = examining._with_device(asked, framed, Examination(checks=(), ports=()), lambda *_: None)
    assert found.armable is False
    texts = " ".join(check.text for check in found.admission)
    assert "needs 10000 Hz, and the device supports at most 4000 Hz" in texts
    assert "let the host run it" in found.remedy


URL = "serial:///dev/rig"
PERSON = {
    "host.realtime": "off", "trial.kind": "human", "rig.limits.human": True, "rig.limits.effort": 0.28,
    "rig.amplifier.current_monitor": False, "operator.press": 2.0, "homing.tolerance_counts": 200.0,
    "wall.stiffness": 10.0, "wall.damping": 0.02,
}  # fmt: skip


def by_command(output: Path, x: config.Experiment, changes: dict[str, Any]) -> None:
    texts = {key: value if isinstance(value, str) else json.dumps(value) for key, value in changes.items()}
    given = [f"--set={key}={text}" for key, text in texts.items()]
    options = ["--rig", x.rig.name, "--url", URL, "--verified", "--output", str(output), "--no-plot"]
    command.main([*options, *given], standalone_mode=False)


def by_name(output: Path, x: config.Experiment, changes: dict[str, Any]) -> None:
    rig.hit(x, url=URL, verified=True, output=output, changes=changes)


def by_session(output: Path, x: config.Experiment, changes: dict[str, Any]) -> None:
    DeviceRunner(url=URL, verified=True).hit(x, changes, output, "t0001", lambda _: None, 0.0)


def by_measurement(output: Path, x: config.Experiment, changes: dict[str, Any]) -> None:
    Trials(OnDevice(url=URL, recordings=output, verified=True), None, None).run(x, changes)


def by_test(output: Path, x: config.Experiment, changes: dict[str, Any]) -> None:
    """Request admission as the pytest fixture ``rig_hit`` does."""
    request = HitRequest(experiment=x, url=URL, verified=True, output=output, changes=changes)
    hits_of_tests._run_and_observe(request, cast(FramedDevice, None), may_end=False)


entries = pytest.mark.parametrize("entry", [by_command, by_name, by_session, by_measurement, by_test])


@entries
def test_every_entry_passes_the_gate(
    entry: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_as_real(monkeypatch, SLOW_S)
    monkeypatch.setattr(DeviceRunner, "_device", lambda *_: None)
    with pytest.raises(PlanError, match=REFUSED):
        entry(tmp_path, presets.load("koul-compliant"), MOTOR)


@entries
def test_every_entry_pushes_a_real_rig_before_a_person_is_armed(
    entry: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_as_real(monkeypatch, 1e-4)
    monkeypatch.setattr(DeviceRunner, "_device", lambda *_: None)
    end_before_the_pulse(monkeypatch)
    with pytest.raises(Pushed):
        entry(tmp_path, presets.load("koul-rigid"), PERSON)
