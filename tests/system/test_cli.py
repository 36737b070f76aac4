"""The commands as a person meets them: what they print, what they leave on disk, and how they refuse."""

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from subprocess import PIPE
from typing import Any

import pytest

import rig.cli
from rig.recording.reader import open_recording
from rig.views.plots import style
from tests.conformance.started import started
from tests.conformance.tiers import first_by_default

QUICK = ["--duration", "0.25", "--set", "verdict.tail_s=0.1", "--set", "trial.release_s=0.02"]


@pytest.fixture(scope="module")
def hit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("hit")
    assert rig.cli.run(["hit", "-q", "--no-plot", *QUICK, "-o", str(directory)]) == 0
    (path,) = directory.iterdir()
    return path


@pytest.fixture
def recording(hit: Path, tmp_path: Path) -> str:
    """A copy of one hit, where a test may write beside it."""
    return str(shutil.copy(hit, tmp_path))


@pytest.mark.usefixtures("coarse")
def test_pictures_have_the_format_that_one_asks_for(run: Any, tmp_path: Path) -> None:
    code, out, err = run("hit", "--json", "--format", "svg", *QUICK)
    assert code == 0, err
    (hit,) = json.loads(out)["hits"]
    picture = Path(hit["picture"])
    assert picture == Path(hit["recording"]).with_suffix(".svg")
    assert "position (mrad)" in picture.read_text(encoding="utf-8")
    assert run("show", hit["recording"], "-o", tmp_path / "a.pdf")[0] == 0
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    code, _, err = run("show", hit["recording"], "-o", tmp_path / "a.jpg")
    assert (code, "does not end in a format" in err, "Traceback" in err) == (9, True, False)


