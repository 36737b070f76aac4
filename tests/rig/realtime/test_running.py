"""Running loops as other terminals list them: distinguished from processes that only read their memory, and stopped."""

import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest

import rig.cli
from rig import __main__ as start
from rig.core.errors import ConfigError, RigError
from rig.realtime import control_words, running
from rig.realtime.memories import LoopMemory
from rig.realtime.ring import Ring
from tests.conformance.running_loop import loop_process

INFO = {"url": "serial:///dev/ttyTEST", "recording": "here.rigcap"}


def loops_of(*pids: int) -> list[running.RunningLoop]:
    return [loop for loop in running.running() if loop.pid in pids]


def test_a_loop_of_another_process_is_found_and_stopped() -> None:
    with loop_process(INFO) as process:
        (loop,) = loops_of(process.pid)
        assert loop.info == INFO
        assert (loop.phase, loop.stopping, loop.done) == ("trial", False, False)
        assert abs(loop.since - time.time()) < 60
        assert loop.as_mapping()["url"] == "serial:///dev/ttyTEST"
        with running.open_loop(loop) as ring:  # now this process maps the memory too, and runs no loop
            assert ring.get(control_words.VERSION) == control_words.LAYOUT_VERSION
            assert loops_of(os.getpid()) == []
            (again,) = loops_of(process.pid)
            assert again.path != f"/proc/{os.getpid()}/fd/{ring.descriptor}"
        (stopped,) = running.stop(process.pid, patience_s=20)
        assert stopped.ended
        assert stopped.loop.pid == process.pid
        assert loops_of(process.pid) == []  # it is done, though its process lives
        assert process.is_alive()
        (again,) = [one for one in running.running(done=True) if one.pid == process.pid]
        assert again.done
        with pytest.raises(ConfigError, match="runs no loop"):
            running.stop(process.pid)
        process.kill()
        process.join()
        assert not [one for one in running.running(done=True) if one.pid == process.pid]
        with pytest.raises(ConfigError, match="there is no process"):
            running.stop(process.pid)
        with pytest.raises(RigError, match="has ended"), running.open_loop(loop):
            pass


def test_a_loop_of_this_process_is_found_once_though_it_is_mapped_too() -> None:
    with Ring.allocate(1, info=INFO, shared=True) as ring:
        (loop,) = loops_of(os.getpid())
        assert loop.info == INFO
        assert running.ask_to_stop(os.getpid()) == 1
        assert ring.get(control_words.STOP) == -os.getpid()
        ring.put(control_words.LOOP_DONE, 1)
        assert loops_of(os.getpid()) == []


def test_a_loop_of_another_version_is_listed_and_can_be_stopped_but_not_opened() -> None:
    with Ring.allocate(1, info=INFO, shared=True) as ring:
        ring.put(control_words.VERSION, 99)
        (loop,) = loops_of(os.getpid())
        assert (loop.version, loop.info, loop.phase) == (99, {}, "unknown")
        with pytest.raises(RigError, match="another version"), running.open_loop(loop):
            pass
        ring.put(control_words.LOOP_DONE, 0)
        (stopped,) = running.stop(os.getpid(), patience_s=0)
        assert not stopped.ended
        assert ring.get(control_words.STOP) == -os.getpid()


def test_only_one_of_several_loops_must_be_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with Ring.allocate(1, info=INFO, shared=True):
        (one,) = loops_of(os.getpid())
    two = replace(one, pid=one.pid + 1)
    for loops, message in (
        ([], "no loop runs in real time"),
        ([one, two], rf"in the processes {one.pid}, {two.pid}; choose one by its process number \(`pid`\)"),
    ):
        monkeypatch.setattr(running, "running", lambda loops=loops: loops)
        with pytest.raises(ConfigError, match=message):
            running.the_loop()
    assert running.the_loop(two.pid) is two


