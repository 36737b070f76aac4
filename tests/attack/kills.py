"""Kill commands with SIGKILL at any moment: they must recover or restart, and end as they would have without the kill.

A command in virtual time runs in a fork with a seed, and is killed at a random time up to slightly more than its
duration. Its progress by then also depends on the machine, so a case may have to be repeated. Sessions are killed
several times until they end (`tests.system.test_session`).
"""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from functools import cached_property
from pathlib import Path
from typing import Any

from tests.attack.area import Outcome, require
from tests.attack.commands import ROOT, Ended, forked, main_of, preload, run, waited
from tests.conformance.census import MARK, still_there

SESSION_KILLS = 10  # of a session
SESSION_S = 280.0
ROWS_BYTES = 40_000  # a capture that is longer has rows
LONG_AGO = (1e9, 1e9)
SHORT = ("--set", "trial.release_s=0.02", "--set", "verdict.tail_s=0.1", "--set", "homing.settle_s=0.02")
COMMANDS: dict[str, tuple[str, ...]] = {
    "hit": ("hit", "--no-plot", "--json", "--duration", "0.5", "--repeats", "3", "--seed", "5", *SHORT),
    "zwidth": (
        "zwidth", "--no-plot", "--json", "--search", "bisection", "--ratio", "3", "--scheme", "uniform:10k",
        "-B", "0.1,0.3", "--offsets", "0.1", "--operator", "none", "--workers", "1",
        "--set", "trial.duration_s=0.3", *SHORT,
    ),
    "identify": (
        "identify", "--no-plot", "--json", "--rig", "chawda-linear", "--realisations", "2", "--period", "0.25",
    ),
}  # fmt: skip
KINDS = ("session", "hit", "zwidth", "identify", "realtime", "hit", "zwidth", "identify")
REALTIME = ("hit", "--realtime", "--no-plot", "--duration", "1", *SHORT)
FITTED = ("sampled_at", "applied_at")  # by all exchanges of the clocks, of which a kill leaves fewer
NAMES = re.compile(r"\S+\.parquet")  # of recordings: they have a time of day
VOLATILE = {
    "recording", "recordings", "directory", "picture", "file", "messages", "seconds", "created", "host",
    "plan", "elapsed_s",
}  # fmt: skip


