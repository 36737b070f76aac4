"""A cut of a recording is a recording too: it opens, shows, exports and replays exactly, and names its origin."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import rig
from rig import config
from rig.cli.replay import replay as replay_command
from rig.cli.show import show
from rig.config import presets
from rig.control.verdict import Kind
from rig.core.errors import RecordingError
from rig.core.sample import Phase
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.experiments.trials.cutting import cut_recording
from rig.experiments.trials.judgement import experiment_of, judge
from rig.experiments.trials.replay import replay
from rig.recording.cutting import cut, write_cut
from rig.recording.data import Recording
from rig.recording.export import export
from rig.recording.origin import cut_facts
from rig.recording.reader import open_facts, open_recording

SHORT = {"trial.duration_s": 0.2, "trial.release_s": 0.02, "homing.settle_s": 0.02, "verdict.tail_s": 0.05}


@pytest.fixture(scope="module")
def uncut(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    x, output = config.override(presets.load("koul-compliant"), SHORT), tmp_path_factory.mktemp("whole")
    (done,) = hit(HitRequest(experiment=x, output=output, name="one"), admit)
    return done.recording


def place(recording: Recording) -> Path:
    assert recording.path is not None
    return recording.path


def part_to_cut(uncut: Recording, name: str) -> tuple[float, float]:
    """Return start and end (s) of a part to cut."""
    times, phases = uncut.time_s, uncut.rows["phase"]
    contact = float(times[np.argmax(uncut.rows["penetration"] > 0.0)])
    trial = float(times[np.argmax(phases == Phase.TRIAL)])
    return {
        "homing": (0.2 * trial, 0.7 * trial),
        "contact": (contact - 0.013, contact + 0.021),
        "beginning": (0.0, contact),
        "end": (contact, times[-1]),
        "all": (0.0, times[-1]),
    }[name]


@pytest.mark.parametrize("part", ["homing", "contact", "beginning", "end", "all"])
def test_a_cut_has_the_rows_between_and_replays_exactly(part: str, uncut: Recording, tmp_path: Path) -> None:
    first_s, last_s = part_to_cut(uncut, part)
    result = cut_recording(place(uncut), first_s, last_s, output=tmp_path)
    made = open_recording(result.path)
    inside = (uncut.time_s >= first_s) & (uncut.time_s <= last_s)
    assert made.names == uncut.names
    for name in made.names:
        assert made.column(name).tobytes() == uncut.rows[name][inside].tobytes(), name
    assert (made.complete, made.lost, len(made)) == (True, (), result.rows)
    assert result.no_replay == ""
    again = replay(made)
    assert again.exact
    np.testing.assert_array_equal(again.rows["effort_wanted"], replay(uncut).rows["effort_wanted"][inside])


def test_the_header_of_a_cut_names_recording_place_and_time(uncut: Recording, tmp_path: Path) -> None:
    result = cut_recording(place(uncut), 0.05, 0.15, output=tmp_path)
    assert result.path.name == "one-cut.parquet"
    facts = cut_facts(open_facts(result.path))
    assert facts is not None
    assert facts["recording"] == place(uncut).name
    # A session's log contains the same hash.
    assert facts["sha256"] == hashlib.sha256(place(uncut).read_bytes()).hexdigest()
    assert facts["first_tick"] == facts["rows_before"] > 0
    assert facts["rows_before"] + result.rows + facts["rows_after"] == len(uncut)
    assert 0.05 <= facts["first_s"] == result.first_s < result.last_s == facts["last_s"] <= 0.15
    assert facts["cut_at"] > uncut.header["created"]
    assert open_facts(result.path).header["created"] == uncut.header["created"], "when the trial took place"
    assert cut_facts(uncut) is None
    zero_ns = int(uncut.rows["device_time"][40])
    shifted = rig.cut_recording(place(uncut), 0.01, 0.02, output=tmp_path, zero_ns=zero_ns)
    assert shifted.path.name == "one-cut-2.parquet"
    assert shifted.first_s == pytest.approx(uncut.time_s[40] + 0.01, abs=1e-9)


def test_a_cut_of_a_cut_replays_too(uncut: Recording, tmp_path: Path) -> None:
    outer = cut_recording(place(uncut), *part_to_cut(uncut, "contact"), output=tmp_path)
    inner = cut_recording(outer.path, 0.0, 0.01)
    made = open_recording(inner.path)
    assert inner.path.parent == tmp_path
    assert (cut_facts(made) or {})["recording"] == outer.path.name
    assert replay(made).exact


def test_another_law_is_refused_in_the_middle_not_from_the_start(uncut: Recording, tmp_path: Path) -> None:
    changes = {"controller.estimator": "fdm"}
    middle = open_recording(cut_recording(place(uncut), 0.05, 0.15, output=tmp_path).path)
    with pytest.raises(RecordingError, match="middle of a trial") as refused:
        replay(middle, changes)
    assert place(uncut).name in refused.value.remedy
    beginning = open_recording(cut_recording(place(uncut), 0.0, 0.15, output=tmp_path).path)
    np.testing.assert_array_equal(
        replay(beginning, changes).rows["velocity"], replay(uncut, changes).rows["velocity"][: len(beginning)]
    )


def test_a_wall_that_changed_before_the_cut_or_in_it_is_replayed(uncut: Recording, tmp_path: Path) -> None:
    tick = len(uncut) // 2
    law = uncut.header["initial_state"]["law"]["parameters"]
    softer = {
        "tick": tick,
        "wall_position": uncut.header["initial_state"]["control"]["wall_position"],
        "parameters": [law[0], law[1] / 2, *law[2:]],
    }
    trailer: dict[str, Any] = {**(uncut.trailer or {}), "parameter_sets": [softer]}
    rows = uncut.rows.copy()
    computed = replay(replace(uncut, trailer=trailer)).rows
    for name in computed.dtype.names or ():
        rows[name] = computed[name]
    changed = replace(uncut, rows=rows, trailer=trailer)
    assert replay(changed).exact
    path = write_cut(cut(changed, 0.0, float(changed.time_s[-1]), changed.header["initial_state"]), tmp_path)
    times = changed.time_s
    for first, last in ((tick - 30, tick + 30), (tick, tick + 30), (tick + 10, tick + 60)):
        made = open_recording(cut_recording(path, times[first], times[last], output=tmp_path).path)
        assert (made.rows["tick"][0], len(made)) == (first, last - first + 1)
        assert replay(made).exact


def test_a_cut_has_no_verdict_of_its_own_and_is_shown_and_exported(uncut: Recording, tmp_path: Path) -> None:
    for part in ("contact", "beginning"):
        path = cut_recording(place(uncut), *part_to_cut(uncut, part), output=tmp_path).path
        made = open_recording(path)
        found = judge(made, experiment_of(made)).verdict
        assert found.kind == Kind.INVALID
        assert found.reasons[0] == "a part of a trial: its verdict is that of one.parquet"
    shown = CliRunner().invoke(show, [str(path)])
    assert shown.exit_code == 0, shown.output
    assert "one.parquet" in shown.output
    assert json.loads(CliRunner().invoke(replay_command, [str(path), "--json"]).output)["exact"]
    export(path, tmp_path / "cut.csv")


def test_an_impossible_cut_is_refused_one_without_replay_is_made(uncut: Recording, tmp_path: Path) -> None:
    for first_s, last_s in ((5.0, 6.0), (-2.0, -1.0), (0.1, 0.05), (0.1, 0.1)):
        with pytest.raises(RecordingError, match="fewer than 2 rows") as refused:
            cut(uncut, first_s, last_s)
        assert "rows from 0 to" in refused.value.remedy
    holed = replace(uncut, rows=np.delete(uncut.rows, 100))
    with pytest.raises(RecordingError, match="no rows for 1 control ticks"):
        cut(holed, 0.0, float(uncut.time_s[150]))
    after = cut(holed, float(uncut.time_s[101]), float(uncut.time_s[200]))
    path = write_cut(after, tmp_path)
    with pytest.raises(RecordingError, match="cannot be replayed up to that place"):
        replay(open_recording(path))
    beheaded = cut_recording(path, 0.0, 0.05)
    assert "cannot be replayed up to that place" in beheaded.no_replay
    assert beheaded.rows > 2
