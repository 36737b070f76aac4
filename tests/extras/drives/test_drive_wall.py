"""A wall that the drive renders itself: its physics, its limits, and zero torque after every kind of end."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from firmware_protocol.faults import Fault, LimitFlag, Status
from firmware_protocol.messages import Mode
from firmware_protocol.parameters import BY_NAME
from rig.config import Experiment, controller, rig_model
from rig.control.verdict import Kind
from rig.core.check import refused
from rig.core.errors import PlanError
from rig.core.sample import Phase
from rig.devices.framed import FramedDevice
from rig.doctor.late_loops import LateLoops
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.experiments.trials.plan import device_checks, plan_of
from rig.experiments.trials.replay import replay
from rig.extras.drives import own_wall
from rig.extras.drives.faults import DriveFault
from sim_backend.board.configuration import describe
from sim_backend.drives.moteus_law import W
from tests.conformance.bridged import Bridged, Moteus
from tests.conformance.host import Host
from tests.conformance.tiers import first_by_default
from tests.conformance.walled import DEEP, GAINS, Walled, walled, within
from tests.extras.drives.test_bridge_core import ENDINGS, RAMP_S, SLACK_S, WATCHDOG_S

COUNT = 2.0 * math.pi / 16384  # rad
LIFETIME_S = 0.020
SHAPE = 2.48  # 3 dB frequency over natural frequency of the drive's filter (fw/motor_position.h of moteus)
RUN_MS = 8


# ---------------------------------------------------------------------- physics


@pytest.mark.parametrize(("side", "sign", "ratio"), [(1, 1, 1.0), (-1, -1, 2.0)])
def test_the_static_slope_is_the_stiffness(side: int, sign: int, ratio: float) -> None:
    """Two pushes come to rest Δτ/K apart, for either encoder sign and any ratio."""
    keys = {"wall__side": side, "rig__encoder__sign": sign, "rig__encoder__ratio": ratio}
    keys |= {"wall__position": -0.01 * side, "wall__stiffness": 0.5, "wall__damping": 0.01}
    keys |= {"trial__start": -0.06 * side}
    rest = []
    for effort in (0.02, 0.05):
        run = Walled(walled(**keys, trial__effort=side * effort), inside=True)
        run.run(0.4)
        rest.append(run.angles[-1])
    assert side * (rest[1] - rest[0]) == pytest.approx(0.03 / 0.5, abs=2 * COUNT)
    assert rest[0] == pytest.approx(side * (-0.01 + 0.02 / 0.5), abs=2 * COUNT)


def continuous(x: Experiment, stiffness: float, damping: float) -> NDArray[np.float64]:
    """Return rig, amplifier lag and drive filter as one linear system; 30 kHz is nearly continuous.

    The states are position, velocity, effort, and the filter's two: f' = w + 2ω(x − f), w' = ω²(x − f). The wall is
    −K f − B w.
    """
    m, lag = x.rig.mechanics, x.rig.amplifier.lag_s
    inertia, own = m.motor_inertia + m.link_inertia, 2.0 * math.pi * 400.0 / SHAPE
    return np.array(
        [
            [0.0, 1.0, 0.0, 0.0, 0.0],
            [0.0, -m.motor_damping / inertia, 1.0 / inertia, 0.0, 0.0],
            [0.0, 0.0, -1.0 / lag, -stiffness / lag, -damping / lag],
            [2.0 * own, 0.0, 0.0, -2.0 * own, 1.0],
            [own**2, 0.0, 0.0, -(own**2), 0.0],
        ]
    )


@pytest.mark.parametrize("damping", [0.003, 0.006])
def test_an_oscillation_decays_as_the_damping_says(damping: float) -> None:
    """Decay and period about the resting position are those of the slowest pole."""
    push, stiffness = 0.05, 1.0
    keys = {"wall__position": -0.1, "trial__start": -0.15, "trial__effort": push}
    run = Walled(x := walled(wall__stiffness=stiffness, wall__damping=damping, **keys), inside=True)
    run.run(0.2)
    moved = np.array(run.angles) - (push / stiffness - 0.1)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(moved))))[1:5] + 1  # ms; the first begins from rest
    heights = np.abs(moved[turns])
    poles = np.linalg.eigvals(continuous(x, stiffness, damping))
    pole = max((one for one in poles if one.imag > 1.0), key=lambda one: one.real)
    assert np.diff(turns).mean() == pytest.approx(1e3 * math.pi / pole.imag, abs=0.4)
    rate = 1e3 * math.log(heights[0] / heights[-1]) / (turns[-1] - turns[0])
    assert rate == pytest.approx(-pole.real, rel=0.03 + COUNT / heights[-1])


def k_max(x: Experiment, damping: float) -> float:
    """Return the largest stiffness of the drive's own wall for which the linear system is stable."""

    def growth(stiffness: float) -> float:
        return float(np.linalg.eigvals(continuous(x, stiffness, damping)).real.max())

    return float(brentq(growth, 1e-3, 100.0, rtol=1e-3))


