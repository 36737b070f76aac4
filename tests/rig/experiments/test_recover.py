"""Recovery after a crash: every capture is sealed, losses are reported, and a capture in use is left alone."""

import json
import os
from pathlib import Path

import pytest

import rig.cli
from rig.config import as_mapping
from rig.config.presets import load
from rig.core.errors import ConfigError
from rig.core.sample import ROW
from rig.experiments.trials.recover import CaptureState, Recovered, failed, recover, unsealed
from rig.realtime.control_words import LOOP_DONE
from rig.realtime.ring import Ring
from rig.recording._capture import write_capture
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from rig.recording.recorder import AT_RISK_S, Recorder
from tests.conformance.recording import example_header, example_rows

EXPERIMENT = as_mapping(load("koul-compliant"))
RATE = EXPERIMENT["controller"]["position_rate"]
ROWS = 300
BLOCK = 100


def write(path: Path, *, whole: bool = False, kind: str = "monotonic") -> Recording:
    """Write a capture of three blocks with an old modification time; with `whole`, also its end record."""
    header = example_header(experiment=EXPERIMENT, clocks={"kind": kind})
    recording = Recording(header, example_rows(ROWS), {"reason": "finished"}, whole)
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "wb") as file:
        write_capture(file, recording, block_rows=BLOCK)
    os.utime(path, (1e9, 1e9))
    return recording


def recover_one(path: Path) -> Recovered:
    (result,) = recover([path])
    return result


def test_a_capture_cut_off_is_sealed_and_at_most_a_second_is_missing(tmp_path: Path) -> None:
    written = write(tmp_path / "trial.rigcap")
    found = recover_one(tmp_path)
    assert (found.outcome, found.complete, found.rows_lost) == (CaptureState.SEALED, False, 0)
    assert (found.rows, found.duration_s) == (ROWS, pytest.approx(ROWS / RATE))
    assert found.lost_at_most_s == pytest.approx(AT_RISK_S) == 1.0
    assert found.recording == tmp_path / "trial.parquet"
    sealed = open_recording(found.recording)
    assert sealed.rows.tobytes() == written.rows.tobytes()
    assert not sealed.complete
    assert not (tmp_path / "trial.rigcap").exists()
    assert recover([tmp_path]) == []


