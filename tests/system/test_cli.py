"""The commands as a person meets them: what they print, what they leave on disk, and how they refuse."""

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path
from queue import Queue
from subprocess import PIPE
from typing import Any

import numpy as np
import pytest

import rig.cli
from rig import config
from rig.config import presets
from rig.devices import framed
from rig.experiments.judgement import experiment_of, judge
from rig.recording.reader import open_recording
from rig.views.plots import style
from sim_backend import pty
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


def test_hit_prints_the_verdict_and_leaves_a_recording_and_a_picture(run: Any, tmp_path: Path) -> None:
    code, out, err = run("hit", *QUICK)
    assert code == 0, err
    (parquet,) = (tmp_path / "recordings").glob("*.parquet")
    recording = open_recording(parquet)
    experiment = experiment_of(recording)
    for row in judge(recording, experiment).rows(experiment):
        assert row.label in out
        assert row.text in out
    (picture,) = (tmp_path / "recordings").glob("*.png")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert open_recording(parquet).complete
    assert str(parquet.name) in out
    assert not list((tmp_path / "recordings").glob("*.rigcap"))


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
    assert (code, "not a name for a picture" in err, "Traceback" in err) == (9, True, False)


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


def test_hit_gives_the_numbers_as_json(run: Any) -> None:
    code, out, _ = run(
        "hit", "--json", "--no-plot", "-K", "200", "-B", "0.3", "--rate", "20k/2k", "--repeats", "2", *QUICK
    )
    assert code == 0
    first, second = json.loads(out)["hits"]
    assert first["verdict"]["kind"] == first["verdict_true"]["kind"] == "stable"
    assert first["stiffness"] == 200.0
    assert (first["position_rate"], first["velocity_rate"]) == (20000, 2000)
    assert first["recording"] != second["recording"]
    assert first["verdict"]["peak_penetration"] == pytest.approx(
        second["verdict"]["peak_penetration"], rel=0.2
    )


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


def test_a_wall_of_three_times_the_limit_is_not_stable(run: Any) -> None:
    code, out, _ = run(
        "hit", "--json", "--no-plot", "-K", "1500", "-B", "0", "--set", "trial.minimum_rest_counts=0"
    )
    assert code == 0
    (hit,) = json.loads(out)["hits"]
    assert hit["verdict"]["kind"] == "unstable"
    assert hit["verdict_true"]["kind"] == "unstable"


def test_show_says_what_a_recording_holds(run: Any, recording: Any, tmp_path: Path) -> None:
    code, out, _ = run("show", recording, "-o", tmp_path / "again.png")
    assert code == 0
    assert "finished" in out
    assert "position_true" in out
    assert "rad/s" in out
    assert (tmp_path / "again.png").stat().st_size > 10_000
    code, out, _ = run("show", recording, "--json")
    facts = json.loads(out)
    assert facts["header"]["experiment"]["wall"]["stiffness"] == 300.0
    assert facts["columns"]["velocity"] == "rad/s"
    assert facts["complete"]


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


def test_show_draws_force_over_penetration(run: Any, recording: Any) -> None:
    code, out, _ = run("show", recording, "--xy", "--format", "svg", "--json")
    picture = Path(recording).with_name(f"{Path(recording).stem}-xy.svg")
    assert (code, json.loads(out)["picture"]) == (0, str(picture))
    drawn = picture.read_text(encoding="utf-8")
    assert "penetration (rad)" in drawn
    assert "force of the wall (N·m)" in drawn
    code, _, err = run("show", recording, "-o", "a.png", "--format", "svg")
    assert (code, "two formats" in err) == (2, True)


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


def test_what_is_active_on_a_device_is_dumped_and_nothing_changes(run: Any) -> None:
    code, out, _ = run("device", "parameters", "sim://koul-rigid", "--json")
    active = json.loads(out)
    parameters = {one["name"]: one for one in active["parameters"]}
    assert code == 0
    assert {"current_limit", "float_stiffness"} <= set(parameters)
    assert all(one["value"] == one["default"] for one in parameters.values())
    assert parameters["float_stiffness"]["unit"] == "quantum/count"
    code, out, _ = run("device", "parameters", "sim://koul-rigid")
    assert f"{active['crc']:08x}" in out