@pytest.mark.parametrize("where", first_by_default(["drive", "float32"]))
def test_the_drive_holds_stiffer_walls_than_a_law_behind_the_bridge(where: str) -> None:
    """Predicted before: up to 6.1 N·m/rad by the drive, 2.1 by the same wall with 1 ms of delay at 1 kHz."""
    keys = {
        "wall__damping": 0.01,
        "wall__position": -0.05,
        "trial__start": -0.06,
        "controller__arithmetic": where,
    }
    (late,) = LateLoops.of(walled(**{**keys, "controller__arithmetic": "float32"}), 1).k_max([0.01])
    limits = {"drive": k_max(walled(**keys), 0.01), "float32": late["none"]}
    assert limits["drive"] == pytest.approx(6.07, abs=0.05)
    assert limits["float32"] == pytest.approx(2.14, abs=0.05)
    for stiffness, steady in ((0.7 * limits[where], True), (1.4 * limits[where], False)):
        run = Walled(walled(**keys, wall__stiffness=stiffness), inside=True)
        run.run(0.4)
        rests = run.world.bridge.fault == 0 and np.ptp(run.angles[-60:]) <= 2 * COUNT
        assert rests == steady, (stiffness, np.ptp(run.angles[-60:]))


def test_an_effort_that_changes_within_a_tick_is_no_wrong_current() -> None:
    """With high damping the torque follows the drive's filter, faster than a bridge at 1 kHz receives it."""
    keys = {"wall__stiffness": 0.7, "wall__damping": 0.04, "wall__position": -0.02, "trial__start": -0.03}
    x = walled(**keys, rig__mechanics__motor_coulomb=0.003)
    run = Walled(x, {"servo.pid_position.kd": "40"}, inside=True)
    run.run(0.1)
    assert run.world.bridge.fault == 0


def test_it_pulls_a_handle_that_leaves() -> None:
    """The drive does not clamp the wall, so `pull` must allow it: on the way out damping exceeds the spring."""
    push = 0.001
    x = walled(wall__damping=0.005, wall__position=-0.1, trial__start=-0.15, trial__effort=push)
    run = Walled(x, inside=True)
    most = -math.inf
    for _ in range(60):
        run.run(0.001)
        if run.angles[-1] > -0.1 + COUNT:
            most = max(most, run.world.torque - push)
    assert most > 0.01


def test_wall_and_push_together_end_at_the_limit_of_the_experiment() -> None:
    run = within(wall__stiffness=4.0, wall__damping=0.01, rig__limits__effort=0.1, trial__effort=0.02)
    limit = run.world.drive._words[W.max_torque]
    assert limit == pytest.approx(0.1, abs=3e-5)  # register 0x025, a quantum
    assert abs(run.world.torque) == pytest.approx(0.1, abs=3e-5)
    assert run.world.far.register(0x00F) == 102  # the drive reports "maximum torque"
    run.run(0.006)
    assert run.state.limits & LimitFlag.CURRENT


# ---------------------------------------------------------------------- every way ends in zero torque


def test_a_host_that_falls_silent_sees_the_wall_fade() -> None:
    run = within()
    scales = []
    for _ in range(round(1e3 * (LIFETIME_S + RAMP_S + 0.008))):
        run.run(0.001, supervised=False)
        scales.append(run.world.drive._words[W.kp_scale] if run.world.mode == Moteus.stay_within else 0.0)
    assert run.world.torque == 0.0
    assert run.world.bridge.fault == Fault.LINK_LOST
    assert scales == sorted(scales, reverse=True)
    assert len(set(scales)) >= 9  # a ramp of ten ticks


