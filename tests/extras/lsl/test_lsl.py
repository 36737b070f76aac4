"""Lab Streaming Layer over loopback: inlets receive the loop's rows, with their times and units."""

import json
import os
import re
import time
import uuid
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig import config, devices
from rig.config import presets
from rig.core.errors import RigError
from rig.core.model import Simulation
from rig.core.sample import Phase
from rig.devices import local
from rig.devices.framed import FramedDevice
from rig.extras.lsl.session import LslMarks
from rig.extras.lsl.streams import CHANNELS
from rig.recording.marks import marks as found_marks
from rig.recording.reader import open_recording
from rig.session.engine._desk import Desk, Question, Reply
from rig.session.engine._directory import LOG
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import read
from rig.session.engine._rehearsal import Day, Person, RehearsalDesk
from rig.session.engine._run import run_session
from rig.session.engine._telling import line_of_event
from tests.conformance.lsl_loop import OFFSET_NS, HandTurnedLoop
from tests.conformance.trials import trial_on
from tests.system.session_study import PROTOCOL

SHORT = config.override(
    config.with_realtime(presets.load("koul-compliant")),
    {"trial.duration_s": 0.3, "trial.release_s": 0.05, "homing.settle_s": 0.05, "verdict.tail_s": 0.05},
)
CONFIGURATION = """\
[ports]
IPv6 = disable
[multicast]
ResolveScope = machine
[lab]
KnownPeers = {{127.0.0.1}}
SessionID = {session}
[log]
level = -3
"""
FIND_S = 20.0