def test_a_picture_that_fails_costs_no_command_its_numbers(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All alike: the reason on standard error; an error only where the user named the file."""
    code, out, err = run("hit", "--json", "--no-plot", *QUICK)
    assert code == 0, err
    recording = json.loads(out)["hits"][0]["recording"]

    def fails(figure: Any, path: Path) -> Path:
        raise RuntimeError("no fonts")

    monkeypatch.setattr(style, "save", fails)
    for command, number in {
        ("theory", "walls"): "schemes",
        ("theory", "levant-regions"): "crossing",
        ("show", "--xy", recording): "trailer",
        ("recording", "replay", "--plot", recording): "exact",
        ("recording", "timing", recording): "stages",
    }.items():
        code, out, err = run(*command, "--json")
        assert (code, json.loads(out)["picture"]) == (0, None), command
        assert number in json.loads(out), (command, list(json.loads(out)))
        assert "rig: no picture: no fonts" in err
        assert len(run(*command)[1]) > 40
    code, out, err = run("show", recording, "-o", tmp_path / "a.png", "--json")
    assert (code, json.loads(out)["error"]["exit_code"], "no fonts" in err) == (9, 9, True)


@pytest.mark.parametrize(
    "outside",
    first_by_default(
        [
            {"PYTHONUTF8": "0", "LC_ALL": "POSIX", "PYTHONCOERCECLOCALE": "0"},
            {"PYTHONIOENCODING": "latin-1"},
            {"PYTHONIOENCODING": "utf-16"},
        ]
    ),
)
def test_what_a_program_reads_is_utf_8_whatever_the_locale_says(outside: dict[str, str]) -> None:
    """JSON, and files that are written by redirection: `rig experiment preset koul-compliant > mine.toml`."""
    command = [sys.executable, "-m", "rig"]
    environment = {
        name: value for name, value in os.environ.items() if name not in ("LANG", "LC_ALL", "PYTHONUTF8")
    }
    plan, preset = (
        subprocess.run([*command, *words], env=environment | outside, capture_output=True, check=True).stdout
        for words in (("experiment", "plan", "--json"), ("experiment", "preset", "koul-compliant"))
    )
    assert "N·m" in json.dumps(json.loads(plan.decode("utf-8")), ensure_ascii=False)
    assert tomllib.loads(preset.decode("utf-8"))["rig"]["name"] == "koul-compliant"


def test_the_default_hit_is_the_one_of_the_reference_study(run: Any) -> None:
    """Peak 17 to 18 counts, rest 3 to 4, effort up to 1.2 N·m, no saturation, stable."""
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


def test_a_verdict_that_is_not_the_expected_one_has_an_exit_code_of_its_own(run: Any, recording: Any) -> None:
    assert run("show", recording, "--expect", "stable", "-q") == (0, "", "")
    assert run("show", recording, "--expect", "unstable", "--expect", "stable", "-q")[0] == 0
    code, out, err = run("show", recording, "--expect", "unstable")
    assert code == 17
    assert "verdict" in out
    assert (
        "rig: the hit is stable, expected unstable; see the recording, or change what --expect allows" in err
    )
    code, out, err = run("show", recording, "--expect", "invalid", "--json", "-q")
    assert (code, json.loads(out)["trailer"]["verdict"]["kind"]) == (17, "stable")


def test_a_hit_for_a_script_prints_nothing_and_says_all_by_its_exit_code(run: Any, tmp_path: Path) -> None:
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


@pytest.mark.usefixtures("coarse")
def test_a_run_that_ends_early_still_gives_verdict_picture_and_the_hits_before_it(
    run: Any, tmp_path: Path
) -> None:
    throwing = [
        "-K",
        "1500",
        "-B",
        "0",
        "--effort",
        "0.5",
        "--set",
        "rig.limits.position_maximum=0.005",
        *QUICK,
    ]
    code, out, err = run("hit", *throwing)
    assert code == 10
    assert "unstable" in out
    assert "threw the handle out" in out
    assert "position 0.005" in err
    assert list((tmp_path / "recordings").glob("*.png"))
    code, out, _ = run("hit", "--json", "--no-plot", *throwing)
    told = json.loads(out)
    assert told["hits"] == []
    assert told["error"]["exit_code"] == code == 10
    assert open_recording(told["error"]["recording"]).trailer["verdict"]["kind"] == "unstable"


def test_an_error_is_json_too_when_json_was_asked_for(run: Any) -> None:
    code, out, err = run("hit", "--json", "--effort", "0.03")
    facts = json.loads(out)["error"]
    assert facts["exit_code"] == code == 2
    assert "counts" in facts["error"]
    assert err.startswith("rig: ")


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


def test_a_directory_that_cannot_be_written_is_refused_before_anything_moves(
    run: Any, tmp_path: Path
) -> None:
    (tmp_path / "recordings").write_text("a file in the way", encoding="utf-8")
    code, _, err = run("hit", "--no-plot")
    assert code != 0
    assert "recordings" in err


@pytest.mark.signals
def test_kill_ends_a_hit_that_must_not_hear_ctrl_c_with_its_own_exit_code_and_a_recording(
    tmp_path: Path,
) -> None:
    """A shell that lets Ctrl-C be ignored, as that of `nohup … &`, means it: kill ends what it starts.

    Ctrl-C that is heard: `test_nothing_is_left`.
    """
    options = ("--duration", "3000", "--no-plot", "--output", tmp_path / "out")
    command = ("env", "--ignore-signal=INT", sys.executable, "-m", "rig", "hit", *options)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with started(*command, **pipes) as process:
        deadline = time.monotonic() + 100.0
        for size, number in enumerate((signal.SIGINT, signal.SIGTERM), start=1):
            while sum(path.stat().st_size for path in tmp_path.glob("out/*.rigcap")) < size * 1_000_000:
                assert process.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.01)
            process.send_signal(number)
        _, err = process.communicate(timeout=60.0)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "stopped" in err
    (parquet,) = (tmp_path / "out").glob("*.parquet")
    recording = open_recording(parquet)
    assert recording.complete
    assert recording.trailer["reason"] == "stopped"
    assert recording.rows["current_sent"][-1] is not None


HIDE_THE_SIMULATION = """
import json, sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "sim_backend":
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Hidden())
import rig.cli
from rig import config
from rig.config import presets
from rig.devices.local import serve_locally
for arguments, code in json.loads(sys.argv[1]):
    assert rig.cli.run(arguments) == code, arguments