@pytest.mark.parametrize("cut", [1, 7, 100, ROW.itemsize * BLOCK // 2])
def test_a_torn_tail_costs_its_block(tmp_path: Path, cut: int) -> None:
    capture = tmp_path / "trial.rigcap"
    written = write(capture)
    capture.write_bytes(capture.read_bytes()[:-cut])
    found = recover_one(capture)
    assert (found.outcome, found.rows, found.rows_lost) == (CaptureState.SEALED, ROWS - BLOCK, BLOCK)
    assert found.lost_at_most_s == pytest.approx(1.0 + BLOCK / RATE)
    assert found.recording is not None
    assert open_recording(found.recording).rows.tobytes() == written.rows[: ROWS - BLOCK].tobytes()


def test_damage_in_the_middle_is_counted(tmp_path: Path) -> None:
    capture = tmp_path / "trial.rigcap"
    write(capture, whole=True)
    data = bytearray(capture.read_bytes())
    data[len(data) // 2] ^= 1
    capture.write_bytes(data)
    os.utime(capture, (1e9, 1e9))
    found = recover_one(capture)
    assert (found.outcome, found.rows, found.rows_lost) == (CaptureState.SEALED, ROWS - BLOCK, BLOCK)
    assert (found.complete, found.lost_at_most_s) == (True, pytest.approx(BLOCK / RATE))


# In virtual time rows reach the disk by blocks, not by age.
@pytest.mark.parametrize(("whole", "kind", "lost_s"), [(True, "monotonic", 0.0), (False, "virtual", None)])
def test_the_loss_depends_on_the_clock(tmp_path: Path, whole: bool, kind: str, lost_s: float | None) -> None:
    write(tmp_path / "trial.rigcap", whole=whole, kind=kind)
    found = recover_one(tmp_path)
    assert (found.outcome, found.complete, found.lost_at_most_s) == (CaptureState.SEALED, whole, lost_s)


def test_a_directory_is_searched_to_the_bottom_for_unsealed_captures(tmp_path: Path) -> None:
    for name in ("a.rigcap", "deep/er/b.rigcap", "sealed.rigcap"):
        write(tmp_path / name)
    (tmp_path / "sealed.parquet").write_text("precious")
    (tmp_path / "notes.txt").write_text("not ours")
    assert unsealed([tmp_path]) == [tmp_path / "a.rigcap", tmp_path / "deep/er/b.rigcap"]
    assert unsealed([tmp_path, tmp_path / "a.rigcap"]) == unsealed([tmp_path])
    with pytest.raises(ConfigError, match="does not exist"):
        unsealed([tmp_path / "absent"])
    seen: list[tuple[int, int, Path]] = []
    found = recover([tmp_path], progress=lambda *step: seen.append(step))
    assert [result.outcome for result in found] == [CaptureState.SEALED, CaptureState.SEALED]
    assert seen == [(0, 2, tmp_path / "a.rigcap"), (1, 2, tmp_path / "deep/er/b.rigcap")]
    assert (tmp_path / "sealed.rigcap").exists()


def test_a_draft_of_a_sealing_that_was_killed_goes_with_the_capture(tmp_path: Path) -> None:
    write(tmp_path / "trial.rigcap")
    mine, other = tmp_path / ".trial.parquet.4711.draft", tmp_path / ".trial-2.parquet.4711.draft"
    for draft in (mine, other):
        draft.write_text("half")
    assert recover_one(tmp_path).outcome == CaptureState.SEALED
    assert not mine.exists()
    assert other.exists()


@pytest.mark.parametrize("damage", [b"", b"\x89RIGCAP\n", b"something else"])
def test_a_destroyed_capture_is_named_and_the_others_are_still_sealed(tmp_path: Path, damage: bytes) -> None:
    (tmp_path / "a.rigcap").write_bytes(damage)
    write(tmp_path / "b.rigcap")
    first, second = recover([tmp_path])
    assert (first.outcome, second.outcome) == (CaptureState.FAILED, CaptureState.SEALED)
    assert (tmp_path / "a.rigcap").read_bytes() == damage
    error = failed([first, second])
    assert error is not None
    assert "a.rigcap" in str(error)
    assert failed([second]) is None


def test_a_capture_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "trial.rigcap"
    header = example_header(experiment=EXPERIMENT, clocks={"kind": "monotonic"})
    with Recorder(path, header, Ring.allocate(4)):
        before = path.read_bytes()
        found = recover_one(tmp_path)
        assert (found.outcome, path.read_bytes()) == (CaptureState.IN_USE, before)
        assert "another process is writing it" in found.reason
    found = recover_one(tmp_path)  # whole, but so young that its run may be about to seal it
    assert (found.outcome, path.exists()) == (CaptureState.IN_USE, True)
    assert "has just ended" in found.reason
    os.utime(path, (1e9, 1e9))
    assert recover_one(tmp_path).outcome == CaptureState.SEALED


def test_a_recording_of_a_loop_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process may still judge after its loop is done, and some file systems have no locks."""
    write(tmp_path / "trial.rigcap", whole=True)
    write(tmp_path / "other.rigcap", whole=True)
    monkeypatch.chdir(tmp_path)
    with Ring.allocate(1, info={"recording": "trial.rigcap"}, shared=True) as ring:
        ring.put(LOOP_DONE, 1)
        other, trial = recover(["."])
        assert (other.outcome, trial.outcome) == (CaptureState.SEALED, CaptureState.IN_USE)
        assert f"process {os.getpid()} is writing it" in trial.reason
    assert recover_one(tmp_path).outcome == CaptureState.SEALED


def test_the_command_prints_the_loss_and_fails_for_a_destroyed_capture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "trial.rigcap")
    assert rig.cli.run(["recording", "recover", str(tmp_path)]) == 0
    printed = f"{tmp_path}/trial.parquet: {ROWS} rows, {ROWS / RATE:.3g} s, at most 1 s lost\n"
    assert capsys.readouterr().out == printed
    (tmp_path / "b.rigcap").write_text("something else")
    assert rig.cli.run(["recording", "recover", str(tmp_path), "--json"]) == 9
    assert json.loads(capsys.readouterr().out)["error"]["exit_code"] == 9
