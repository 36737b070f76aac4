"""Test pushes whose limits of travel, effort and time the board enforces, also after the host has failed."""

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from rig import config
from rig.analysis.identification._quality import IdentificationError
from rig.config import presets
from rig.config.controller import effort_quantum
from rig.core.errors import PlanError
from rig.devices.fault_script import Faults
from rig.devices.framed import FramedDevice
from rig.experiments.motion import _board_pushes as board_pushes
from rig.experiments.motion.pulse import PUSHES, pulse
from rig.experiments.trials._identify_motions import PUSH_COUNTS, PUSH_S, REST_S, most_push, slow_rate, still
from rig.experiments.trials.replay import replay
from rig.recording.reader import open_recording
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.ends.link import MemoryLink
from tests.benchmarks.pulses import TickByTick
from tests.conformance.firmware import need_compiler
from tests.conformance.tiers import first_by_default

LIFETIME_S, RAMP_S = 0.1, 0.01
SUPERVISED = {"controller.loop": "device", "controller.supervise_lifetime_s": LIFETIME_S}
X = config.override(presets.load("koul-rigid"), {**SUPERVISED, "rig.amplifier.current_monitor": False})
AT = 0.02
MOST = round(most_push(X) / effort_quantum(X, X.rig.amplifier.current_quantum_a))  # quanta


class Watched(TickByTick):
    """A simulated board that logs count and active current in each tick of a session."""

    def __init__(self, *given: Any, **options: Any) -> None:
        self.log: list[tuple[int, int]] = []
        super().__init__(*given, **options)

    def tick(self) -> bytes:
        frames = super().tick()
        if self.session:
            self.log.append((int(self.hardware.count), self.current))
        return frames


@pytest.fixture(autouse=True)
def _has_compiler() -> None:
    need_compiler()


def board(**options: Any) -> tuple[FramedDevice, Watched]:
    device = Watched(config.rig_model(still(X)), initial_position=AT, **options)
    return FramedDevice(MemoryLink(device, Faults())), device


def push_without_stop(host: FramedDevice, way: Any, seconds: float) -> None:
    """Begin a push and then only renew its lifetime: the host never sends STOP."""
    at = board_pushes._at_rest(host, X, 0)
    host.configure(board_pushes._prepare_push(host, X, at, way, verified=True, zero=0).parameters)
    host.arm()
    host.supervise(seconds, round(1e6 * LIFETIME_S))


@pytest.mark.parametrize(("drive", "way"), first_by_default(product((1.0, -1.0, 2.0), (1, -1)), 2))
def test_the_board_cuts_in_the_tick_that_left_the_way_of_a_push(way: int, drive: float) -> None:
    """After a sample beyond the allowed travel the effort is zero, even if the host continues or leads are swapped."""
    host, device = board()
    device.hardware.drive = drive
    push_without_stop(host, way, REST_S + 2.0 * PUSH_S)
    count, current = np.transpose(device.log)
    left = int(np.flatnonzero(np.abs(count - count[0]) > PUSH_COUNTS)[0])
    assert 0 < np.max(way * current) <= MOST
    assert np.min(way * current) >= 0
    assert np.abs(current[left + 1 :]).max() == 0
    assert device.fault == Fault.NONE


def test_a_push_that_moves_nothing_is_over_by_itself() -> None:
    """The effort rises, is released and falls again, unless the board's own stall check ends the push first."""
    host, device = board()
    device.hardware.drive = 0.0
    push_without_stop(host, 1, REST_S + PUSH_S + X.trial.release_s + PUSH_S + 0.1)
    _, current = np.transpose(device.log)
    assert 0 < current.max() <= MOST
    assert device.current == 0


def test_a_host_that_falls_silent_leaves_zero_effort_behind() -> None:
    host, device = board()
    device.hardware.drive = 0.0
    push_without_stop(host, 1, REST_S + 0.3 * PUSH_S)
    assert (device.state, device.current > 0) == (State.RUNNING, True)
    begun = len(device.log)
    host.link.elapse(LIFETIME_S + RAMP_S + 0.02)  # type: ignore[attr-defined]
    assert (device.fault, device.current) == (Fault.LINK_LOST, 0)
    _, current = np.transpose(device.log)
    assert np.count_nonzero(current[begun:]) <= (LIFETIME_S + RAMP_S) * slow_rate(X) + 1
    assert current.max() <= MOST


def test_each_push_is_a_recording_that_replays_to_the_last_bit(tmp_path: Path) -> None:
    host = FramedDevice(MemoryLink(FirmwareDevice(config.rig_model(still(X)), initial_position=AT)))
    found = pulse(host, X, recording=tmp_path / "pulse.rigcap", verified=True, reference_count=0)
    assert found.ok
    assert host.moved_as_described
    files = [tmp_path / f"pulse{number}.parquet" for number in ("", "-2", "-3", "-4")]
    assert sorted(tmp_path.iterdir()) == sorted(files)
    assert found.recording == files[0]
    for number, path in enumerate(files, start=1):
        recording = open_recording(path)
        assert recording.header["extra"]["push"] == number
        assert recording.trailer is not None
        assert recording.trailer["device_host_agreement"]["holds"]
        assert recording.rows["effort_sent"][-1] == 0.0
        assert replay(recording).exact


def test_a_rig_that_hardly_rubs_rolls_out_before_the_next_push(tmp_path: Path) -> None:
    """The board has no brake, so only damping stops the handle; the measured rig must still match its description."""
    x = config.override(X, {"rig.mechanics.motor_coulomb": 0.0})
    device = FirmwareDevice(config.rig_model(still(x)), initial_position=AT)
    with FramedDevice(MemoryLink(device)) as host:
        found = pulse(host, x, recording=tmp_path / "pulse.rigcap", verified=True, reference_count=0)
    assert found.ok
    assert len(found.signs.pushes) == PUSHES


def test_a_board_that_runs_no_law_is_refused_at_rest_with_what_to_flash(tmp_path: Path) -> None:
    host, device = board(law_maximum=0)
    with pytest.raises(PlanError, match="cannot run the law itself") as refused:
        pulse(host, X, recording=tmp_path / "pulse.rigcap", verified=True, reference_count=0)
    assert "firmware" in refused.value.remedy
    assert not device.log
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("effort", [0.05, 0.0])
def test_a_handle_that_moves_or_that_a_person_moves_before_the_push_gets_none(
    effort: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    host, device = board()
    device.hardware.external_effort = effort
    own = board_pushes._prepare_push

    def pushed_by_a_hand(*given: Any, **named: Any) -> Any:
        device.hardware.external_effort = 0.05
        return own(*given, **named)

    monkeypatch.setattr(board_pushes, "_prepare_push", pushed_by_a_hand)
    with pytest.raises(IdentificationError, match="does not rest"):
        pulse(host, X, recording=tmp_path / "pulse.rigcap", verified=True, reference_count=0)
    assert not host.moved_as_described
    assert not any(current for _, current in device.log)
    assert not (effort and device.log), "a handle that moves is not even armed"
