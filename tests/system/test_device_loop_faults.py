"""The law on the device, the firmware itself as the far end: what can break on the way breaks, and no row is wrong.

In virtual time, over the true frames, with the shipped loop. What the device does depends on its own samples alone, so
a run whose frames to the host suffer must show the same samples as an undisturbed one, with gaps.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rig import config
from rig.cli import run
from rig.config import presets
from rig.core.errors import LinkLostError, StoppedError
from rig.core.sample import Phase
from rig.devices.fault_script import Direction, FaultKind, Faults, FrameFault
from rig.recording.seal import seal
from sim_backend.board.firmware import FirmwareDevice
from tests.conformance.firmware import need_compiler
from tests.conformance.struck import InMemory, StruckTrial
from tests.conformance.tiers import first_by_default

RATE = 5000
START = -0.015
EVERY = 4  # of the frames: each kind strikes others
SHORT = config.override(
    presets.load("koul-compliant"),
    {
        "controller.loop": "device",
        "controller.position_rate": RATE,
        "controller.velocity_rate": 1000,
        "controller.estimator": "fdm-butterworth-fixed",
        "trial.duration_s": 0.06,
        "trial.release_s": 0.01,
        "homing.settle_s": 0.005,
        "verdict.tail_s": 0.01,
    },
)


@pytest.fixture(scope="module", autouse=True)
def _compiler() -> None:
    need_compiler()


def bench(*frames: FrameFault) -> InMemory:
    device = FirmwareDevice(config.rig_model(SHORT), initial_position=START)
    return InMemory(device, Faults(frames=frames), rest_s=0.032)


def ran(directory: Path, *frames: FrameFault) -> StruckTrial:
    return StruckTrial(bench(*frames), directory, SHORT)


class Clean:
    """An undisturbed run: its samples, and which of its frames belong to the session."""

    def __init__(self, directory: Path) -> None:
        first = directory / "first"
        first.mkdir()
        ran(first)  # reads the dictionary: all others know it
        far_end = bench()
        sent: list[int] = []
        link_write = far_end.link.write

        def watched(data: bytes) -> None:
            link_write(data)
            if far_end.device.session and not sent:
                sent.extend(far_end.link.frames[way] for way in Direction)

        far_end.link.write = watched  # type: ignore[method-assign]
        trial = StruckTrial(far_end, directory, SHORT)
        self.frames = dict(far_end.link.frames)
        trial.check()
        assert trial.messages == ()
        self.first = dict(zip(Direction, sent, strict=True))
        self.rows = trial.rows


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Clean:
    return Clean(tmp_path_factory.mktemp("clean"))


def test_an_undisturbed_run_is_whole(clean: Clean) -> None:
    rows = clean.rows
    assert (rows["elapsed_ticks"] == 1).all()
    assert (np.diff(rows["sample_index"]) == 1).all()
    assert [int(phase) for phase in np.unique(rows["phase"])] == [1, 2, 3, 4, 5]
    assert (rows["phase"] == Phase.TRIAL).sum() == 0.06 * RATE
    assert np.abs(rows["current_applied"][1:] - rows["current_sent"][:-1]).max() <= 1


def test_timing_says_where_the_law_ran(
    clean: Clean, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = seal(ran(tmp_path).recording)
    extra, wall = recording.header["extra"], recording.experiment["wall"]
    assert (extra["loop"], extra["arithmetic"]) == ("device", "fixed")
    assert extra["wall"] == pytest.approx({name: wall[name] for name in extra["wall"]}, rel=1e-6)
    assert recording.header["identity"]["parameters"]["law"] == 1
    assert (recording.rows["sampled_at"] != 0).any()
    assert not recording.rows["applied_at"].any()
    found = recording.trailer["device_host_agreement"]  # type: ignore[index]
    assert (found["holds"], found["beyond"]) == (True, 0)
    assert found["compared"] > 0.8 * len(recording.rows)
    assert run(["recording", "timing", str(recording.path), "--no-plot"]) == 0
    said = capsys.readouterr().out
    assert "law on the device" in said
    assert "sent to applied" not in said
    assert "unanswered" not in said


@pytest.mark.parametrize("kind", first_by_default(FaultKind, 2))
def test_a_frame_to_the_host_that_suffers_is_a_counted_gap_and_never_a_wrong_row(
    kind: FaultKind, clean: Clean, tmp_path: Path
) -> None:
    """Frames from arming to the end, once each."""
    way, finished = Direction.TO_HOST, 0
    struck = range(clean.first[way] + list(FaultKind).index(kind) % EVERY, clean.frames[way], EVERY)
    true = dict(zip(clean.rows["sample_index"].tolist(), clean.rows["count"].tolist(), strict=True))
    applied = dict(
        zip(clean.rows["sample_index"].tolist(), clean.rows["current_applied"].tolist(), strict=True)
    )
    for frame in struck:
        place = tmp_path / str(frame)
        place.mkdir()
        fault = FrameFault(kind=kind, direction=way, frame=frame, byte=frame, bit=frame % 8)
        trial = ran(place, fault)
        trial.check(*((LinkLostError, StoppedError) if trial.error else ()))
        finished += trial.error is None
        rows = trial.rows
        for row in rows[["sample_index", "count", "current_applied"]].tolist():
            assert (true.get(row[0], row[1]), applied.get(row[0], row[2])) == row[1:], frame
        index = rows["sample_index"]
        assert rows["elapsed_ticks"][1:].tolist() == np.diff(index).tolist()
        lost = trial.counters["lost"]
        assert lost == rows["elapsed_ticks"].sum() - len(rows)
        assert lost == 0 or kind not in (FaultKind.DUPLICATE, FaultKind.DELAY)
    if kind not in (FaultKind.SILENCE, FaultKind.UNPLUG):
        assert finished == len(struck), "one bad frame is a counted loss, never the end of a run"


@pytest.mark.parametrize(
    "kind",
    first_by_default([kind for kind in FaultKind if kind not in (FaultKind.SILENCE, FaultKind.UNPLUG)], 2),
)
def test_a_word_of_the_host_that_suffers_changes_no_sample(
    kind: FaultKind, clean: Clean, tmp_path: Path
) -> None:
    """The device goes on for the lifetime of the last word that it understood: four times as long as they are apart."""
    way = Direction.TO_DEVICE
    for frame in range(clean.first[way] + 1, clean.frames[way], EVERY):
        place = tmp_path / str(frame)
        place.mkdir()
        fault = FrameFault(kind=kind, direction=way, frame=frame, byte=frame, bit=frame % 8)
        assert ran(place, fault).check().rows["count"].tolist() == clean.rows["count"].tolist()