def stop_bridge(run: Walled) -> None:
    run.world._to_drive(run.world.bridge.stop())
    run.world.alive = False


@pytest.mark.parametrize(
    ("end", "within_s", "mode", "fault"),
    [
        (stop_bridge, 0.001, 0, 0),
        # The watchdog of the drive ends it.
        (lambda run: setattr(run.world, "alive", False), WATCHDOG_S + SLACK_S, 11, 0),
        (
            lambda run: run.world.bridge.lose_bus(run.world._now),
            WATCHDOG_S + SLACK_S,
            None,
            DriveFault.BUS_LOST,
        ),
        (lambda run: run.host.command(mode=Mode.STOP), 0.0005, None, 0),
    ],
    ids=["the bridge ends", "the bridge is killed", "the adapter is pulled out", "the host stops"],
)
def test_an_end_is_zero_torque(end: Any, within_s: float, mode: int | None, fault: int) -> None:
    run = within()
    end(run)
    run.world.run(within_s)
    assert run.world.torque == 0.0
    assert mode in (None, run.world.mode)
    assert run.world.bridge.fault == fault


@pytest.mark.parametrize("ending", first_by_default(reversed(ENDINGS), 4))  # dead, both garbled, lost answers
def test_a_fault_at_any_line_of_a_run(ending: str) -> None:
    """Every loss leads to zero torque in time: the wall ends with the session that rendered it."""
    way, strike, length = ENDINGS[ending]
    single = length == 1 and strike.__name__ == "drop"
    of_the_run = RUN_MS * (1 if way == "to drive" else 2)  # the adapter sends OK, too
    for first in range(0, of_the_run, 1 if single else 5):
        run = within()
        run.world.strike(way, strike, length, after=first)
        run.run(1e-3 * RUN_MS)
        fault = run.world.bridge.fault
        assert fault in {0, DriveFault.DRIVE_SILENT}
        if single:
            assert fault == 0  # a lost line is a missed tick
            assert run.world.mode == Moteus.stay_within
        run.run(WATCHDOG_S + SLACK_S if fault else LIFETIME_S + RAMP_S + SLACK_S, supervised=False)
        assert run.world.torque == 0.0


@pytest.mark.parametrize(
    ("event", "value", "fault"),
    [
        ("mode", 10, DriveFault.DRIVE_LEFT),
        ("mode", 12, DriveFault.DRIVE_LEFT),
        ("expire", 0.0, DriveFault.DRIVE_LEFT),
        ("master", 0.1, DriveFault.OTHER_MASTER),
        ("temperature", 90.0, DriveFault.TEMPERATURE),
    ],
)
def test_a_drive_that_leaves_its_wall(event: str, value: float, fault: DriveFault) -> None:
    run = within()
    run.world.happen(event, value)
    run.run(0.005)
    assert run.world.bridge.fault == fault
    run.world.run(0.003)
    assert run.world.torque == 0.0


def test_without_the_hold_to_run_switch_there_is_no_wall() -> None:
    run = Walled(walled(**DEEP), inside=True, hold_to_run=1)  # no pin is wired: it is never held
    run.run(0.02)
    assert (run.world.mode, run.world.torque) == (10, 0.0)
    assert run.state.limits & LimitFlag.HOLD_TO_RUN_RELEASED


def test_a_wall_that_no_motion_confirms_fades_though_there_is_no_push() -> None:
    """With a dead encoder inside the wall and a hand on the handle, only the drive produces effort."""
    run = Walled(walled(**DEEP), inside=True, confirm_ms=50, float_constant=0.0)
    run.run(0.03)
    assert abs(run.world.torque) > 0.05
    run.run(0.6)
    assert run.world.torque == 0.0