@pytest.fixture(scope="module")
def pylsl(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """The library, restricted to this machine and to this process's tests; child processes inherit this.

    It reads its configuration once, when it is loaded: every module that has this fixture gets the same session.
    """
    path = tmp_path_factory.mktemp("lsl") / "lsl_api.cfg"
    path.write_text(CONFIGURATION.format(session=f"rig-{os.getpid()}"))
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("LSLAPICFG", str(path))
        try:
            import pylsl  # noqa: PLC0415
        except ImportError:
            pytest.skip("pylsl is not installed")
        except RuntimeError:
            pytest.skip("liblsl is not installed")
        yield pylsl


class Inlets:
    def __init__(self, pylsl: Any, name: str) -> None:
        self.streams = {}
        for kind in ("samples", "markers"):
            (info,) = pylsl.resolve_byprop("name", f"{name} {kind}", timeout=FIND_S)
            self.streams[kind] = pylsl.StreamInlet(info)
            self.streams[kind].open_stream(timeout=FIND_S)
        self.values: list[list[float]] = []
        self.stamps: list[float] = []
        self.markers: list[tuple[float, dict[str, Any]]] = []

    def pull(self) -> None:
        values, stamps = self.streams["samples"].pull_chunk(timeout=0.05, max_samples=100_000)
        self.values += values
        self.stamps += stamps
        texts, times = self.streams["markers"].pull_chunk(timeout=0.0)
        self.markers += [(at, json.loads(text[0])) for at, text in zip(times, texts, strict=True)]

    def forget(self) -> None:
        self.values, self.stamps, self.markers = [], [], []

    def offset_s(self) -> float:
        clock = self.streams["samples"].info(FIND_S).desc().child("clock")
        return float(clock.child_value("offset_s"))

    def pull_until(self, mark: str) -> None:
        deadline = time.monotonic() + FIND_S
        while mark not in [content["mark"] for _, content in self.markers]:
            assert time.monotonic() < deadline, self.markers
            self.pull()
        self.pull()

    def units(self) -> dict[str, str]:
        described = self.streams["samples"].info(FIND_S).as_xml()
        return dict(re.findall(r"<label>(.*?)</label>\s*<unit>(.*?)</unit>", described))


@pytest.fixture(scope="module")
def streamed(pylsl: Any) -> Iterator[tuple[LslMarks, Inlets]]:
    name = f"test-{uuid.uuid4().hex[:8]}"
    with LslMarks(name=name, expected=("rotary", 1000.0)) as marks:
        marks.wait()
        yield marks, Inlets(pylsl, name)


def test_streams_say_their_rate_units_and_clock(streamed: tuple[LslMarks, Inlets]) -> None:
    _, inlets = streamed
    assert inlets.streams["samples"].info(FIND_S).nominal_srate() == 1000.0
    assert inlets.units() == {
        "position": "rad", "velocity": "rad/s", "penetration": "rad", "effort_sent": "N·m",
        "effort_applied": "N·m", "phase": "1",
    }  # fmt: skip
    assert abs(inlets.offset_s()) < 1.0


def test_inlets_receive_every_row_at_its_time_and_what_a_session_marks(
    streamed: tuple[LslMarks, Inlets],
) -> None:
    marks, inlets = streamed
    inlets.forget()
    offset_s = inlets.offset_s()
    marks.push("begins", at_ns=1_000_000_007, trial=7, stiffness=560.0, condition="dual-rate")
    inlets.pull_until("begins")
    loop = HandTurnedLoop(4096, shared=True)
    loop.compare_clocks()
    try:
        for phase in (Phase.HOMING, Phase.TRIAL, Phase.RELEASE):
            loop.leave(400, phase=int(phase), flags=1)
            loop.compare_clocks()
            inlets.pull_until("phase")  # it is followed
    finally:
        loop.end()
    inlets.pull_until("end")
    marks.push("verdict", verdict="buzz")
    inlets.pull_until("verdict")
    loop.ring.close()
    wanted = np.stack([loop.published[channel].astype(float) for channel in CHANNELS], axis=1)
    assert np.array_equal(np.array(inlets.values), wanted)
    expected_s = (loop.published["device_time"] + OFFSET_NS) * 1e-9 + offset_s
    assert np.abs(np.array(inlets.stamps) - expected_s).max() < 1e-8
    at = {content["mark"]: (stamp, content) for stamp, content in inlets.markers}
    assert at["begins"] == (pytest.approx(1.000000007 + offset_s, abs=1e-8), {"mark": "begins", "trial": 7})
    assert at["verdict"][1] == {"trial": 7, "mark": "verdict", "verdict": "buzz"}
    assert at["contact"][0] == pytest.approx(expected_s[400], abs=1e-8)
    assert {content["trial"] for _, content in inlets.markers} == {7}
    text = json.dumps([content for _, content in inlets.markers])
    assert "560" not in text, "a session is blind unless it says otherwise"
    assert "dual-rate" not in text


@pytest.mark.quiet
def test_a_hit_in_real_time_is_streamed_as_it_is_recorded(
    streamed: tuple[LslMarks, Inlets], tmp_path: Path
) -> None:
    _, inlets = streamed
    inlets.forget()
    path = tmp_path / "trial.rigcap"
    model = config.rig_model(SHORT)
    with (
        local.serve_locally("sim://", replace(model, simulation=Simulation(initial_position=-0.015))) as url,
        FramedDevice(devices.open_link(url, model)) as device,
    ):
        trial_on(device, experiment=SHORT, recording=path, verified=True, seed=0)
    inlets.pull_until("end")
    recording = open_recording(path.with_suffix(".parquet"))
    end = inlets.markers[-1][1]
    assert (end["reason"], end["rows"], end["lost"]) == ("finished", len(recording), 0)
    wanted = np.stack([recording.rows[channel].astype(float) for channel in CHANNELS], axis=1)
    assert np.array_equal(np.array(inlets.values), wanted)
    assert recording.trailer is not None
    clock = recording.trailer["clock"]
    bound_s = next(content["bound_s"] for _, content in inlets.markers if content["mark"] == "clock")
    # Two fits of the same clocks: one at the run's begin, one of all of it.
    allowed_s = bound_s + (clock["asymmetry_bound_ns"] + 3 * clock["offset_sd_ns"]) * 1e-9 + 1e-7
    difference = np.array(inlets.stamps) - inlets.offset_s() - recording.rows["sampled_at"] * 1e-9
    assert np.abs(difference).max() <= allowed_s
    assert (np.diff(inlets.stamps) >= 0).all()
    named = {"trial": "trial", "release": "release", "contact": "contact"}
    streamed_at = [
        (name, content["tick"])
        for _, content in inlets.markers
        if (name := named.get(content.get("phase", content["mark"]))) is not None
    ]
    assert streamed_at == [(one.name, one.tick) for one in found_marks(recording) if one.name in named]


def test_a_session_continues_without_the_process_that_streams(
    pylsl: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    failing = tmp_path / "python"
    failing.write_text("#!/bin/sh\necho no outlet is possible >&2\nexit 2\n")
    failing.chmod(0o755)
    monkeypatch.setattr("rig.extras.lsl.session.sys.executable", str(failing))
    marks = LslMarks()
    with pytest.raises(RigError, match="no outlet is possible"):
        marks.wait()
    for _ in range(3):
        marks.push("begins", trial=1)
    marks.push("odd", items=["x" * 5000])
    assert marks.lost == 4
    assert marks.close() is None
    assert marks.close() is None
    for reason in ("no longer accepts markers", "a marker longer than"):
        assert [reason in record.message for record in caplog.records].count(True) == 1


PERSON = Person(thresholds={})


@pytest.mark.exhaustive("::test_inlets_receive_every_row_at_its_time_and_what_a_session_marks")
def test_markers_of_a_session_are_its_log_without_the_walls(pylsl: Any, tmp_path: Path) -> None:
    protocol = tmp_path / "one.toml"
    protocol.write_text(
        PROTOCOL[: PROTOCOL.index("[[question]]")].replace("[order]", "[stop]\ntrials = 1\n[order]")
    )
    received: list[dict[str, Any]] = []

    class Recording(RehearsalDesk):
        """A desk that opens inlets at the first question and reads them at the second."""

        def ask(self, question: Question) -> Reply:
            if question.kind == "ready":
                self.inlets = Inlets(pylsl, "haptic-rig")
            elif question.kind == "verdict":
                self.inlets.pull_until("trial")
                received.extend(content for _, content in self.inlets.markers)
            return super().ask(question)

    def sit(*about: Any) -> Desk:
        return Recording(PERSON, Day())

    result = run_session(
        protocol, "P01", sit, runner=DeviceRunner(), study=tmp_path, person=PERSON, marks="lsl"
    )
    assert result.trials == 1
    events = read(tmp_path / "P01" / LOG)
    logged = [event for event in events if event.kind not in ("began", "streamed")]
    (trial,) = (event for event in events if event.kind == "trial")
    named = {one["mark"]: one for one in received}
    assert list(named)[-2:] == ["begins", "trial"]
    assert named["trial"]["text"] == line_of_event(trial)
    assert named["begins"]["trial"] == trial.content["trial"] == 1
    assert not any(word in json.dumps(received) for word in ("hidden", "stiffness", "0.211"))
    (streamed,) = (event.content for event in events if event.kind == "streamed")
    assert streamed["lost_markers"] == 0
    assert streamed["sent"]["markers"] == len(logged) + 1  # and the beginning of the trial
