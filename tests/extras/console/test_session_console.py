"""A session with a console, operated in a terminal, on a simulated rig in real time.

On a busy machine hits end early: the session then shows a question, and continues. If every hit ends so, the test
fails with this reason.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.core.sample import Phase
from rig.realtime import running
from rig.recording.files import sha256_of
from rig.recording.reader import open_recording
from rig.session.engine._log import read
from rig.session.terminal._held import RELEASED_S
from rig.session.terminal._live import snapshot_of
from tests.conformance.started import WAIT_S, is_alive
from tests.conformance.terminal import Program, Terminal

ROOT = Path(__file__).parents[3]
RATE = 250  # Hz: a loop that a loaded machine has time for
REACH, LET_GO = "\x1b[F", "\x1b[H"  # end and home: the hand of the keyboard
START_S = 90.0  # that program, console and simulated device may take to start on a loaded machine
BY_KEYS_S = 15.0  # from the beginning of a trial to the wall; the script would take longer
HITS = 8  # that may end early, before this machine has no time for a loop

PROTOCOL = """
[study]
title = "console"
preset = "koul-compliant"
seed = 3
[study.changes]
"controller.position_rate" = {rate}
"controller.velocity_rate" = {rate}
"controller.parameters.cutoff_hz" = 50.0
"controller.command_lifetime_s" = 0.02
"homing.settle_s" = 0.05
"operator.reach_s" = {reach_s}
"operator.press" = 2.0
"trial.release_s" = 0.05
"verdict.tail_s" = 0.1
"verdict.lowpass_hz" = 100.0
[trial]
duration_s = {duration_s}
[search]
rule = "grid"
lowest = 10
highest = 20
step = 10
settings = {{ repeats = 1 }}
[order]
kind = "fixed"
[stop]
machine = 1000
[[condition]]
name = "hidden-name"
[[question]]
name = "tired"
text = "How tired?"
"""


# `rig session run` as a user starts it, in real time, where keys move the hand; the simulated device is asked for its
# current when a run is over.
PROGRAM = """
from rig.core import program; program.begin()
import sys
from rig.doctor import pace
from rig.cli import run as rig
from rig.experiments.trials import _trial as trial
from rig.session.terminal import _child as child

pace.SECONDS = 0.1
child.END_S = 0.2  # of a console that is stopped
conclude = trial._conclude


def witness(device, *rest):
    error = conclude(device, *rest)
    print("current afterwards:", device.states(0.1)[-1].current_commanded, file=sys.stderr)
    return error


trial._conclude = witness
sys.exit(rig(["session", "run", *sys.argv[1:], "--hand", "keyboard", "--lossy-anyway"]))
"""
AT_REST = "current afterwards: 0"


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    with Terminal() as one:
        yield one


READ_S = 0.5  # within which the console has read a key


class Operator:
    """The operator of ``rig session run``, a process of its own."""

    def __init__(self, terminal: Terminal, directory: Path, *words: object) -> None:
        self.terminal, self.directory = terminal, directory
        self._pressed_s: dict[str, float] = {}
        self._program: Program = terminal.run(sys.executable, "-c", PROGRAM, *map(str, words), cwd=ROOT)
        self.pid = self._program.pid

    @property
    def over(self) -> bool:
        return not is_alive(self.pid)

    def result(self) -> tuple[int, list[str]]:
        """Wait for the program's end; return its exit code and the lines of its standard error."""
        code, err = self._program.wait()
        return code, err.splitlines()

    def close(self) -> None:
        self._program.end()

    def sees(self, *texts: str) -> str:
        """Wait until one of the texts was printed since the last key, and return it; "" if the program has ended."""

        def found() -> str:
            printed = self.terminal.fresh
            return next((text for text in texts if text in printed), "")

        self.terminal.until(lambda: bool(found()) or self.over, str(texts), START_S)
        return found()

    def press(self, keys: str) -> None:
        """Press keys like a person, who releases a key before pressing it again."""
        released_s = max(self._pressed_s.get(key, 0.0) for key in keys) + RELEASED_S + READ_S
        threading.Event().wait(max(0.0, released_s - time.monotonic()))
        self.terminal.type(keys)
        self._pressed_s |= dict.fromkeys(keys, time.monotonic())

    def of_kind(self, kind: str) -> list[dict[str, Any]]:
        events = read(self.directory / "session.log")
        return [dict(event.content) for event in events if event.kind == kind]


