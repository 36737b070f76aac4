"""Command-line behaviour that all commands share: output, files, exit codes, signals and error messages."""

import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import rig.cli
from rig.realtime import compiling
from rig.recording.reader import open_recording
from rig.views.plots import style

QUICK = ["--duration", "0.25", "--set", "verdict.tail_s=0.1", "--set", "trial.release_s=0.02"]


@pytest.fixture(scope="module")
def hit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("hit")
    assert rig.cli.run(["hit", "-q", "--no-plot", *QUICK, "-o", str(directory)]) == 0
    (path,) = directory.iterdir()
    return path


@pytest.fixture
def recording(hit: Path, tmp_path: Path) -> str:
    """Copy one hit to a directory in which the test may write files beside it."""
    return str(shutil.copy(hit, tmp_path))


@pytest.mark.exhaustive("::test_the_default_hit_is_the_one_of_the_reference_study")
def test_a_command_prints_its_numbers_also_without_a_picture(
    run: Any, recording: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A failed picture is explained on stderr, and is an error only if the user named the picture's file."""

    def fails(figure: Any, path: Path) -> Path:
        raise RuntimeError("no fonts")

    monkeypatch.setattr(style, "save", fails)
    for command, number in {
        ("theory", "levant-regions"): "crossing",
        ("show", "--xy", recording): "trailer",
        ("recording", "replay", "--plot", recording): "exact",
        ("recording", "timing", recording): "stages",
    }.items():
        code, out, err = run(*command, "--json")
        assert (code, json.loads(out)["picture"]) == (0, None), command
        assert number in json.loads(out), (command, list(json.loads(out)))
        assert "rig: no picture: no fonts" in err
    code, out, err = run("show", recording, "-o", tmp_path / "a.png", "--json")
    assert (code, json.loads(out)["error"]["exit_code"], "no fonts" in err) == (9, 9, True)


def test_the_default_hit_is_the_one_of_the_reference_study(run: Any) -> None:
    """In the reference study: peak 17 to 18 counts, rest 3 to 4, effort up to 1.2 N·m, no saturation, stable."""
    code, out, _ = run("hit", "--json", "--no-plot")
    assert code == 0
    (hit,) = json.loads(out)["hits"]
    verdict, count = hit["verdict"], hit["resolution"]
    assert verdict["kind"] == hit["verdict_true"]["kind"] == "stable"
    assert 17.0 <= verdict["peak_penetration"] / count <= 18.0
    assert 3.0 <= verdict["resting_penetration"] / count <= 4.0
    assert verdict["peak_effort"] <= 1.2
    assert verdict["saturated_fraction"] == 0.0
    assert verdict["ticks"] == 20000


def test_a_quiet_hit_reports_an_unexpected_verdict_by_its_exit_code(run: Any, tmp_path: Path) -> None:
    walls = ("-K", "1500", "-B", "0", "--set", "trial.minimum_rest_counts=0", "--no-plot", *QUICK)
    code, out, err = run("hit", "-q", "--expect", "stable", *walls)
    assert (code, out) == (17, "")
    assert "the hit is unstable, expected stable: " in err
    assert len(list((tmp_path / "recordings").iterdir())) == 1
    code, out, _ = run("hit", "--json", "--expect", "stable", *walls)
    result = json.loads(out)
    assert (code, result["error"]["exit_code"], len(result["hits"])) == (17, 17, 1)


def test_a_rig_is_a_name_or_a_file_with_the_same_option(run: Any, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text('preset = "koul-rigid"\n[wall]\nstiffness = 123.0\n')
    as_file, as_rig = (
        run("experiment", "plan", *words, "--json") for words in (("mine.toml",), ("--rig", "mine.toml"))
    )
    assert as_file == as_rig
    assert (as_rig[0], json.loads(as_rig[1])["rig"]) == (0, "koul-rigid")
    assert as_rig != run("experiment", "plan", "--rig", "koul-rigid", "--json")
    code, _, err = run("experiment", "plan", "mine.toml", "--rig", "mine.toml")
    assert (code, "both a file and --rig" in err) == (2, True)


def test_a_grip_brings_the_limits_for_people_and_the_command_says_so(run: Any) -> None:
    code, out, _ = run("hit", "--operator", "firm", "--no-plot")
    assert code == 0
    assert (
        "in effect: rig.limits.effort = 0.286 instead of 1.3, rig.limits.human = True instead of Fal" in out
    )


@pytest.mark.usefixtures("coarse")
def test_a_run_that_ends_early_gives_verdict_picture_and_the_hits_before(run: Any, tmp_path: Path) -> None:
    limit = "rig.limits.position_maximum=0.005"
    throwing = ["-K", "1500", "-B", "0", "--effort", "0.5", "--set", limit, *QUICK]
    code, out, err = run("hit", "--format", "svg", *throwing)
    assert code == 10
    assert "unstable" in out
    assert "threw the handle out" in out
    assert "position 0.005" in err
    assert list((tmp_path / "recordings").glob("*.svg"))
    code, out, _ = run("hit", "--json", "--no-plot", *throwing)
    found = json.loads(out)
    assert found["hits"] == []
    assert found["error"]["exit_code"] == code == 10
    assert open_recording(found["error"]["recording"]).trailer["verdict"]["kind"] == "unstable"


@pytest.mark.parametrize(
    "command",
    [
        ("hit", "--no-plot"),
        ("identify",),
        ("impedance", "measure", "--channel", "motor"),
        ("zwidth",),
        ("device", "check"),
    ],
    ids=lambda command: command[0],
)
def test_a_device_of_another_rig_is_refused_before_anything_moves(
    command: tuple[str, ...], run: Any, tmp_path: Path
) -> None:
    code, _, err = run(
        *command, "--rig", "koul-compliant", "--url", "sim://koul-rigid", "-o", tmp_path / "out"
    )
    assert code == 2
    assert "koul-rigid was built for another rig than koul-compliant" in err
    assert "--rig koul-rigid" in err
    assert not list(tmp_path.glob("**/*.rigcap"))
    assert not list(tmp_path.glob("**/*.parquet"))


def test_an_unwritable_directory_is_refused_before_anything_moves(run: Any, tmp_path: Path) -> None:
    (tmp_path / "recordings").write_text("a file in the way", encoding="utf-8")
    code, _, err = run("hit", "--no-plot")
    assert code != 0
    assert "recordings" in err


@pytest.fixture
def main(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., int]]:
    """Return a function that runs a command line as the program does, to its exit, and returns the exit code."""
    monkeypatch.setattr(compiling, "listen", lambda notice: None)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def call(*words: object) -> int:
        monkeypatch.setattr(sys, "argv", ["rig", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            rig.cli.main()
        assert isinstance(ended.value.code, int)
        return ended.value.code

    yield call
    for number, handler in handlers.items():
        signal.signal(number, handler)


def kill_as_it_grows(directory: Path, over: threading.Event) -> None:
    """Send this process SIGINT once a capture in the directory has a megabyte, and SIGTERM at two; nothing after it."""
    for size, number in enumerate((signal.SIGINT, signal.SIGTERM), start=1):
        while sum(path.stat().st_size for path in directory.glob("*.rigcap")) < size * 1_000_000:
            if over.wait(0.01):
                return
        os.kill(os.getpid(), number)


@pytest.mark.signals
def test_sigterm_ends_a_hit_that_ignores_ctrl_c_with_its_exit_code_and_a_recording(
    main: Callable[..., int], tmp_path: Path, capfd: Any
) -> None:
    """A shell starts `nohup … &` with SIGINT ignored; `test_nothing_is_left` tests SIGINT that is not ignored."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    over = threading.Event()
    threading.Thread(target=kill_as_it_grows, args=(tmp_path, over)).start()
    try:
        code = main("hit", "--duration", 3000, "--no-plot", "--output", tmp_path)
    finally:
        over.set()
    err = capfd.readouterr().err
    assert code == 130, err
    assert "Traceback" not in err
    assert "stopped" in err
    (parquet,) = tmp_path.glob("*.parquet")
    recording = open_recording(parquet)
    assert recording.complete
    assert recording.trailer["reason"] == "stopped"
    assert recording.rows["current_sent"][-1] is not None


# ---------------------------------------------------------------------- output that cannot be written


def test_redirected_output_is_utf_8_in_any_locale(main: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, "latin-1"))
    assert main("experiment", "preset", "koul-compliant") == 0
    text = written.getvalue().decode("utf-8")
    assert "N·m" in text
    assert tomllib.loads(text)["rig"]["name"] == "koul-compliant"


@contextmanager
def taking_nothing(output: str, descriptor: int) -> Iterator[None]:
    """Let a descriptor lead to a full disk or to a pipe without a reader."""
    reader, writer = os.pipe() if output == "a closed pipe" else (os.dup(1), os.open(output, os.O_WRONLY))
    before = os.dup(descriptor)
    os.dup2(writer, descriptor)
    os.close(reader)
    os.close(writer)
    try:
        yield
    finally:
        os.dup2(before, descriptor)
        os.close(before)


@pytest.mark.parametrize(
    ("name", "output", "stream", "expected"),
    [
        ("koul-rigid", "/dev/full", "stdout", 74),
        ("koul-rigid", "/dev/full", "stderr", 0),
        ("unknown", "/dev/full", "stdout", 2),
        ("unknown", "/dev/full", "stderr", 74),
        ("koul-rigid", "a closed pipe", "stdout", 0),  # a reader that has gone wants no more
    ],
)
def test_output_that_cannot_be_written_has_its_exit_code(
    name: str, output: str, stream: str, expected: int, main: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    descriptor = {"stdout": 1, "stderr": 2}[stream]
    with taking_nothing(output, descriptor), open(descriptor, "w", closefd=False) as full:
        monkeypatch.setattr(sys, stream, full)
        assert main("experiment", "preset", name) == expected


@pytest.mark.exhaustive("::test_output_that_cannot_be_written_has_its_exit_code")
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize(("output", "expected"), [("/dev/full", 74), ("a closed pipe", 0)])
def test_the_interpreter_adds_nothing_when_it_ends(output: str, expected: int, unbuffered: str) -> None:
    """Buffered output counts too: Python flushes it at exit, and a failure there once gave exit code 120."""
    with taking_nothing(output, 1):
        done = subprocess.run(
            [sys.executable, "-m", "rig", "experiment", "preset"],
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered}, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == expected
    assert "Exception ignored" not in done.stderr
    assert "Traceback" not in done.stderr


def test_a_file_name_that_is_not_utf_8_is_shown(main: Any, capfd: Any) -> None:
    assert main("experiment", "preset", "--json", "\udcff.toml") == 2
    out, err = capfd.readouterr()
    assert "\\udcff.toml" in err
    assert json.loads(out)["error"]["error"].startswith("preset \udcff.toml")


def test_a_pipe_that_breaks_elsewhere_is_an_error(monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    def breaks(**_: Any) -> None:
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    monkeypatch.setattr(rig.cli.rig, "invoke", lambda context: breaks())
    assert rig.cli.run(["experiment", "preset"]) == 74
    assert "may be incomplete" in capfd.readouterr().err