def test_replay_with_the_same_settings_is_bit_exact(run: Any, recording: Any) -> None:
    code, out, _ = run("recording", "replay", recording, "--json")
    assert code == 0
    result = json.loads(out)
    assert result["exact"]
    assert result["velocity_difference"] == result["effort_difference"] == 0.0


def test_replay_through_another_estimator_shows_the_difference(
    run: Any, recording: Any, tmp_path: Path
) -> None:
    code, out, _ = run(
        "recording", "replay", recording, "--estimator", "fdm", "--json", "-o", tmp_path / "replay.png"
    )
    assert code == 0
    result = json.loads(out)
    assert result["estimator"] == "fdm"
    assert not result["exact"]
    assert result["velocity_difference"] > 0.01
    assert (tmp_path / "replay.png").exists()
    code, out, _ = run("recording", "replay", recording, "-K", "100", "--json")
    assert json.loads(out)["effort_difference"] > 0.01


@pytest.mark.parametrize("ending", ["csv", "mat", "parquet"])
def test_export_writes_the_formats_that_people_open(run: Any, recording: Any, ending: str) -> None:
    code, out, _ = run("recording", "export", recording, f"hit.{ending}")
    assert code == 0
    assert out.strip() == f"hit.{ending}"
    code, _, err = run("recording", "export", recording, f"hit.{ending}")
    assert code != 0
    assert "exists" in err
    assert run("recording", "export", recording, f"hit.{ending}", "--overwrite")[0] == 0


def test_plan_lists_steps_and_checks_and_touches_nothing(run: Any, tmp_path: Path) -> None:
    code, out, _ = run("experiment", "plan", "--rig", "chawda-linear")
    assert code == 0
    for words in ("home", "push", "release", "impact velocity", "N/m", "motor heat"):
        assert words in out
    assert not list(tmp_path.iterdir())
    code, out, _ = run("experiment", "plan", "--json")
    assert json.loads(out)["ok"]


def test_a_preset_prints_as_a_file_that_runs(run: Any, tmp_path: Path) -> None:
    code, out, _ = run("experiment", "preset", "koul-rigid")
    assert code == 0
    (tmp_path / "mine.toml").write_text(out, encoding="utf-8")
    assert run("experiment", "plan", "mine.toml")[0] == 0
    code, out, _ = run("experiment", "preset")
    assert "koul-compliant" in out


def test_devices_lists_backends_and_asks_a_simulated_one_who_it_is(run: Any) -> None:
    code, out, _ = run("device", "list")
    assert code == 0
    assert "sim://" in out
    assert "serial://" in out
    code, out, _ = run("device", "show", "sim://chawda-linear", "--json")
    facts = json.loads(out)
    assert facts["device"] == "chawda-linear"
    assert facts["simulated"]


