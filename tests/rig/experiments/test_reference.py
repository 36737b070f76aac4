"""The reference search: it finds position zero from any start, or ends at rest with a reason."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.faults import Fault, Input
from rig import config, devices
from rig.analysis.identification._quality import IdentificationError
from rig.config import Experiment, presets
from rig.core.errors import ConfigError, DeviceFaultError, DeviceRefusedError, GuardError, RigError
from rig.devices.framed import FramedDevice
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.experiments.motion import reference as searching
from rig.experiments.motion.pulse import Pulse
from rig.experiments.motion.reference import FoundReference, reference
from rig.experiments.trials._identify_motions import still
from rig.experiments.trials.preparation import position_zero
from rig.recording.reader import open_recording
from sim_backend.board.hardware import Hardware
from sim_backend.mechanics.plant import COULOMB
from tests.conformance.firmware import need_compiler
from tests.conformance.tiers import first_by_default

FAST = {"controller.position_rate": 2000, "controller.velocity_rate": 2000, "homing.speed": 0.5}
MARKED = config.override(
    presets.load("koul-rigid"),
    {
        **FAST,
        "rig.reference.index": True,
        "rig.reference.limit_switch": "minimum",
        "rig.reference.position": -0.3,
        "rig.reference.travel": 1.6,
    },
)
BY_BOARD = config.override(MARKED, {"controller.loop": "device"})
EVERY = 4000  # counts of a turn of its encoder, 0.63 rad of the link


@contextmanager
def powered_up(x: Experiment, at: float = 0.1) -> Iterator[FramedDevice]:
    url = devices.url_for(f"sim://?incremental=1&initial_position={at}", x.controller.loop)
    if x.controller.loop == "device":
        need_compiler()
    with devices.open_device(url, config.rig_model(still(x))) as device:
        yield device


def hardware_of(device: FramedDevice) -> Hardware:
    hardware: Hardware = device.link.device.hardware  # type: ignore[attr-defined]
    return hardware


@pytest.fixture
def pushed_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each search the pulse of the first one on the same sound rig."""
    first = searching.pulse

    def known(device: FramedDevice, x: Experiment, **options: Any) -> Pulse:
        loop = x.controller.loop
        return PULSES.get(loop) or PULSES.setdefault(loop, first(device, x, **options))

    monkeypatch.setattr(searching, "pulse", known)


PULSES: dict[str, Pulse] = {}


def find(device: FramedDevice, x: Experiment, output: Path, **changes: Any) -> FoundReference:
    return reference(device, x, output=output, verified=False, **changes)


def last_effort(recording: Path) -> float:
    return float(open_recording(recording).rows["effort_sent"][-1])


@pytest.mark.parametrize(
    ("end", "position", "sign", "at", "loop"),
    first_by_default(
        [
            ("minimum", -0.3, 1, 0.1, "host"),
            ("maximum", 0.35, -1, -0.2, "device"),
            ("maximum", 0.35, 1, -0.2, "host"),
            ("minimum", -0.3, -1, 0.3, "host"),
        ],
        2,
    ),
)
def test_zero_is_at_the_same_place_wherever_the_handle_was_at_power_up(
    end: str, position: float, sign: int, at: float, loop: str, tmp_path: Path
) -> None:
    """Position zero is exact to the count, with the law on the host and on the board."""
    marks = {"rig.reference.limit_switch": end, "rig.reference.position": position}
    x = config.override(MARKED, {"rig.encoder.sign": sign, "controller.loop": loop, **marks})
    if loop == "device":
        need_compiler()
    look = 0.005 * x.homing.speed if loop == "device" else 0.0  # between STATEs of a board that runs the law
    with powered_up(x, at) as device:
        assert device.count() == 0
        found = find(device, x, tmp_path)
        assert found.reference_count == hardware_of(device).slip
        assert found.index_counts == EVERY
        assert found.switch_position is not None
        # The simulated switch stands half of the way between two indices before the index.
        away = 1.0 if end == "minimum" else -1.0
        one, beyond = x.rig.encoder.resolution, away * (position - found.switch_position)
        assert beyond == pytest.approx(0.5 * EVERY * one, abs=3 * one + look)
        limits = x.rig.limits
        assert limits.position_minimum < found.position < limits.position_maximum
        assert all(last_effort(path) == 0.0 for path in found.recordings)


