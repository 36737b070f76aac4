"""Commands that SIGKILL ends at a random moment: their recordings are recovered, and run again they end as ever."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from rig.recording.reader import open_recording
from tests.conformance.started import started

SHORT = "--set trial.release_s=0.02 --set verdict.tail_s=0.1 --set homing.settle_s=0.02"
COMMANDS = {
    "hit": f"hit --duration 0.5 --repeats 3 --seed 5 {SHORT}",
    "zwidth": f"zwidth --ratio 3 -B 0.1,0.3 --offsets 0.1 --workers 1 {SHORT}",
    "identify": "identify --rig chawda-linear --realisations 2 --period 0.25",
}
KILLS = 2
HEADER_BYTES = 40_000  # a longer capture has rows
FITTED = {"sampled_at", "applied_at"}  # by all exchanges of the clocks, of which a kill leaves fewer
TIME = re.compile(r"-\d{8}-\d{6}-")  # of day, in the names of recordings
VOLATILE = {
    *("recording", "recordings", "directory", "picture", "file", "messages"),
    *("seconds", "created", "host", "plan", "elapsed_s"),
}
AN_HOUR_AGO = time.time() - 3600.0  # a capture that has just been written may belong to a running loop


def facts(value: Any) -> Any:
    """Return a JSON value without paths and times."""
    if isinstance(value, dict):
        return {key: facts(inner) for key, inner in value.items() if key not in VOLATILE}
    if isinstance(value, list):
        return [facts(inner) for inner in value]
    return re.sub(r"\S+\.parquet", "", value) if isinstance(value, str) else value


def rows_by_name(directory: Path) -> dict[str, Any]:
    """Return the rows of each recording by its file's name without the time of day."""
    recordings = {TIME.sub("-", path.stem): path for path in directory.rglob("recordings/*.parquet")}
    return {name: open_recording(path).rows for name, path in recordings.items()}


@pytest.mark.exhaustive(
    "tests/rig/recording/test_recording_recorder.py::test_rows_reach_the_file_while_the_loop_runs"
)
@pytest.mark.parametrize("name", COMMANDS)
def test_a_killed_command_is_recovered_and_ends_as_ever_when_run_again(
    name: str, run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The killed runs are processes; the others run here, where the kernels have been loaded."""
    command = (*COMMANDS[name].split(), "--no-plot", "--json")
    program: tuple[Any, ...] = (sys.executable, "-P", "-m", "rig", *command)
    whole, here, timed = places = [tmp_path / place for place in ("whole", "here", "timed")]
    for place in places:
        place.mkdir()

    def result() -> Any:
        code, out, err = run(*command)
        assert code == 0, err
        return facts(json.loads(out))

    monkeypatch.chdir(whole)
    expected, rows_of_all = result(), rows_by_name(whole)  # and compiles what the command needs
    began = time.monotonic()
    subprocess.run(program, cwd=timed, capture_output=True, check=True)
    seconds = time.monotonic() - began
    monkeypatch.chdir(here)
    drawn = random.Random(name)
    for _ in range(KILLS):
        with started(*program, cwd=here, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            time.sleep(drawn.uniform(0.3, 0.95) * seconds)  # before, it only imports
        assert process.returncode in {-signal.SIGKILL, 0}, "a quick machine may have ended it before"
        for capture in here.rglob("*.rigcap"):
            os.utime(capture, (AN_HOUR_AGO, AN_HOUR_AGO))
        code, _, err = run("recording", "recover", ".")
        unreadable = list(here.rglob("*.rigcap"))
        assert code == (9 if unreadable else 0), err
        for capture in unreadable:  # killed while it wrote the header: nothing had moved
            assert capture.name in err
            assert capture.stat().st_size < HEADER_BYTES
            capture.unlink()
        for recording, rows in rows_by_name(here).items():  # a map has none, but a journal
            for column in set(rows.dtype.names) - FITTED:
                assert rows[column].tobytes() == rows_of_all[recording][column][: len(rows)].tobytes()
    assert result() == expected