@pytest.mark.quiet
def test_devices_asks_the_port_as_well_as_the_device_behind_it(
    run: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(framed, "DRIFT_S", 0.2)  # it is not asked here how well the drift is known
    announced, stop = Queue(), threading.Event()
    model = config.rig_model(presets.load("koul-compliant"))
    thread = threading.Thread(
        target=lambda: pty.serve(model, rate=1000, announce=announced.put, stop_event=stop), daemon=True
    )
    thread.start()
    url = f"serial://{announced.get(timeout=60.0)}"
    try:
        code, out, err = run("device", "show", url, "--json")
        assert code == 0, err
        told = json.loads(out)
        assert told["device"] == "koul-compliant"
        assert told["port"]["device"] == url.removeprefix("serial://")
        assert told["port"]["hangs_up"] is False
        assert told["messages"] == []
        code, out, err = run("device", "show", url)
        assert code == 0, err
        assert "port device" in out
    finally:
        stop.set()
        thread.join(60.0)


WRONG = {
    "unknown key": ("[wall]\nstifness = 3.0", ["mine.toml", "stifness", "stiffness"]),
    "out of range": ("[wall]\nstiffness = -5.0", ["mine.toml", "wall.stiffness", "-5", "≥ 0", "N·m/rad"]),
    "wrong type": ('[wall]\nstiffness = "hard"', ["mine.toml", "wall.stiffness", "hard", "number"]),
    "rates": ("[controller]\nvelocity_rate = 3000", ["mine.toml", "velocity_rate", "3000", "2500"]),
    "no toml": ("[wall\n", ["mine.toml", "line 2"]),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_refused_with_file_key_value_range_and_remedy(
    run: Any, tmp_path: Path, case: Any
) -> None:
    text, words = WRONG[case]
    (tmp_path / "mine.toml").write_text(f'preset = "koul-compliant"\n{text}\n', encoding="utf-8")
    for command in (["experiment", "plan"], ["hit", "--no-plot"]):
        code, out, err = run(*command, "mine.toml")
        assert code == 2
        assert out == ""
        for word in words:
            assert word in err, (word, err)


REFUSED = [
    (["hit", "nothere.toml"], 2, "nothere.toml"),
    (["hit", "--rig", "koul-complaint"], 2, "koul-compliant"),
    (["hit", "--url", "serial:///dev/nothere"], 3, "no port /dev/nothere"),
    (["hit", "--url", "serial://"], 2, "no port"),
    (["hit", "--url", "can://1:2"], 2, "no backend for can://"),
    (["hit", "--url", "usb://1:2"], 3, "there is no USB device 0001:0002"),
    (["hit", "--url", "usb://mine"], 2, "usb://"),
    (["hit", "--url", "sim://?colour=blue"], 2, "colour"),
    (["hit", "--url", "nonsense"], 2, "no scheme"),
    (["hit", "--estimator", "fdm-butterwort"], 2, "fdm-butterworth"),
    (["hit", "--rate", "20k/3k"], 2, "velocity_rate"),
    (["hit", "--rate", "fast"], 2, "--rate fast"),
    (["hit", "--rate", "100k"], 2, "50 to 50000"),
    (["hit", "--effort", "0.03"], 2, "counts"),
    (["hit", "--set", "wall.stiffness"], 2, "key=value"),
    (["hit", "--set", "controller.parameters.cutoff_hz=1500"], 2, "1000 Hz"),
    (["show", "nothere.parquet"], 9, "nothere.parquet"),
    (["recording", "replay", "nothere.parquet"], 9, "nothere.parquet"),
    (["recording", "export", "nothere.parquet", "x.csv"], 9, "nothere.parquet"),
    (["device", "show", "serial:///dev/null"], 3, "/dev/null"),
]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    REFUSED,
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_meant_is_refused_in_words(
    run: Any, tmp_path: Path, arguments: Any, code: Any, words: Any
) -> None:
    got, _, err = run(*arguments, *(["--no-plot"] if arguments[0] == "hit" else []))
    assert got == code, err
    if "no libusb" in err:
        pytest.skip("libusb is not installed (package libusb-1.0-0)")
    assert words in err
    assert err.splitlines()[-1].startswith("rig: "), "whatever was said of compiling before"
    assert not list(tmp_path.rglob("*.rigcap"))


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


def test_what_a_file_says_is_meant_in_real_time_too(tmp_path: Path) -> None:
    from rig import config  # noqa: PLC0415

    (tmp_path / "soft.toml").write_text(
        'preset = "koul-compliant"\n[wall]\nstiffness = 100.0\n[trial]\neffort = 0.2\n', encoding="utf-8"
    )
    experiment = config.with_realtime(config.load_experiment(tmp_path / "soft.toml"))
    assert experiment.wall.stiffness == 100.0
    assert experiment.trial.effort == 0.2
    assert experiment.wall.damping == 0.2, "what the file leaves open is the preset's gentler value"
    assert experiment.controller.position_rate == 1000


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


def test_a_url_alone_names_the_rig(run: Any) -> None:
    code, out, _ = run("hit", "--url", "sim://koul-rigid", "--no-plot", "--json", *QUICK)
    assert code == 0
    assert json.loads(out)["hits"][0]["rig"] == "koul-rigid"


def test_a_push_that_rests_below_two_counts_is_refused_with_the_number(run: Any) -> None:
    _, _, err = run("experiment", "plan", "--effort", "0.05")
    assert "1.1 counts" in err


def test_a_file_that_is_no_recording_is_refused(run: Any, tmp_path: Path) -> None:
    (tmp_path / "x.parquet").write_bytes(b"PAR1 but not really")
    assert run("show", "x.parquet")[0] == 9
    (tmp_path / "y.rigcap").write_bytes(np.random.default_rng(1).bytes(1000))
    assert run("recording", "replay", "y.rigcap")[0] == 9


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