# ---------------------------------------------------------------------- what it cannot be


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("wall.pull", "clamp", "the drive does not clamp its wall"),
        ("wall.damping_on", "entry", "the drive damps in both directions"),
        ("wall.law", "bilateral", "a spring and a damper beyond a bound"),
        ("controller.velocity_rate", 500, "has a single rate"),
        ("controller.prediction", "extrapolate", "does not extrapolate"),
        ("controller.slow_velocity_rate", 500, "has a single rate"),
        ("controller.estimator", "kalman", "the drive computes the velocity by its own filter"),
        ("controller.friction_compensation", 0.5, "a spring and a damper beyond a bound"),
    ],
)
def test_an_experiment_that_a_drive_cannot_render(key: str, value: object, says: str) -> None:
    changes = {key.replace(".", "__"): value, "rig__mechanics__motor_coulomb": 0.003}
    if key == "controller.slow_velocity_rate":
        changes["controller__slow_below"] = 0.5
    with pytest.raises(PlanError, match=says) as caught:
        controller.prepare_controller(walled(**changes))
    assert caught.value.remedy


def test_a_plan_says_what_is_lost() -> None:
    checks = plan_of(controller.prepare_controller(walled())).checks
    (check,) = (one for one in checks if one.name == own_wall.NAME)
    for word in ("velocity rate", "estimator", "slew limit", "1000 Hz"):
        assert word in check.text


@pytest.mark.parametrize(
    ("setting", "value", "says"),
    [
        ("servo.velocity_threshold", "0.1", "velocity_threshold = 0.1; it must be 0"),
        ("servo.max_position_slip", "0.1", "max_position_slip"),
        ("servo.max_velocity_slip", "0.1", "max_velocity_slip"),
        ("servo.pid_position.sign", "-1", "sign = -1; it must be 1"),
        ("servo.pid_position.kd", "0", "and kd = 0; both must be above 0"),
        ("motor_position.sources.0.pll_filter_hz", "0", "no velocity"),
    ],
)
def test_a_drive_that_would_render_another_wall_is_offered_none(setting: str, value: str, says: str) -> None:
    run = controller.prepare_controller(walled())
    host = Host(Bridged(rig_model(run.experiment), {**GAINS, setting: value}))
    dictionary = host.identify()
    reasons = " ".join(check.text for check in refused(device_checks(run, dictionary)))
    assert says in reasons
    assert host.configure(**run.parameters).status == Status.OUT_OF_RANGE  # a host without its own check


# Beyond kp; a damper's share above the spring's.
@pytest.mark.parametrize(("stiffness", "damping"), [(9.6, 0.005), (1.0, 0.04)])
def test_too_small_gains_are_named_with_those_that_are_enough(stiffness: float, damping: float) -> None:
    run = controller.prepare_controller(walled(wall__stiffness=stiffness, wall__damping=damping))
    host = Host(Bridged(rig_model(run.experiment), GAINS))
    (check,) = refused(device_checks(run, host.identify()))
    assert "at most 1" in check.text
    ack = host.configure(**run.parameters)
    assert (ack.status, ack.detail) == (Status.INCONSISTENT, BY_NAME["float_stiffness"].id)
    raised = dict(zip(("kp", "kd"), re.findall(r"pid_position\.k[pd] ([\d.]+)", check.remedy), strict=True))
    settings = {f"servo.pid_position.{name}": value for name, value in raised.items()}
    again = Host(Bridged(rig_model(run.experiment), settings))
    assert not refused(device_checks(run, again.identify()))
    assert again.configure(**run.parameters).status == Status.OK


def test_a_device_that_is_no_bridge_refuses() -> None:
    run = controller.prepare_controller(walled())
    simulated = describe(rig_model(run.experiment), "a board", 1000, 8000, 2)
    reasons = " ".join(check.text for check in refused(device_checks(run, simulated)))
    assert "not a drive behind a bridge" in reasons


# ---------------------------------------------------------------------- a trial, and its recording


