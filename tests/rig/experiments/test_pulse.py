"""The torque pulse before a person's trial: only a rig that moves as described is armed; else the reason is given.

The cases are those of `tests/benchmarks/pulses.py`, which runs them over the presets and many handle positions.
"""

import dataclasses
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from rig import config
from rig.analysis.identification._quality import IdentificationError
from rig.analysis.identification._signs import check_signs
from rig.config import presets
from rig.core.check import Outcome
from rig.core.errors import ConfigError, DeviceFaultError, PlanError, RigError
from rig.devices.framed import FramedDevice
from rig.experiments.hits._on_device import OnDevice, Trials
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.experiments.motion._motion_run import FreeRigRequest
from rig.experiments.motion.pulse import NO_HANDS, PUSHES, Pulse, check_rig_moves, energy_of, judged, pulse
from rig.experiments.trials._identify_motions import coulomb_of, most_push, push_growth, push_way
from rig.experiments.trials.plan import make_plan
from rig.recording.reader import open_recording
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.board.hardware import World
from sim_backend.board.lockstep import Lockstep
from sim_backend.ends.link import MemoryLink
from tests.benchmarks.pulses import FAULTS, pulsed
from tests.conformance.firmware import need_compiler
from tests.conformance.gated import Pushed, end_before_the_pulse
from tests.conformance.tiers import first_by_default

RIGID = config.override(presets.load("koul-rigid"), {"rig.amplifier.current_monitor": False})
PERSON = config.override(
    RIGID,
    {
        "trial.kind": "human", "rig.limits.human": True, "rig.limits.effort": 0.28, "operator.press": 2.0,
        "homing.tolerance_counts": 200.0, "trial.duration_s": 0.55, "verdict.tail_s": 0.1,
    },
)  # fmt: skip


BY = {loop: config.override(RIGID, {"controller.loop": loop}) for loop in ("host", "device")}