@pytest.mark.exhaustive("::test_a_loop_of_another_process_is_found_and_stopped")
@pytest.mark.skipif(os.getuid() != 0, reason="needs root, to become another user")
def test_process_of_another_user_is_reported_and_not_stopped() -> None:
    """The listing runs as user 65534, which may read neither this process nor one called rig."""
    program = f"""
import os, sys
sys.path[:0] = {sys.path!r}
import rig.cli.stop
from rig.realtime import running
from rig.core.errors import ConfigError
os.setgid(65534); os.setuid(65534)
try:
    running.stop({os.getpid()})
except ConfigError as error:
    print(error)
print([loop.pid for loop in running.running()])
sys.exit(rig.cli.run(["stop"]))
"""
    with (
        Ring.allocate(1, info=INFO, shared=True) as ring,
        subprocess.Popen(["rig", "60"], executable="/bin/sleep") as other,
    ):
        try:
            done = subprocess.run(
                [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
            )
            assert done.stdout.splitlines()[:2] == [
                f"process {os.getpid()} belongs to another user; run the command as its owner, or: "
                f"sudo rig stop {os.getpid()}",
                "[]",
            ], done.stderr
            assert done.returncode == 0
            assert f"process {other.pid} may run a loop too" in done.stderr
            assert other.pid not in running.hidden()  # root sees all
            assert ring.get(control_words.STOP) == 0
        finally:
            other.kill()


@pytest.mark.parametrize(
    ("command", "meant"),
    [
        ("rig stop", True),
        ("/usr/bin/python3 /home/me/.local/bin/rig hit", True),
        ("python -X dev -m rig hit", True),
        ("vim rig/realtime/running.py rig", False),
        ("python -m rigging", False),
        ("", False),
    ],
)
def test_a_rig_of_another_user_is_known_by_its_command_line(command: str, meant: bool) -> None:
    assert running._is_rig(command.encode().split(b" ")) == meant


def test_command_stops_and_names_a_loop(capsys: pytest.CaptureFixture[str]) -> None:
    pid = os.getpid()
    with Ring.allocate(1, info=INFO, shared=True) as ring:
        loop = threading.Thread(target=wait_for_stop, args=(ring,))
        loop.start()
        assert rig.cli.run(["stop", "--list"]) == 0
        assert f"process {pid}: runs," in capsys.readouterr().out
        assert rig.cli.run(["stop", str(pid)]) == 0
        loop.join()
        out = capsys.readouterr().out
        assert f"process {pid}: stopped after" in out
        assert "serial:///dev/ttyTEST, here.rigcap" in out
        assert rig.cli.run(["stop", str(pid), "--json"]) == 2
        assert "runs no loop" in json.loads(capsys.readouterr().out)["error"]["error"]


def wait_for_stop(ring: Ring) -> None:
    deadline = time.monotonic() + 60
    while ring.get(control_words.STOP) == 0 and time.monotonic() < deadline:
        time.sleep(0.001)
    ring.put(control_words.LOOP_DONE, 1)


def test_command_succeeds_when_no_loop_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(running, "stop", lambda *_, **__: [])
    monkeypatch.setattr(running, "hidden", list)
    assert rig.cli.run(["stop"]) == 0
    assert "nothing to stop" in capsys.readouterr().out


def test_command_reports_a_loop_that_does_not_stop(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pid, stop = os.getpid(), running.stop
    monkeypatch.setattr(running, "stop", lambda *_, **__: stop(pid, patience_s=0.05))
    with Ring.allocate(1, info=INFO, shared=True):
        assert rig.cli.run(["stop", "--json"]) == 1
    out, err = capsys.readouterr()
    (loop,) = json.loads(out)["loops"]
    assert (loop["pid"], loop["ended"]) == (pid, False)
    assert f"kill -9 {pid}" in err


def test_stop_word_is_written_before_click_or_numpy_are_loaded() -> None:
    """A stop of a person's rig must not wait for imports, except the interpreter's own."""
    program = """
import sys
from rig.realtime import memories
ask_to_stop = memories.ask_to_stop
def ask(pid):
    found = ask_to_stop(pid)
    print(sum(one.ran for one in found), *sorted({"click", "numpy", "numba", "rig.cli"} & set(sys.modules)), flush=True)
    return found
memories.ask_to_stop = ask
from rig.__main__ import main
sys.argv[1:] = ["stop", sys.argv[1], "--json"]
main()
"""
    with Ring.allocate(1, info=INFO, shared=True) as ring:
        ring.put(control_words.STOP, 7)
        ring.put(control_words.TICKS, 3)
        command = [sys.executable, "-c", program, str(os.getpid())]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            before = process.stdout.readline()
            assert before == "1\n", "loops asked, and what was loaded by then"
            ring.put(control_words.LOOP_DONE, 1)  # while it loads the rest, and before it looks
            (loop,) = json.loads(process.stdout.read())["loops"]
        assert (loop["pid"], loop["ticks"], loop["ended"], process.returncode) == (os.getpid(), 3, True, 0)
        assert ring.get(control_words.STOP) == 7, "who stopped it first is who stopped it"


@pytest.mark.parametrize(
    "words_of_it", [["stop", "--help"], ["stop", "--list"], ["stop", "x"], ["hit", "stop"], []]
)
def test_nothing_else_stops_a_loop(words_of_it: list[str]) -> None:
    with Ring.allocate(1, info=INFO, shared=True) as ring:
        assert start.asked_to_stop(words_of_it) is None
        assert ring.get(control_words.STOP) == 0


def test_a_loop_that_ends_while_it_is_being_stopped_was_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    with Ring.allocate(1, info=INFO, shared=True) as ring:
        asked = LoopMemory.ask_to_stop

        def at_once(other: LoopMemory) -> None:
            asked(other)
            ring.put(control_words.LOOP_DONE, 1)

        monkeypatch.setattr(LoopMemory, "ask_to_stop", at_once)
        (stopped,) = running.stop(os.getpid(), patience_s=1)
        assert stopped.ended
