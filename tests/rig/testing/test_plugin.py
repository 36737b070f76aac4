"""The pytest plug-in: options, fixtures, one report for every frame, and its files."""

import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import rig
from rig.core.errors import ConfigError, LinkLostError
from rig.devices.fault_script import Direction, FaultKind, FrameFault
from rig.testing import Experiments, FaultWords, Hits, Maps, with_every_frame
from tests.conformance.tiers import first_by_default


def test_entry_point_and_p_are_one_plugin(suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    """pytest registers a plug-in once per name, so an entry point of another name would raise an error."""
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["pytest11"] == {"rig.testing.plugin": "rig.testing.plugin"}
    monkeypatch.delenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD")
    config = suite.parseconfig("-p", "rig.testing.plugin")
    assert config.pluginmanager.has_plugin("rig.testing.plugin")


def test_the_plugin_imports_nothing_heavy() -> None:
    program = (
        "import pytest, sys; before = set(sys.modules); import rig.testing.plugin; "
        "print(*(one for one in set(sys.modules) - before))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    brought = done.stdout.split()
    assert {module.partition(".")[0] for module in brought} == {"rig"}
    assert len(brought) < 10


class Rigless:
    """Replaces `rig_hit` by a link with seven frames to the device and six to the host."""

    def __init__(self, frames: int = 7) -> None:
        self.faults, self.frames = FaultWords(), frames
        self.last: Any = None
        self.played: list[FrameFault] = []

    def __call__(self) -> FrameFault | None:
        fault = self.faults.script.frames[-1] if self.faults.script else None
        self.last = SimpleNamespace(struck=0)
        if fault is not None and (fault.frame or 0) < self.frames - (fault.direction is Direction.TO_HOST):
            self.last.struck = 1
            self.played.append(fault)
        return fault


def test_every_kind_strikes_every_frame_of_each_direction_once() -> None:
    hits: Any = Rigless()
    with_every_frame(hits.__call__, hits, [], None)()
    assert Counter((fault.kind, fault.direction) for fault in hits.played) == {
        (kind, way): 7 if way is Direction.TO_DEVICE else 6 for kind in FaultKind for way in Direction
    }
    assert len(set(hits.played)) == 8 * 13
    assert hits.faults.script is None


def test_the_first_failing_frame_is_named_with_the_count_of_all() -> None:
    hits: Any = Rigless()

    def test() -> None:
        fault = hits()
        assert fault is None or fault.frame not in (3, 5), "not these"

    with pytest.raises(AssertionError, match="not these") as failed:
        with_every_frame(test, hits, ["drop", "delay"], "host")()
    note = "rig_every_frame: 4 of 12 faults fail; the first: drop of frame 3 to host"
    assert failed.value.__notes__ == [note]


@pytest.mark.parametrize(
    ("frames", "test", "message"),
    [
        (7, lambda hits: 0, "must hit by the fixture rig_hit, and this one does not"),
        (1 << 30, lambda hits: hits(), "more than 1000 frames; make it short"),
        (7, lambda hits: pytest.fail("broken without any fault"), "broken without any fault"),
    ],
)
def test_a_test_that_cannot_run_with_every_frame_has_a_reason(frames: int, test: Any, message: str) -> None:
    hits: Any = Rigless(frames)
    with pytest.raises(pytest.fail.Exception, match=message):
        with_every_frame(lambda: test(hits), hits, ["drop"], "host")()


def test_a_persons_stop_ends_it_at_once() -> None:
    hits: Any = Rigless()

    def test() -> None:
        if hits():
            pytest.exit("stopped")

    with pytest.raises(pytest.exit.Exception, match="stopped"):
        with_every_frame(test, hits, ["drop"], "host")()
    assert len(hits.played) == 1


def test_the_marker_is_known_and_its_mistakes_are_reported(suite: pytest.Pytester) -> None:
    suite.makepyfile(
        """
        import pytest

        @pytest.mark.rig_every_frame("drop")
        def test_without_a_hit():
            pass

        @pytest.mark.rig_every_frame("melt")
        def test_of_nonsense(rig_hit):
            pass
        """
    )
    result = suite.runpytest_inprocess()
    result.assert_outcomes(failed=2)
    result.stdout.re_match_lines(
        [
            r".*hits through rig_hit, and this one does not request it",
            r".*'melt' is not a fault of frames; choose one of: drop, corrupt",
        ]
    )


@pytest.mark.parametrize(
    ("mode", "kept"), first_by_default([("failed", ["fails"]), ("all", ["fails", "passes"]), ("none", [])])
)
def test_recordings_are_kept_as_asked_and_listed(suite: pytest.Pytester, mode: str, kept: list[str]) -> None:
    suite.makepyfile(
        test_it="""
        def test_passes(rig_hit, rig_experiment):
            rig_hit(rig_experiment.short())

        def test_fails(rig_hit, rig_experiment):
            assert rig_hit(rig_experiment.short()) is None
        """
    )
    result = suite.runpytest_inprocess("--rig-record", mode)
    result.assert_outcomes(passed=1, failed=1)
    place = suite.path / "rig-recordings"
    found = sorted(path.parent.name for path in place.glob("*/*.parquet"))
    assert found == [f"test_it.py_test_{name}" for name in kept]
    assert place.exists() == bool(kept)
    assert (f"recordings of {len(kept)} tests: {place}" in result.stdout.str()) == bool(kept)


def test_golden_recordings_are_compared(suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    suite.makepyfile(
        test_it="""
        import os

        def test_it(rig_hit, rig_experiment, rig_golden):
            rig_golden(rig_hit(rig_experiment.short(None, {"wall.stiffness": 80.0})), "soft wall")
            stiffness = float(os.environ.get("STIFFNESS", 60.0))
            rig_golden(rig_hit(rig_experiment.short(None, {"wall.stiffness": stiffness})), "soft_wall")
        """
    )
    suite.runpytest_inprocess().stdout.fnmatch_lines(["*there is no golden recording *--rig-golden=update*"])
    suite.runpytest_inprocess("--rig-golden=update").assert_outcomes(passed=1)
    assert {path.name for path in (suite.path / "golden").iterdir()} == {
        "test_it.test_it.soft%20wall.parquet",
        "test_it.test_it.soft_wall.parquet",
    }
    monkeypatch.setenv("STIFFNESS", "61")
    result = suite.runpytest_inprocess()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            "*differs from the golden recording from row * on (* ms, trial), in * columns; there:",
            "*effort_wall: * N·m, was * (by *, allowed *)",
            "*golden: *.soft_wall.parquet",
            "*if today's recording is right, run: pytest --rig-golden=update",
        ]
    )


def test_experiments_come_by_name_by_path_beside_the_test_and_as_a_parameter(suite: pytest.Pytester) -> None:
    suite.path.joinpath("mine.toml").write_text('preset = "koul-rigid"\n[wall]\nstiffness = 123.0\n')
    suite.makepyfile(
        """
        import pytest

        @pytest.mark.parametrize("rig_experiment", ["mine.toml", "koul-rigid"], indirect=True)
        def test_it(rig_experiment, rig_device):
            assert rig_experiment().rig.name == "koul-rigid" == rig_device.dictionary.device
            assert rig_experiment("mine.toml").wall.stiffness == 123.0
            assert rig_experiment("koul-compliant", {"wall.damping": 0.25}).wall.damping == 0.25
        """
    )
    suite.runpytest_inprocess().assert_outcomes(passed=2)


# ---------------------------------------------------------------------- the fixtures themselves


def test_without_scripted_faults_an_early_end_is_an_error(rig_hit: Hits, rig_experiment: Experiments) -> None:
    far = {"homing.timeout_s": 0.01, "rig.simulation.initial_position": 0.1}
    with pytest.raises(rig.RigError, match="start"):
        rig_hit(rig_experiment.short(None, far))


def test_with_scripted_faults_an_early_end_is_the_error_of_the_hit_and_an_invalid_wall_is_still_refused(
    rig_hit: Hits, rig_faults: FaultWords, rig_experiment: Experiments
) -> None:
    rig_faults.link("unplug", tick=20)
    hit = rig_hit(rig_experiment.short())
    assert isinstance(hit.error, LinkLostError)
    assert hit.path.is_file()
    assert hit.verdict.kind == "invalid"
    with pytest.raises(ConfigError, match="stiffness"):
        rig_hit(None, {"wall.stiffness": -1.0})


def test_a_scripted_fault_latches(rig_hit: Hits, rig_faults: FaultWords, rig_experiment: Experiments) -> None:
    seen: list[int] = []
    rig_faults.at(10, lambda device: seen.append(device.sample_index))
    rig_faults.device("ENCODER", tick=30)
    hit = rig_hit(rig_experiment.short())
    assert len(seen) == 1
    assert hit.recording.trailer is not None
    assert hit.recording.trailer["fault"]["name"] == "ENCODER"


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ({"kind": "melt", "frame": 1}, "'melt' is not a fault"),
        ({"kind": "drop", "frame": 1, "to": "cloud"}, "to = 'cloud' is not a direction of frames"),
        ({"kind": "drop"}, "exactly one of frame"),
        ({"kind": "drop", "frame": 1, "tick": 1}, "exactly one of frame"),
    ],
)
def test_unknown_words_are_refused(rig_faults: FaultWords, given: dict[str, object], what: str) -> None:
    with pytest.raises(ConfigError, match=what):
        rig_faults.link(**given)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"unknown fault 'RUST'; choose one of: .*ENCODER"):
        rig_faults.device("RUST", tick=1)
    assert rig_faults.script is None


def test_a_map_of_the_simulated_rig(rig_zwidth: Maps) -> None:
    short = {"trial.duration_s": 0.3, "verdict.tail_s": 0.1, "homing.settle_s": 0.02}
    ladder = {"lowest": 10.0, "highest": 100.0, "ratio": 3.0}
    found = rig_zwidth("koul-rigid", short, schemes=["uniform:20k"], dampings=[0.3], **ladder)
    assert found.hits == 6, "three rungs at two places of zero in an encoder's cell"
    assert [boundary.stiffness for boundary in found.curve(0, "felt")] == [90.0]