@pytest.mark.usefixtures("pushed_before")
def test_a_run_behind_it_has_its_wall_in_the_mechanism_and_names_the_reference(tmp_path: Path) -> None:
    with powered_up(MARKED) as device:
        find(device, MARKED, tmp_path)
        (result,) = hit(HitRequest(experiment=MARKED, device=device, output=tmp_path), admit)
        recording = result.recorded.recording
        assert recording.header["identity"]["reference"] == "an index of the encoder"
        assert recording.header["identity"]["parameters"]["reference"] == 1
        rows = recording.rows
        resolution = MARKED.rig.encoder.resolution
        assert np.abs(rows["position"] - rows["position_true"]).max() < 1.5 * resolution
        plain = config.override(MARKED, {"rig.reference.index": False, "rig.reference.limit_switch": "none"})
        (other,) = hit(HitRequest(experiment=plain, device=device, output=tmp_path), admit)
        assert other.recorded.recording.header["identity"]["reference"] == "where the handle was put"


@pytest.mark.usefixtures("real", "pushed_before")
def test_a_new_host_takes_the_reference_from_the_device_until_it_is_lost(tmp_path: Path) -> None:
    with powered_up(MARKED) as device:
        with pytest.raises(DeviceRefusedError, match=r"position zero of .* is unknown") as refused:
            position_zero(device, MARKED)
        assert "rig device reference" in refused.value.remedy
        found = reference(device, MARKED, output=tmp_path, verified=True)
        assert position_zero(FramedDevice(device.link), MARKED) == found.reference_count
        device.link.device.inject_fault(Fault.ENCODER)  # type: ignore[attr-defined]
        other = FramedDevice(device.link)
        other.configure({})  # clears the fault
        with pytest.raises(DeviceRefusedError, match=r"position zero of .* is unknown"):
            position_zero(other, MARKED)


@pytest.mark.usefixtures("real")
def test_a_real_rig_whose_polarity_is_not_verified_does_not_search(tmp_path: Path) -> None:
    with powered_up(MARKED) as device:
        before = hardware_of(device).count
        with pytest.raises(ConfigError, match="polarity"):
            reference(device, MARKED, output=tmp_path, verified=False)
        assert hardware_of(device).count == before


def test_swapped_motor_leads_end_it_before_the_search(tmp_path: Path) -> None:
    with powered_up(MARKED) as device:
        hardware_of(device).drive = hardware_of(device).gain = -1.0
        with pytest.raises(IdentificationError, match="direction"):
            find(device, MARKED, tmp_path)
        (pulse,) = tmp_path.glob("*.parquet")
        assert last_effort(pulse) == 0.0
        assert abs(hardware_of(device).count) < 0.1 * EVERY