def test_a_recording_has_the_effort_of_the_drive_and_what_it_was_set_to(tmp_path: Path) -> None:
    x = walled(wall__damping=0.005, trial__duration_s=0.55, rig__mechanics__motor_coulomb=0.003)
    world = Bridged(rig_model(x), GAINS)
    rendered: dict[int, float] = {}
    hear = world.bridge.receive_bus

    def noted(line: bytes, now: int) -> bytes:
        sent = hear(line, now)
        if world.mode == Moteus.stay_within:
            rendered[world.bridge.facts.replies] = world.far.register(0x03A)
        return sent

    world.bridge.receive_bus = noted  # type: ignore[method-assign]
    device = FramedDevice(world)
    request = HitRequest(experiment=x, url="moteus://", device=device, verified=True, output=tmp_path)
    (result,) = hit(request, admit)
    recording, judgement = result.recorded.recording, result.recorded.judgement
    trial = recording.rows[recording.rows["phase"] == Phase.TRIAL]
    efforts = np.array(sorted(rendered.values()))
    assert judgement.verdict.kind == Kind.STABLE, judgement.verdict.reasons
    assert np.abs(trial["effort_applied"]).max() == pytest.approx(np.abs(efforts).max(), abs=1e-3)
    assert judgement.verdict.peak_effort == pytest.approx(np.abs(trial["effort_applied"]).max())
    assert recording.header["extra"]["arithmetic"] == "drive"
    settings = recording.header["identity"]["settings"]
    assert (settings["drive_filter_hz"], settings["drive_law_hz"]) == (400.0, 30_000.0)
    assert (settings["drive_kp"], settings["drive_kd"]) == (60.0, 2.0)
    assert replay(recording).exact  # beside it: what the host's law made of the same counts


# ---------------------------------------------------------------------- live changes


def test_another_wall_comes_in_free_space_alone_and_within_the_gains() -> None:
    keys = {"wall__position": 0.2, "wall__stiffness": 1.0, "wall__damping": 0.005, "trial__effort": 0.002}
    run = Walled(walled(**keys, trial__start=-0.1), inside=True)
    run.run(0.02)
    scale = run.world.drive._words[W.kp_scale]
    stiffer = walled(**{**keys, "wall__stiffness": 2.0}, trial__start=-0.1)
    live = controller.prepare_controller(stiffer).parameters
    names = ("float_surface", "float_surface_fraction", "float_stiffness", "float_damping")
    wall = {name: live[name] for name in names}
    assert run.host.configure(**wall).status == Status.OK
    run.run(0.003)
    assert run.world.drive._words[W.kp_scale] == pytest.approx(2.0 * scale, rel=1e-6)
    beyond = {**wall, "float_stiffness": 20.0 * wall["float_stiffness"]}
    assert run.host.configure(**beyond).status == Status.INCONSISTENT
    pressed = within()
    assert pressed.host.configure(**wall).status == Status.INSIDE_WALL


# ---------------------------------------------------------------------- the maker's library as the oracle


def test_the_makers_library_reads_our_wall_as_its_own() -> None:
    """The registers and float32 values equal those of the library's `make_stay_within`."""
    multiplex, moteus = pytest.importorskip("moteus.multiplex"), pytest.importorskip("moteus")
    run = within()
    lines: list[bytes] = []
    run.world.strike("to drive", lambda sent: lines.append(sent) or sent)
    run.run(0.002)
    frame = bytes.fromhex(lines[-1].split(b" ")[3].decode())
    resolution = moteus.PositionResolution()
    for name in vars(resolution):
        setattr(resolution, name, multiplex.F32)
    transport = object()
    wall = {"lower_bound": math.nan, "upper_bound": -0.05 / (2.0 * math.pi), "ilimit_scale": 0.0}
    wall |= {"kp_scale": 2.0 * 2.0 * math.pi / 60.0, "kd_scale": 0.005 * 2.0 * math.pi / 2.0}
    wall |= {"feedforward_torque": 0.03, "maximum_torque": 0.328, "watchdog_timeout": 0.005}
    controller_ = moteus.Controller(id=1, position_resolution=resolution, transport=transport)
    theirs = controller_.make_stay_within(**wall)
    ours, expected = (_written(multiplex, data) for data in (frame, theirs.data))
    assert ours.keys() == expected.keys()
    for register, value in expected.items():
        assert ours[register] == pytest.approx(value, rel=2e-3, nan_ok=True), hex(register)
    asked = {one.register for one in multiplex.parse_frame(frame) if one.type == multiplex.SubframeType.READ}
    assert asked == {0x000, 0x001, 0x002, 0x003, 0x00D, 0x00E, 0x00F, 0x03A}


def _written(multiplex: Any, data: bytes) -> dict[int, float]:
    return {
        one.register: one.value
        for one in multiplex.parse_frame(data)
        if one.type == multiplex.SubframeType.WRITE
    }
