"""Every column of a recording carries information: no two columns are equal in all runs."""

from collections.abc import Callable
from contextlib import suppress
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from rig import config
from rig.config import presets
from rig.core.errors import DeviceFaultError
from rig.core.sample import COLUMNS
from rig.devices.fault_script import Direction, FaultKind, Faults, FrameFault, Happening
from rig.devices.framed import FramedDevice
from rig.recording.reader import open_recording
from rig.recording.seal import seal
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.ends.link import MemoryLink
from tests.conformance.firmware import need_compiler
from tests.conformance.trials import trial_on

START = -0.015
LINE = tuple(
    FrameFault(kind=kind, direction=Direction.TO_HOST, frame=frame, ticks=2)
    for kind, frames in ((FaultKind.DROP, (200, 201, 202, 900, 901)), (FaultKind.DELAY, (1_000,)))
    for frame in frames
)
Rows = np.ndarray[Any, np.dtype[np.void]]


def _raise_edge(device: SimulatedDevice | FirmwareDevice) -> None:
    device.sync_input(True)
    if isinstance(device, SimulatedDevice):
        for _ in range(3):
            device.tick()  # its frames are not sent
        device.missed_ticks, device.worst_execution_time = 3, 700


def _throw_out(device: SimulatedDevice | FirmwareDevice) -> None:
    device.hardware.external_effort = 100.0


def rows_of(directory: Path, loop: str, device_of: Callable[..., Any]) -> Rows:
    """Return rows of a run in virtual time with gaps, a late frame and a sync edge, until the handle is thrown out."""
    experiment = config.override(
        presets.load("koul-compliant"),
        {
            "controller.position_rate": 2_000,
            "controller.velocity_rate": 500,
            "controller.loop": loop,
            "wall.position": 0.001,
            "homing.settle_s": 0.01,
        },
    )
    happenings = (Happening(700, _raise_edge), Happening(1_300, _throw_out))
    device = device_of(config.rig_model(experiment), initial_position=START)
    path = directory / f"{loop}-{device_of.__name__}.rigcap"
    with (
        suppress(DeviceFaultError),
        FramedDevice(MemoryLink(device, Faults(frames=LINE, device=happenings))) as host,
    ):
        trial_on(host, experiment, path, sealed=False)
    return np.asarray(seal(open_recording(path)).rows)


def equal_pairs(rows: Rows) -> set[tuple[str, str]]:
    names = [column.name for column in COLUMNS]
    return {(a, b) for a, b in combinations(names, 2) if np.array_equal(rows[a], rows[b], equal_nan=True)}


# Clocks are equal in virtual time, and the host needs no time to compute; in real time they differ.
EQUAL_IN_VIRTUAL_TIME = {("computed_at", "sent_at"), ("device_time", "sampled_at")}


def test_columns_equal_in_virtual_time_are_known(tmp_path: Path) -> None:
    need_compiler()
    devices = (("host", SimulatedDevice), ("host", FirmwareDevice), ("device", FirmwareDevice))
    runs = [rows_of(tmp_path, loop, device) for loop, device in devices]
    assert all((rows["elapsed_ticks"] > 1).any() for rows in runs)
    assert set.intersection(*map(equal_pairs, runs)) == EQUAL_IN_VIRTUAL_TIME