@pytest.fixture
def operator(terminal: Terminal, tmp_path: Path) -> Iterator[Operator]:
    """Start a session whose hits last until they are stopped; keys move the hand, the script would be too slow."""
    path, study = tmp_path / "console.toml", tmp_path / "study"
    path.write_text(PROTOCOL.format(duration_s=600.0, reach_s=60.0, rate=RATE))
    one = Operator(terminal, study / "P01", path, "P01", "--study", study)
    yield one
    one.close()


def child_of(pid: int) -> int:
    for line in Path("/proc").iterdir():
        if line.name.isdecimal():
            try:
                words = (line / "cmdline").read_bytes().split(b"\0")
                parent = int((line / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
            if parent == pid and b"rig.session.terminal" in words:
                return int(line.name)
    raise AssertionError(f"process {pid} has no console")


def eventually(condition: Callable[[], Any], what: str) -> Any:
    pause, deadline = threading.Event(), time.monotonic() + WAIT_S
    while time.monotonic() < deadline:
        if found := condition():
            return found
        pause.wait(0.01)
    raise AssertionError(f"it never came: {what}")


def is_pressing(pid: int) -> bool:
    """Return True if the loop of a process renders its wall to a pressing hand."""
    ring = running.memory_of(pid)
    if ring is None:
        return False
    with ring:
        live = snapshot_of(ring)
    return live is not None and live.phase == "trial" and live.penetration > 0.0 and live.effort != 0.0


def begin_to_press(operator: Operator) -> None:
    """Start hits until a hand presses against the wall."""
    engine, terminal = operator.pid, operator.terminal
    for _ in range(HITS):
        asked = operator.sees("hit ended early:", "were invalid:", "ready?")
        assert asked, operator.result()
        operator.press("g")
        if asked != "ready?":
            continue
        assert operator.sees("state: free space", "state: go", "state: hold", "[g] go"), operator.result()
        terminal.type(REACH)
        eventually(
            lambda: is_pressing(engine) or "[g] go" in terminal.fresh or operator.over, "a hand on the wall"
        )
        if is_pressing(engine):
            return
        terminal.type(LET_GO)
    operator.close()
    pytest.fail("every hit ended early")


@pytest.mark.quiet
def test_a_hit_is_stopped_while_the_console_is(terminal: Terminal, operator: Operator) -> None:
    """`rig stop` ends one hit and ^C the next, long before the console's timeout would."""
    engine = operator.pid
    for _ in range(HITS):
        begin_to_press(operator)
        console, before = child_of(engine), len(operator.of_kind("trial"))
        os.kill(console, signal.SIGSTOP)
        running.stop(engine, patience_s=WAIT_S)
        trial = eventually(lambda n=before: operator.of_kind("trial")[n:], "the trial in the log")[0]
        os.kill(console, signal.SIGCONT)
        terminal.type(LET_GO)
        if trial["ended"] == "stopped":  # a machine that has no time for a loop may have been faster
            break
    else:
        pytest.fail("every hit ended early")
    stopped = f"stopped by process {os.getpid()} (`rig stop`, or STOP of a console); the effort is zero"
    assert check_stopped(operator, trial) == stopped
    rows = open_recording(operator.directory / trial["recording"]).rows
    led = rows[rows["phase"] == Phase.TRIAL]
    assert np.argmax(led["penetration"] > 0.0) < BY_KEYS_S * RATE

    begin_to_press(operator)
    before = len(operator.of_kind("trial"))
    os.kill(child_of(engine), signal.SIGSTOP)
    terminal.type("\x03")
    code, err = operator.result()
    assert err.count(AT_REST) >= 2
    assert terminal.attributes_are_back()
    assert operator.of_kind("stopped")
    trials = operator.of_kind("trial")
    assert len(trials) == before + 1
    assert trials[-1]["ended"] == "stopped"
    assert code == 130, err
    assert check_stopped(operator, trials[-1]) == "stopped by SIGINT; the effort is zero"


def check_stopped(operator: Operator, trial: dict[str, Any]) -> str:
    """Require a complete, hashed recording with the stop as its reason and the counted losses; return the reason.

    Its last row is the last sample; the loop's STOP after it refers to no sample. The device itself reports that no
    current flows then (`PROGRAM`).
    """
    recording = open_recording(operator.directory / trial["recording"])
    assert recording.complete
    assert sha256_of(operator.directory / trial["recording"]) == trial["sha256"]
    assert recording.trailer is not None
    assert recording.trailer["reason"] == trial["ended"] == "stopped"
    assert {"lost", "late", "skipped"} <= set(recording.trailer["counters"])
    rows = recording.rows
    assert np.any(rows["effort_sent"] != 0.0)
    assert rows["phase"][-1] == Phase.TRIAL
    return str(recording.trailer["error"])