@pytest.fixture(scope="module", params=BY)
def sound(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Pulse:
    if request.param == "device":
        need_compiler()
    x, place = BY[request.param], tmp_path_factory.mktemp("pulse")
    return pulsed(x, FAULTS["sound"], 0.0, place / "sound.rigcap")


def test_a_sound_rig_moves_as_it_is_described(sound: Pulse) -> None:
    assert sound.ok
    assert [(check.name, check.outcome) for check in sound.checks] == [
        (name, Outcome.OK) for name in ("motion", "direction", "size", "delay")
    ]
    assert len(sound.signs.pushes) == 4
    assert {push.direction for push in sound.signs.pushes} == {-1, 1}
    sound.insist()


def test_a_pulse_is_small_and_recorded(sound: Pulse) -> None:
    rows = open_recording(sound.recording).rows
    assert abs(rows["effort_sent"]).max() <= most_push(RIGID) + RIGID.rig.amplifier.effort_quantum
    energy = sum(push.way * push.direction * most_push(RIGID) for push in sound.signs.pushes)
    assert 0.0 < energy <= 4 * energy_of(RIGID) * 1.2  # a tick's way further than where it ends
    assert rows["effort_sent"][-1] == 0.0


# By default one fault of scale, and all of direction and motion.
NAMED = [name for name, fault in FAULTS.items() if fault.named and "½" not in name]
NAMED.sort(key=lambda name: "×" in name)


@pytest.mark.parametrize(
    ("loop", "name"), first_by_default(product(("device", "host"), NAMED), len(NAMED) - 2)
)
def test_a_fault_is_refused_by_the_check_that_is_about_it(name: str, loop: str, tmp_path: Path) -> None:
    if loop == "device":
        need_compiler()
    found = pulsed(BY[loop], FAULTS[name], 0.0, tmp_path / "pulse.rigcap")
    refused = [check for check in found.checks if check.outcome is Outcome.REFUSED]
    assert FAULTS[name].named in [check.name for check in refused]
    assert all(check.remedy for check in refused)
    with pytest.raises(IdentificationError, match="does not move as it is described"):
        found.insist()


def test_the_described_friction_gives_the_scale_of_a_push_within_one_step_of_current(tmp_path: Path) -> None:
    """The push ends in the step in which the handle starts to move, so inertia and friction show only together."""
    sheets = rig.new_rig(
        mechanism="lever", torque_constant=0.0385, rotor_inertia=1.1e-5, nominal_current=2.5, encoder_lines=2048,
        transmission=12.0, handle_length=0.08, handle_mass=0.06, amplifier="escon-50-5-pwm", peak_current=5.0,
    ).experiment  # fmt: skip
    slow = dict.fromkeys(("controller.position_rate", "controller.velocity_rate"), 1000)
    paddle = config.override(sheets, {**slow, "rig.encoder.offset": 0.3})
    found = check_rig_moves(FreeRigRequest(experiment=paddle, output=tmp_path))
    assert found.signs.scale == pytest.approx(1.0, abs=0.25)  # 0.55 by the best fit alone


def test_friction_beyond_a_push_is_not_called_a_dead_motor(sound: Pulse) -> None:
    """Nothing moved, and the described friction alone explains it."""
    pushes = tuple(dataclasses.replace(push, moved=False, seen=0.0) for push in sound.signs.pushes)
    still = dataclasses.replace(sound.signs, pushes=pushes)
    stiff = config.override(RIGID, {"rig.mechanics.motor_coulomb": 0.07})
    (check,) = judged(stiff, still)
    assert check.outcome is Outcome.REFUSED
    assert check.text.startswith("not observed")
    (dead,) = judged(RIGID, still)
    assert "dead" in dead.text


@pytest.mark.parametrize("friction", first_by_default([0.0, 0.01]))
def test_a_push_against_friction_shows_the_inertia_and_when_it_began(friction: float) -> None:
    """With 6·m·x = g·(t − t₀)³ and friction g·t₀, a fit of fine counts gives m and t₀."""
    growth, inertia, time_s = 0.1, 2e-4, 1e-5 * np.arange(40_000)
    began_s = friction / growth
    position = growth * np.maximum(time_s - began_s, 0.0) ** 3 / (6.0 * inertia)
    push = position < 0.05
    (found,) = check_signs(
        time_s[push],
        (growth * time_s + 1e-12)[push],
        np.floor(position[push] / 1e-7) * 1e-7,
        resolution=1e-7,
        expected_inertia=inertia,
        rest_s=1.0,
    ).pushes
    assert found.inertia == pytest.approx(inertia, rel=2e-3)
    assert found.began_s == pytest.approx(began_s, abs=1e-3)


def test_the_most_effort_moves_the_described_rig() -> None:
    for name in presets.names():
        x = presets.load(name)
        rises = (6.0 * x.rig.mechanics.inertia * push_way(x) * push_growth(x) ** 2) ** (1 / 3)
        assert 2.0 * coulomb_of(x) + rises < most_push(x)  # with twice the friction, too


# ---------------------------------------------------------------------- who is armed


def person_request(device: FramedDevice, output: Path, **others: Any) -> HitRequest:
    given: dict[str, Any] = {"experiment": PERSON, "device": device, "output": output, **others}
    return HitRequest(verified=True, **given)


class FaultingDevice(FirmwareDevice):
    """A simulated device that reports an over-current fault once it runs, if `fails` is set."""

    fails = False

    def compiled(self) -> tuple[Lockstep, World]:
        if self.fails and self.state is State.RUNNING:
            self.fails = False
            self.inject_fault(Fault.OVER_CURRENT)
        return super().compiled()


def free_rig(**hardware: float) -> FramedDevice:
    """Return the rig of the person's experiment with a free handle."""
    device = FaultingDevice(config.rig_model(config.override(PERSON, BARE)), law_maximum=0)
    for name, value in hardware.items():
        setattr(device.hardware, name, value)
    return FramedDevice(MemoryLink(device))


BARE = {"trial.kind": "constant-effort", "rig.mechanics.end_mass": 0.0}


def test_a_real_rig_is_pushed_before_a_person_is_armed_and_once(real: None, tmp_path: Path) -> None:
    prompts: list[str] = []
    with free_rig() as device:
        request = person_request(device, tmp_path, hands_off=prompts.append)
        for _ in range(2):
            tuple(hit(request, admit))
    assert prompts == [NO_HANDS]
    assert len(list(tmp_path.glob("*pulse*.parquet"))) == 1
    assert len(list(tmp_path.glob("*.parquet"))) == 3


def test_a_real_board_that_runs_the_law_pushes_before_a_person_is_armed(real: None, tmp_path: Path) -> None:
    """Uses the longest supervision lifetime, as on systems other than Linux."""
    need_compiler()
    changes = {"controller.loop": "device", "controller.supervise_lifetime_s": 0.1}
    person, prompts = config.override(PERSON, changes), []
    board = FirmwareDevice(config.rig_model(config.override(PERSON, BARE)))
    board.hold_to_run(True)
    with FramedDevice(MemoryLink(board)) as device:
        request = person_request(device, tmp_path, experiment=person, hands_off=prompts.append)
        for _ in range(2):
            tuple(hit(request, admit))
    assert prompts == [NO_HANDS]
    assert len(list(tmp_path.glob("*pulse*.parquet"))) == PUSHES
    assert len(list(tmp_path.glob("*.parquet"))) == PUSHES + 2


@pytest.fixture
def before_pulse(real: None, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a context that requires a torque pulse of a real rig, and ends before it moves anything."""
    end_before_the_pulse(monkeypatch)
    return pytest.raises(Pushed)


def test_the_public_function_asks_the_person_on_standard_error_to_let_go(
    before_pulse: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with free_rig() as device, before_pulse:
        rig.hit(PERSON, device=device, verified=True, output=tmp_path)
    assert capsys.readouterr().err == f"rig: {NO_HANDS}\n"


def test_a_real_rig_whose_motor_is_dead_is_not_armed_for_a_person(real: None, tmp_path: Path) -> None:
    with free_rig(drive=0.0) as device:
        # The device's own check of a large effort without an edge may come first.
        with pytest.raises((IdentificationError, DeviceFaultError), match=r"encoder is dead|no encoder edge"):
            tuple(hit(person_request(device, tmp_path), admit))
        assert not device.moved_as_described
        assert device.connection.state != State.RUNNING
    (only,) = tmp_path.glob("*.parquet")
    assert "pulse" in only.name


@pytest.mark.exhaustive("::test_a_real_rig_is_pushed_before_a_person_is_armed_and_once")
def test_a_rig_that_a_run_left_in_doubt_is_pushed_again(real: None, tmp_path: Path) -> None:
    prompts: list[str] = []
    with free_rig() as device:
        person = person_request(device, tmp_path, hands_off=prompts.append)
        tuple(hit(person, admit))
        device.link.device.fails = True  # type: ignore[attr-defined]
        with pytest.raises(DeviceFaultError, match="measured current above"):
            tuple(hit(dataclasses.replace(person, name="faulty"), admit))
        tuple(hit(person, admit))
    assert prompts == [NO_HANDS] * 2


def test_a_map_with_a_person_asks_to_let_go_before_its_pulse(before_pulse: Any, tmp_path: Path) -> None:
    prompts: list[str] = []
    where = OnDevice(url="serial://none", verified=True, recordings=tmp_path, hands_off=prompts.append)
    with free_rig() as device, before_pulse:
        Trials(where, device, 0).run(PERSON, {})
    assert prompts == [NO_HANDS]


def test_an_automated_trial_needs_no_pulse(real: None, tmp_path: Path) -> None:
    with free_rig() as device:
        tuple(hit(person_request(device, tmp_path, experiment=config.override(PERSON, BARE)), admit))
    assert not list(tmp_path.glob("*pulse*"))


def test_a_real_rig_of_unverified_polarity_gets_no_pulse(real: None, tmp_path: Path) -> None:
    with free_rig() as device, pytest.raises(ConfigError, match="not verified"):
        pulse(device, RIGID, recording=tmp_path / "pulse.rigcap", verified=False, reference_count=0)
    assert not list(tmp_path.iterdir())


def test_a_device_of_another_rig_gets_no_pulse(tmp_path: Path) -> None:
    chawda = FreeRigRequest(experiment=presets.load("chawda-linear"), url="sim://koul-rigid", output=tmp_path)
    with pytest.raises(PlanError, match="the device is named koul-rigid"):
        check_rig_moves(chawda)


COARSE = {"rig.encoder.ratio": 1.0, "rig.encoder.counts_per_revolution": 250, "wall.stiffness": 2.0}


def test_single_counts_of_a_coarse_encoder_do_not_end_the_pushes(tmp_path: Path) -> None:
    """With 250 lines at the handle, one count through the filter of a fine encoder reads as 7 rad/s."""
    x = config.override(presets.load("koul-rigid"), {**COARSE, "rig.limits.speed": 3.0})
    assert check_rig_moves(FreeRigRequest(experiment=x, output=tmp_path)).ok


@pytest.mark.parametrize(
    ("name", "changes"),
    first_by_default(
        [
            ("pushes of rig device check", {"rig.mechanics.motor_coulomb": 0.2, "trial.effort": 0.4}),
            (
                "room of rig device check",
                {**COARSE, "rig.encoder.counts_per_revolution": 40, "wall.stiffness": 1.0},
            ),
        ]
    ),
)
def test_a_plan_names_limits_at_which_pushes_work(name: str, changes: dict[str, Any], tmp_path: Path) -> None:
    x = config.override(presets.load("koul-rigid"), changes)
    (found,) = [check for check in make_plan(x).checks if check.name == name]
    assert found.outcome is Outcome.WARNING
    request = FreeRigRequest(experiment=x, output=tmp_path)
    with pytest.raises(RigError):
        check_rig_moves(request).insist()
    again = check_rig_moves(dataclasses.replace(request, changes=found.changes))
    assert again.ok, again.checks