BROKEN = {
    "no switch": ({"switch_way": 0}, "no limit switch was found within"),
    "a broken wire of the switch": ({"switch_count": 10**9}, "still reported as pressed"),
    "no index": ({"index_counts": 0}, "no index was seen"),
    "noise on the index": ({"index_counts": EVERY // 4}, "indices were seen where exactly one is expected"),
    "a lost count": ({"index_counts": EVERY - 40}, f"{EVERY - 40} counts; described are {EVERY}"),
    "a switch beside the index": (
        {"switch_count": -round(0.31 * 40000 / (2 * np.pi))},
        "from the limit switch",
    ),
}


@pytest.mark.parametrize(
    ("what", "x"),
    first_by_default(
        [("no switch", BY_BOARD), ("no index", BY_BOARD), *((what, MARKED) for what in reversed(BROKEN))], 3
    ),
)
@pytest.mark.usefixtures("pushed_before")
def test_a_broken_switch_or_index_ends_the_search_at_rest_with_the_reason(
    what: str, x: Experiment, tmp_path: Path
) -> None:
    marks, message = BROKEN[what]
    with powered_up(x) as device:
        hardware_of(device).marks |= marks
        with pytest.raises(IdentificationError, match=message) as error:
            find(device, x, tmp_path)
        assert error.value.remedy
        assert device.reference_count is None
        assert device.active_parameters()["reference"] == 0
        assert all(last_effort(path) == 0.0 for path in tmp_path.glob("*.parquet"))


@pytest.mark.usefixtures("pushed_before")
@pytest.mark.parametrize("x", [MARKED, BY_BOARD], ids=["host", "board"])
def test_a_person_who_pushes_the_handle_in_the_search_ends_it_by_its_speed(
    x: Experiment, tmp_path: Path
) -> None:
    with powered_up(x) as device:

        def push(text: str) -> None:
            hardware_of(device).external_effort = -0.5 if "limit switch" in text else 0.0

        with pytest.raises(RigError, match=r"speed|window"):
            find(device, x, tmp_path, tell=push)
        (search,) = tmp_path.glob("*switch*.parquet")
        assert last_effort(search) == 0.0


@pytest.mark.usefixtures("pushed_before")
@pytest.mark.parametrize("x", [MARKED, BY_BOARD], ids=["host", "board"])
def test_a_handle_that_is_held_in_the_search_is_let_go_at_once(x: Experiment, tmp_path: Path) -> None:
    """A brake stronger than the servo holds the handle, so no edge comes; the device or the host ends the search."""
    with powered_up(x) as device:
        # As the search will: the plant of these ticks, shared by all tests.
        device.configure({"position_rate": 2000})
        parameters = hardware_of(device)._plant.parameters

        def hold(text: str) -> None:
            if "limit switch" in text:
                parameters[COULOMB] = 2.0 * MARKED.homing.effort

        try:
            with pytest.raises((DeviceFaultError, GuardError), match=r"no encoder edge|is blocked") as error:
                find(device, x, tmp_path, tell=hold)
        finally:
            parameters[COULOMB] = MARKED.rig.mechanics.motor_coulomb
        assert "a stop before the switch, or a hand" in error.value.remedy
        (search,) = tmp_path.glob("*switch*.parquet")
        rows = open_recording(search).rows
        assert rows["effort_sent"][-1] == 0.0
        assert abs(rows["effort_sent"]).max() <= MARKED.homing.effort * (1.0 + 1e-9)


LAW_ON_BOARD = {
    "controller.loop": "device", "controller.estimator": "fdm-butterworth-fixed",
    "controller.parameters.cutoff_hz": 200.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("at", "rows", "url", "changes"),
    [
        (-0.005, range(2, 10**6), "sim://", {}),
        (1.0, range(1, 2), "sim://", {}),
        (-0.005, range(2, 10**6), "sim://?firmware=1", LAW_ON_BOARD),
    ],
    ids=["reached", "broken wire", "law on the board"],
)
def test_the_switch_ends_a_run_when_it_is_reached_and_when_its_wire_is_broken(
    at: float, rows: range, url: str, changes: dict[str, Any], tmp_path: Path
) -> None:
    """Here the switch is within the window, which is wrong; at 1 rad it is pressed from the first sample on.

    The host sees a STATE every 5 ms, so it ends a law on the board some ticks later than one on the host.
    """
    x = config.override(MARKED, changes)
    with devices.open_device(url, config.rig_model(x)) as device:
        hardware_of(device).marks |= {"switch_count": round(at / x.rig.encoder.resolution)}
        with pytest.raises(GuardError, match="limit switch") as error:
            list(hit(HitRequest(experiment=x, device=device, output=tmp_path), admit))
        seen = open_recording(error.value.recording).rows  # type: ignore[attr-defined]
        assert len(seen) in rows
        pressed = (seen["inputs"] & int(Input.LIMIT_SWITCH)) != 0
        assert pressed[-1]
        assert not pressed[:-1].any()
        assert seen["effort_sent"][-1] == 0.0


class Hand:
    """A hand that pushes the handle against viscous damping, and turns back at the limit switch."""

    def __init__(self, device: FramedDevice, effort: float) -> None:
        self._hardware, self._states = hardware_of(device), device.states
        self._hardware.external_effort = effort
        device.states = self.states  # type: ignore[method-assign]

    def states(self, seconds: float) -> Any:
        found = self._states(seconds)
        if found and found[-1].inputs & Input.LIMIT_SWITCH:
            self._hardware.external_effort = abs(self._hardware.external_effort)
        return found


HEAVY = config.override(MARKED, {"rig.mechanics.motor_damping": 0.5})


def test_a_search_by_hand_finds_the_same_zero_with_the_motor_off(tmp_path: Path) -> None:
    with powered_up(HEAVY) as device:
        Hand(device, -0.5)
        found = find(device, HEAVY, tmp_path, by_hand=True)
        assert found.reference_count == hardware_of(device).slip
        assert found.index_counts == EVERY
        assert found.recordings == ()
        assert device.active_parameters()["reference"] == 1


def test_an_index_alone_is_enough_where_the_travel_holds_one(tmp_path: Path) -> None:
    alone = {"reference.limit_switch": "none", "reference.travel": 0.6, "reference.position": 0.2}
    window = {"limits.position_minimum": -0.3, "limits.position_maximum": 0.3}
    x = config.override(HEAVY, {f"rig.{name}": value for name, value in (alone | window).items()})
    with powered_up(x) as device:
        with pytest.raises(ConfigError, match="no limit switch to move to"):
            find(device, x, tmp_path)
        Hand(device, 0.3)
        assert find(device, x, tmp_path, by_hand=True).reference_count == hardware_of(device).slip


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("limit_switch", "none", "may contain more than one index"),
        ("index", False, 'must be "none" without an index'),
        ("travel", 0.7, "must be long enough to contain an index beyond the switch"),
        ("travel", 0.5, "be at least the position window"),
        ("index_distance", 1e-4, "must be at least 16 counts"),
    ],
)
def test_an_impossible_description_is_refused_by_its_key(key: str, value: Any, message: str) -> None:
    narrow = {"rig.limits.position_minimum": -0.3, "rig.limits.position_maximum": 0.3}
    with pytest.raises(ConfigError, match=message):
        config.override(MARKED, {**narrow, f"rig.reference.{key}": value})
