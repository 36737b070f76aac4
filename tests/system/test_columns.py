"""No column of a recording says what another one says: wherever the law runs, some tick tells any two apart."""

from __future__ import annotations

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
from tests.conformance.far_end import patient_host
from tests.conformance.firmware import need_compiler
from tests.conformance.trials import trial_on

START = -0.015
LINE = tuple(
    FrameFault(kind=kind, direction=Direction.TO_HOST, frame=frame, ticks=2)
    for kind, frames in ((FaultKind.DROP, (200, 201, 202, 900, 901)), (FaultKind.DELAY, (1_000,)))
    for frame in frames
)
Rows = np.ndarray[Any, np.dtype[np.void]]


def _happen(device: SimulatedDevice | FirmwareDevice) -> None:
    """An edge comes; and what the owner of a board counts."""
    device.sync_input(True)
    if isinstance(device, SimulatedDevice):
        for _ in range(3):
            device.tick()  # nobody hears of it
        device.missed_ticks, device.worst_execution_time = 3, 700


def _throw(device: SimulatedDevice | FirmwareDevice) -> None:
    device.hardware.external_effort = 100.0


def rows_of(directory: Path, loop: str, device_of: Callable[..., Any]) -> Rows:
    """A run in virtual time with gaps, a late frame and an edge of the sync input, until the handle is thrown."""
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
    happenings = (Happening(700, _happen), Happening(1_300, _throw))
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


def rows_of_real_time(directory: Path, run: Callable[..., Any]) -> Rows:
    """Over a pseudo-terminal, however it ended: two clocks, and a computer that needs time."""
    options = ("--realtime", "--rate", "1k/500", "--set", "homing.settle_s=0.01", "--no-plot")
    with patient_host():
        run("hit", *options, "-o", directory)
    (path,) = directory.glob("*.parquet")
    return np.asarray(open_recording(path).rows)


def test_any_two_columns_differ_somewhere(tmp_path: Path, run: Callable[..., Any]) -> None:
    need_compiler()
    runs = [
        rows_of(tmp_path, loop, device)
        for loop, device in (("host", SimulatedDevice), ("host", FirmwareDevice), ("device", FirmwareDevice))
    ]
    assert all((rows["elapsed_ticks"] > 1).any() for rows in runs)
    runs.append(rows_of_real_time(tmp_path / "real-time", run))
    assert set.intersection(*map(equal_pairs, runs)) == set()