class Kills:
    """The area "kills": each case is one kill of a command, or `SESSION_KILLS` kills of a session."""

    def __init__(self, place: Path) -> None:
        preload()
        self._place = place
        self._whole: dict[str, tuple[Ended, Path]] = {}

    def attack(self, case: int, chance: random.Random) -> Outcome:
        """Kill a command, recover what it left, and run it again."""
        name = KINDS[case % len(KINDS)]
        shared = set(os.listdir("/dev/shm"))
        here = self._place / "here"
        here.mkdir()
        try:
            if name == "session":
                outcome = self._session(here, chance)
            elif name == "realtime":
                outcome = self._realtime(here, chance)
            else:
                outcome = self._command(name, here, chance)
        finally:
            shutil.rmtree(here, ignore_errors=True)
        left = set(os.listdir("/dev/shm")) - shared
        require(not left, "left in /dev/shm:", left)
        return outcome

    def _reference_run(self, name: str) -> tuple[Ended, Path]:
        """Return the result and the directory of a reference run of a command that is not killed."""
        if name not in self._whole:
            directory = self._place / f"whole-{name}"
            directory.mkdir()
            run(COMMANDS[name], directory, 600.0)  # compiles everything that it needs
            shutil.rmtree(directory)
            directory.mkdir()
            ended = run(COMMANDS[name], directory, 600.0)
            require(ended.code == 0, name, "does not run:", ended.err)
            self._whole[name] = ended, directory
        return self._whole[name]

    def _command(self, name: str, here: Path, chance: random.Random) -> Outcome:
        whole, directory = self._reference_run(name)
        mark = uuid.uuid4().hex
        child = forked(lambda: main_of(COMMANDS[name]), here, {MARK: mark})
        time.sleep(chance.uniform(0.0, 1.1) * whole.seconds)
        os.kill(child, signal.SIGKILL)
        killed = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
        require(not still_there(mark), "left running:", still_there(mark))
        if name != "zwidth":
            self._check_recovery(here, directory)
        again = run(COMMANDS[name], here, 600.0)
        require(again.code == 0, name, "after a kill:", again.code, again.err)
        require(
            facts(again.out) == facts(whole.out), name, "says something else after a kill:", again.out[:1000]
        )
        return Outcome(Counter({"kills": int(killed), f"kills of {name}": int(killed), "runs": 1}))

    def _check_recovery(self, here: Path, whole: Path) -> None:
        """Require that each capture can be sealed, with the same first rows as in the reference run.

        One in whose header the kill came is named: nothing had moved. One that was sealed and not yet removed goes.
        """
        from rig.recording.reader import open_recording  # noqa: PLC0415

        for capture in here.rglob("*.rigcap"):
            os.utime(capture, LONG_AGO)
            if capture.with_suffix(".parquet").exists():
                finished = run(("recording", "recover", str(capture)), here)
                require(finished.code == 0 and not capture.exists(), "sealed and left:", finished)
            elif capture.stat().st_size < ROWS_BYTES and _has_no_header(capture):
                named = run(("recording", "recover", str(capture)), here)
                require(named.code == 9 and capture.name in named.err, "without a header:", named)
                capture.unlink()
        recovered = run(("recording", "recover", "."), here)
        require(recovered.code == 0, "recover:", recovered.code, recovered.out, recovered.err)
        left = [path for path in here.rglob("*") if path.suffix == ".rigcap" or path.name.endswith(".draft")]
        require(not left, "left after recovering:", left, recovered.out)
        of_whole = _recordings_by_number(whole)
        for which, path in _recordings_by_number(here).items():
            require(which in of_whole, path, "is of no trial")
            rows, full = open_recording(path).rows, open_recording(of_whole[which]).rows
            other = [
                name
                for name in rows.dtype.names
                if name not in FITTED and rows[name].tobytes() != full[name][: len(rows)].tobytes()
            ]
            require(not other, path, "differs from", of_whole[which], "in", other)

    def _realtime(self, here: Path, chance: random.Random) -> Outcome:
        """Kill the host of a real-time run; its loop, device process and plot process must end too."""
        mark = uuid.uuid4().hex
        child = forked(lambda: main_of(REALTIME), here, {MARK: mark})
        time.sleep(chance.uniform(0.2, 6.0))
        os.kill(child, signal.SIGKILL)
        killed = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
        left = still_there(mark)
        require(not left, "left running:", left)
        for capture in here.rglob("*.rigcap"):
            os.utime(capture, LONG_AGO)
        recovered = waited(forked(lambda: main_of(("recording", "recover", ".")), here), here, 60.0)
        require(recovered.code == 0, "recover:", recovered.code, recovered.out, recovered.err)
        return Outcome(Counter({"kills": int(killed), "kills in real time": int(killed), "runs": 1}))

    @cached_property
    def _calm(self) -> tuple[Path, Path]:
        from tests.system.session_study import written  # noqa: PLC0415
        from tests.system.test_session import rehearse  # noqa: PLC0415

        place = self._place / "calm"
        place.mkdir()
        protocol = written(place)
        return protocol, rehearse(protocol, place / "study")

    def _session(self, here: Path, chance: random.Random) -> Outcome:
        from rig.session.engine._directory import LOG  # noqa: PLC0415
        from rig.session.engine._log import read  # noqa: PLC0415
        from tests.system.session_study import comparable  # noqa: PLC0415
        from tests.system.test_session import check_files, results  # noqa: PLC0415

        protocol, calm = self._calm
        seed = str(chance.getrandbits(32))
        command = [
            sys.executable,
            "-m",
            "tests.system.test_session",
            str(protocol),
            str(here),
            str(SESSION_KILLS),
            seed,
        ]
        done = subprocess.run(
            command, cwd=ROOT, capture_output=True, text=True, timeout=SESSION_S, check=False
        )
        require(done.returncode == 0, "session:", done.stderr[-1500:])
        ours = here / "P01"
        require(comparable(read(ours / LOG)) == comparable(read(calm / LOG)), "other decisions after kills")
        require(results(ours) == results(calm), "other results after kills")
        check_files(ours)
        kills = json.loads(done.stdout)["kills"]
        return Outcome(Counter({"kills": kills, "kills of session": kills, "runs": 1}))


def _has_no_header(capture: Path) -> bool:
    """Return True if the kill came while the header was written; the handle had not moved by then."""
    from rig.core.errors import RecordingError  # noqa: PLC0415
    from rig.recording.reader import open_recording  # noqa: PLC0415

    try:
        open_recording(capture)
    except RecordingError as error:
        return "header" in error.message or "is not a recording" in error.message
    return False


def facts(out: str) -> Any:
    """Return the JSON output of a command without paths and times."""
    return _still(json.loads(out))


def _still(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _still(inner) for key, inner in value.items() if key not in VOLATILE}
    if isinstance(value, list):
        return [_still(inner) for inner in value]
    return NAMES.sub("", value) if isinstance(value, str) else value


def _recordings_by_number(place: Path) -> dict[tuple[str, int], Path]:
    """Return the recordings by condition and number; the file name has a time of day between the two."""
    found = {}
    for path in place.rglob("*.parquet"):
        stem, _, number = path.stem.rpartition("-")
        of = stem.rpartition("-")[2]
        found["" if of.isdecimal() else of, int(number)] = path
    return found