"""


def test_without_the_simulation_the_rest_still_works(recording: Any, tmp_path: Path) -> None:
    theory = [
        "theory",
        "walls",
        "--rig",
        "koul-rigid",
        "--scheme",
        "dual:20k/2k",
        "--operator",
        "normal",
        "--no-plot",
    ]
    whole = (["--help"], ["experiment", "plan"], ["device", "list"], ["show", str(recording)], theory)
    runs = [*((words, 0) for words in whole), (["hit"], 3)]
    done = subprocess.run(
        [sys.executable, "-c", HIDE_THE_SIMULATION, json.dumps(runs)],
        capture_output=True,
        text=True,
        timeout=100,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_importing_rig_or_the_protocol_loads_nothing_heavy() -> None:
    code = (
        "import sys, rig, firmware_protocol, rig.cli; "
        "heavy = set('numpy numba scipy matplotlib pyarrow pydantic serial rich'.split()) & set(sys.modules); "
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=30)


def test_a_grip_brings_its_numbers_and_the_limits_for_people(run: Any) -> None:
    code, out, _ = run("hit", "--operator", "firm", "--no-plot")
    assert code == 0
    assert (
        "in effect: rig.limits.effort = 0.286 instead of 1.3, rig.limits.human = True instead of False\n"
        in out
    )


# ---------------------------------------------------------------------- what becomes of the output


def test_a_reader_that_has_gone_is_nothing_to_complain_about() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "rig", "experiment", "preset"], stdout=writer, stderr=PIPE, check=False
        )
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (0, b"")


# Each command in a fork of a process that has loaded what it needs; it ends as ``python -m rig`` does.
WITHOUT_ROOM = """
import contextlib, io, json, os, runpy, sys
import rig.cli
with contextlib.redirect_stdout(io.StringIO()):
    rig.cli.run(["experiment", "preset"])
for words, full in json.loads(sys.argv.pop()):
    if child := os.fork():
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), file=sys.stderr, flush=True)
        continue
    for descriptor in full:
        os.dup2(os.open("/dev/full", os.O_WRONLY), descriptor)
    sys.argv += words
    runpy.run_module("rig", run_name="__main__", alter_sys=True)
"""


@pytest.mark.parametrize("unbuffered", first_by_default(["", "1"]))
def test_an_output_without_room_has_an_exit_code_of_its_own(
    unbuffered: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where Python buffers its output, as it does unless PYTHONUNBUFFERED is set: it was 120 there."""
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    stdout, stderr = 1, 2
    cases = [
        (words, full, 74 if used in full else code)
        for words, code, used in (
            (["experiment", "preset"], 0, stdout),
            (["experiment", "preset", "nobody"], 2, stderr),
        )
        for full in ([stdout], [stderr], [stdout, stderr])
    ]
    words = json.dumps([one[:2] for one in cases])
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_ROOM, words], capture_output=True, text=True, check=True
    )
    assert re.findall(r"^\d+$", done.stderr, re.MULTILINE) == [str(code) for *_, code in cases]
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


def test_a_pipe_that_breaks_elsewhere_is_no_reader_that_has_gone(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def breaks(**_: Any) -> None:
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    monkeypatch.setattr(rig.cli.rig, "invoke", lambda context: breaks())
    assert rig.cli.run(["experiment", "preset"]) == 74
    assert "may be incomplete" in capfd.readouterr().err


@pytest.mark.parametrize("option", first_by_default([["--json"], []]))
def test_a_name_that_is_no_text_is_shown_in_any_locale(option: list[str]) -> None:
    environment = {**os.environ, "PYTHONUTF8": "1", "PYTHONIOENCODING": "utf-8:strict"}
    command = [sys.executable, "-m", "rig", "experiment", "preset", *option, b"\xff.toml"]
    done = subprocess.run(command, capture_output=True, env=environment, check=False)
    assert done.returncode == 2
    assert b"\\udcff.toml" in done.stderr
    assert not option or json.loads(done.stdout)["error"]["error"].startswith("preset \udcff.toml")


def test_the_schema_of_experiment_files_is_printed(run: Any) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    code, out, _ = run("experiment", "schema")
    schema = json.loads(out)
    assert code == 0
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    table = tomllib.loads('preset = "koul-rigid"\n[wall]\nstiffness = 100.0\n')
    assert not list(validator.iter_errors(table))
    assert list(validator.iter_errors({"wall": {"stiffness": "stiff"}}))
