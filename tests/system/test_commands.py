"""Every command once: a successful run as text and as JSON, and wrong options with their exit codes."""

import json
import shlex
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import pytest

if numba.config.DISABLE_JIT:
    pytest.skip("plug points are function types of compiled code", allow_module_level=True)

import rig.cli
from rig.devices import framed
from rig.doctor import _wake_up as wake_up
from rig.experiments.trials import live
from tests.conformance.commands import commands, resolve
from tests.conformance.guides import ROOT
from tests.conformance.started import started
from tests.system.session_study import PROTOCOL

BRIEF = "--set trial.duration_s=0.3 --set verdict.tail_s=0.1 --set homing.settle_s=0.02"
HIT = f"{BRIEF} --rate 4k/1k -K 100 -B 0.1"
TINY = f"{BRIEF} --operator none --offsets 0.1 --scheme uniform:10k -B 0.1,0.3"
LINES = "--periods 2 --realisations 2 --set excitation.settle_periods=1"
SHEET = (
    "--mechanism lever --torque-constant 38.5mNm/A --rotor-inertia 110gcm2 --nominal-current 2.5A --encoder-lines 2048 "
    "--transmission 12 --handle-length 8cm --handle-mass 60g"
)
NO_FILE = "nothere.parquet"
WRITES_ONCE = ("experiment new", "session new", "session export")  # and refuse to write it again


@dataclass(frozen=True)
class Row:
    """One command with a successful call and calls that it must reject."""

    name: str  # words of the command, such as "session new"
    good: str  # options of a successful run in the directory `made`; or the test that runs the command elsewhere
    keys: str  # of the JSON of that run, in any order; of a list, those of its first item
    word: str  # that the text output contains
    refused: tuple[tuple[str, int, str], ...]  # options, exit code, and words of the message
    files: str = ""  # pattern of those that a successful run writes


ROWS = (
    Row("experiment new", f"new.toml {SHEET}", "name path text assumed experiment", "assumed", (
        ("new.toml", 2, "--mechanism is missing"),
        (f"new.toml {SHEET} --peak-current '5 V'", 2, "--peak-current = '5 V'"),
        (f"mine.toml {SHEET}", 2, "mine.toml exists"),
    ), "new.toml"),
    Row("experiment plan", "mine.toml", "rig repeats steps checks duration_s ok", "nothing moves", (
        ("mine.toml --rig koul-rigid", 2, "both a file and --rig"), ("--rate fast", 2, "--rate fast"),
        ("--set wall.stiffness", 2, "key=value"), ("--effort 0.05", 2, "1.1 counts"),
        ("wrong.toml", 2, "did you mean stiffness"), ("broken.toml", 2, "line 2"),
        ("--rate 20k/3k", 2, "velocity_rate"), ("--estimator fdm-butterwort", 2, "fdm-butterworth"),
    )),
    Row("experiment preset", "koul-rigid",
        "rig controller wall homing trial operator verdict excitation host realtime", "koul-rigid",
        (("unknown", 2, "unknown"),)),
    Row("experiment schema", "", "$defs additionalProperties description properties title type", "properties",
        (("koul-rigid", 2, "unexpected extra argument"),)),
    Row("hit", f"{HIT} --repeats 2", "hits error", "verdict", (
        ("nothere.toml", 2, "nothere.toml"), ("--rig koul-complaint", 2, "koul-compliant"),
        ("--url can://1:2", 2, "no backend for can://"),
        ("--url serial:///dev/nothere", 3, "no port /dev/nothere"), ("--url nonsense", 2, "no scheme"),
        ("--rate 100k", 2, "50 to 50000"),
    ), "recordings/*.png"),
    Row("identify", "--rig chawda-linear --realisations 2 --period 0.25 -o new.toml",
        "signs sliding dynamics cogging ripple recordings sources warnings simulated rig motion picture file plan",
        "Coulomb friction", (
        ("--realisations 1", 2, "too few for a confidence interval"), ("-o .", 2, "is a directory"),
        ("--cogging 7 --arm 0.1", 2, "needs --weight"), ("--rig chawda-linear --rate 50", 2, "50 Hz"),
    ), "new.toml"),
    Row("impedance measure", f"{LINES} -K 10000 -B 20", "results table picture", "worst line", (
        ("--band 1-250", 2, "--band 1-250 is not a frequency band"),
        ("-K 1,2,3 -B 1,2", 2, "3 stiffnesses and 2 dampings"), ("-K hard", 2, "is not a list of numbers"),
        ("--judged-band 300:400", 2, "no excited frequency lies between"),
        ("--verified", 2, "--url"), ("--kind schroeder --realisations 3", 2, "must be 1"),
    ), "impedances/*/impedance.parquet"),
    Row("impedance map",
        f"-K 5000,10000 -B 60,120 --scheme uniform:1k,estimator=fdm-butterworth,cutoff_hz=499 {LINES}",
        "domain rig motion stiffnesses dampings judging excitation signal passive experiment table_one "
        "directory picture", "fidelity at", (
        ("-K 10:100", 2, "first:last:count"), ("-K 100,10", 2, "not in rising order"),
        ("--judged-band many", 2, "1:250"), ("--amplitude 500", 2, "lower excitation.rms"),
        ("--amplitude 90", 2, "reduce the excitation"),
        ("--workers 2 --scheduler tcp://127.0.0.1:1", 2, "either"),
    ), "maps/*/walls.parquet"),
    Row("compare", "--rig koul-rigid --duration 0.2 --set verdict.tail_s=0.05",
        "start outcomes rig motion wall cutoffs picture", "encoder offsets", (
        ("--scheme none --scheme none", 2, "given twice"),
        ("--set trial.repeats=3", 2, "without noise"), ("--scheme triple:20k", 2, "must begin with 'uniform:'"),
    ), "recordings/*.png"),
    Row("zwidth", f"{TINY} --search bisection --ratio 3",
        "rig motion trial schemes search offsets repeats judged hits invalid cutoffs note experiment "
        "directory picture", "K peak", (
        ("-K 10", 2, "LOW:HIGH"), ("-K 0:100", 2, "is not a rising range above zero"),
        ("-B 0:1:0", 2, "a count of 1"),
        ("-B x", 2, "--damping 'x' is not a list"), ("--offsets 1", 2, "--offsets"),
        ("--ratio 1", 2, "ratio of 1 between two"), ("--url sim:// --judge true", 2, "true signals of a simulation"),
        ("--verified", 2, "--verified needs a device"),
        ("-K 10:1e9", 2, "--effort"), ("--url sim:// --workers 2", 2, "by one program only"),
        ("--operator firm --effort 0.2", 2, "has no effect: a hand pushes"),
        ("--url sim:// --offsets 0.1,0.2", 2, "2 encoder offsets"), ("--operator strong", 2, "relaxed"),
    ), "maps/*/hits.parquet"),
    Row("design",
        "tests/system/test_cli_design.py::test_a_design_is_printed_as_json", "", "",
        (("-K 300", 2, "--must-be-stable"), ("--confirm no", 2, "--confirm needs a device"),
        ("--must-be-stable -K -1", 2, "wall.stiffness = -1"), ("--goal best", 2, "'area', 'quiet'"),
        ("--url sim:// --most-rate 10k", 2, "--most-rate is given together with --url"),
        ("--scheme uniform:10k,estimator=fmd", 2, "fmd"), ("--fidelity-to 0", 2, "above 0"),
        ("--round-trip -1", 2, "--round-trip = -1"), ("--paper --rig hapkit", 2, "choose one of koul-rigid"),
        ("--most-cost 1 --operator none --scheme uniform:10k,cutoff_hz=400", 2, "the limiting one is 1 (--most-cost)"),
        )),
    Row("theory walls", "--scheme dual:20k/2k",
        "rig motion structure operator end_mass damping rig_damping drive lag_s set_point_delay_s "
        "delay_ticks schemes in_hand not_linear cutoffs picture", "(binds)", (
        ("--scheme uniform:20k,estimator=levant", 2, "levant is not linear"),
        ("--operator iron", 2, "unknown grip 'iron'"),
    ), "theory-koul-compliant.png"),
    Row("theory disagreement", f"{TINY} --ratio 3",
        "rig schemes walls unknown hits dampings search offsets repeats judged experiment paragraph "
        "directory picture", "linear theory and", (
        ("-B 0.3,0.1", 2, "not in rising order"),
        ("--scheme uniform:10k,estimator=levant -B 0.1", 2, "is not linear"),
    ), "maps/*/walls.parquet"),
    Row("theory limit-cycles", "--scheme uniform:20k -K 400 -B 0.6", "rig walls tallies", "without friction", (
        ("-K 10", 2, "give both, or neither"), ("-K 0 -B 1", 2, "above zero"),
        ("-K x -B 1", 2, "is not a list of numbers"),
        ("--scheme uniform:20k,estimator=levant", 2, "is not linear"),
    )),
    Row("theory levant-regions", "", "picture parameters crossing named mu2 hba_mu1 lfba_mu1 numeric",
        "cross at mu1", (), "levant-regions.png"),
    Row("estimators list", "fdm-butterworth", "name summary source delay_s delay_at refused parameters", "cutoff_hz",
        (("fmd", 2, "unknown estimator 'fmd'"),)),
    Row("estimators compare", "--rate 2k --estimator fdm-butterworth:cutoff_hz=100,order=1 --no-time",
        "cases variants scores picture", "2000 Hz", (
        ("--signal square", 2, "choose one of"), ("--rate 2q", 2, "not a whole number of Hz"),
        ("--resolution -1", 2, "must be above 0"), ("--estimator fdm:cutoff", 2, "has no value"),
        (NO_FILE, 9, NO_FILE),
    ), "estimators.png"),
    Row("estimators tune", "fdm-butterworth --free cutoff_hz --overwrite",
        "estimator case reference objective settings objective_start objective_best ranges before after "
        "evaluations toml", "within 10 %", (
        ("fdm", 2, "no tunable setting"), ("fdm-butterworth --rate 1k,2k", 2, "expected a single rate"),
        ("fdm-butterworth --objective beauty", 2, "choose one of"), ("fdm-butterworth -o mine.toml", 2, "exists"),
        (f"fdm-butterworth {NO_FILE}", 9, NO_FILE),
    ), "fdm-butterworth-tuned.toml"),
    Row("estimators export", "kalman:gain=steady --rig koul-rigid --no-costs --overwrite",
        "estimator settings rig velocity_rate_hz resolution unit motion samples tolerance costs "
        "cost_unknown header test arithmetic", "kalman",
        (("period --rig koul-rigid", 2, "cannot be exported as C"), (f"fdm {NO_FILE}", 9, NO_FILE)), "kalman.h"),
    Row("estimators lipschitz", "hit.parquet --sines 2",
        "lipschitz residual_rms offset frequencies_hz amplitudes phases lipschitz_with_one_more_sine", "use it",
        ((NO_FILE, 9, NO_FILE),)),
    Row("estimators rank",
        "tests/extras/papers/test_ranking.py::test_the_command_writes_results_and_their_page", "",
        "", (("no-rig", 2, "koul-rigid"), ("hapkit --entry mine", 2, "does not name an estimator"))),
    Row("reproduce",
        "tests/extras/papers/test_reproduction.py::test_the_command_writes_one_report_and_resumes_from_its_journal", "",
        "", (("unknown", 2, "koul"), ("koul --quick -o mine.toml/below", 9, "cannot make"),
        ("chawda --impacts", 2, "the paper chawda"))),
    Row("session new", "new.toml", "file template schema", "rig session check",
        (("mine.toml", 9, "exist"), ("--template koul-fig5", 2, "did you mean koul-fig6")), "new.toml"),
    Row("session check", "quick.toml",
        "title rig motion kind participants rows blocks runs practice cells trials trial taken duration_s "
        "trial_bytes disk_bytes rehearsal_s heat orders hidden blinded checks session_s ok", "trials", (
        ("mine.toml", 2, "mine.toml"), ("broken.toml", 2, "not valid TOML"),
        ("quick.toml --participants 0", 2, "participants"),
    )),
    Row("session run", "quick.toml P07 --rehearse --again",
        "directory code row ended stopped trials counted invalid by_machine aborted outside blocks "
        "blocks_done resume messages invalid_trials", "session of P07: complete", (
        ("quick.toml P01 --lapse-rate 0.1", 2, "need --rehearse"),
        ("quick.toml P03 --rehearse --threshold hidden-dua=60", 2, "did you mean hidden-dual?"),
        ("quick.toml P03 --rehearse --threshold hidden-dual=nan", 2, "=nan is not a stiffness"),
        ("quick.toml P03 --rehearse --spread 0", 2, "--spread 0 is not a stiffness"),
        ("quick.toml P03 --rehearse --lapse-rate -0.5", 2, "is not a share"),
        ("quick.toml P03 --rehearse --people-sd -1", 2, "--people-sd -1 is not a standard deviation"),
        ("quick.toml P03 --rehearse --row 99", 2, "give --row 0 to 11"),
        ("quick.toml ../P03 --rehearse", 2, "path"),
        ("quick.toml 'Anna Smith' --rehearse", 2, "participant code"),
    ), "rehearsals/quick/P07/*.log"),
    Row("session resume", "tests/system/test_cli_session.py::test_a_damaged_last_line_is_reported_and_set_aside",
        "", "", (("P01", 2, "has ended"),)),
    Row("session show", "P01",
        "directory code row ended stopped trials counted invalid by_machine aborted outside blocks "
        "blocks_done resume messages invalid_trials events", "complete", (("directory", 9, "directory"),)),
    Row("session amend", "P01 --trial 2 void --why bumped", "number corrects value why", "void",
        (("P01 x buzz --why x", 2, "is not a correction"),)),
    Row("session analyse", "P01 --no-report -o analysis",
        "title rehearsed messages units measure seed include_marked conditions participants answers trials "
        "runs of_participants over_participants paired mixed agreements psychometrics slopes blocks tables "
        "pictures report", "No complete run", (("directory", 9, "no session"),), "analysis/*.csv"),
    Row("session export", "P01 --csv out", "csv", "out", (("P01", 2, "--bids"),), "out/*"),
    Row("session schema", "", "$schema $defs additionalProperties description properties required title type",
        "properties", (("extra", 2, "unexpected extra argument"),)),
    Row("show", "hit.parquet --xy", "header trailer rows complete lost columns picture", "columns", (
        (NO_FILE, 9, NO_FILE), ("hit.parquet --expect unstable", 17, "expected unstable"),
        ("hit.parquet -o a.png --format svg", 2, "different formats"), ("mine.parquet", 9, "mine.parquet"),
    ), "hit-xy.png"),
    Row("recording show", "hit.parquet --marks", "header trailer rows complete lost columns picture marks",
        "contact", ((NO_FILE, 9, NO_FILE),)),
    Row("recording timing", "hit.parquet",
        "passed_over never_active unanswered within_tick period_ns clock clock_sd_ns loop execution_ns "
        "ticks duration_s stages edges_ns worst counts picture", "computed", ((NO_FILE, 9, NO_FILE),),
        "hit-timing.png"),
    Row("recording replay", "hit.parquet --estimator fdm --plot",
        "estimator law exact velocity_difference effort_difference ticks picture", "equal to the last bit",
        ((NO_FILE, 9, NO_FILE),), "hit-replay.png"),
    Row("recording export", "hit.parquet hit.csv --overwrite", "recording target", "hit.csv",
        ((f"{NO_FILE} x.csv", 9, NO_FILE), ("hit.parquet mine.toml", 9, "the formats are csv")), "hit.csv"),
    Row("recording import", "log.csv --count counts --time-column t --resolution 1e-3 --overwrite",
        "file sha256 rate_hz resolution width lost_samples gaps longest_gap deviation_max deviation_rms "
        "rows recording", "log.parquet",
        (("log.csv --count missing --time-column t --resolution 1e-3", 9, "missing"),), "log.parquet"),
    Row("recording recover", ".", "captures error", "nothing to recover", (("nowhere", 2, "nowhere"),)),
    Row("device list", "", "backends ports usb simulated", "sim://", (("sim://", 2, "unexpected extra argument"),)),
    Row("device show", "sim://koul-rigid",
        "device firmware simulated protocol our_protocol dictionary_hash position_rate_default "
        "position_rate_maximum current_quantum_a law settings url state fault messages clock port", "koul-rigid",
        (("serial:///dev/null", 3, "/dev/null"),)),
    Row("device parameters", "sim://koul-rigid", "url state crc parameters", "current_limit",
        (("serial:///dev/nothere", 3, "no port"),)),
    Row("device check", "--rig koul-rigid", "rig motion device recording checks ok", "ok",
        (("--rig koul-compliant --url sim://koul-rigid", 2, "--rig koul-rigid"),), "recordings/*.parquet"),
    Row("device reference", "reference.toml --url sim://?incremental=1 --set homing.speed=0.5",
        "rig motion device reference_count index_count position switch_position index_counts recordings", "position",
        (("--rig koul-rigid", 2, "rig.reference"),)),
    Row("doctor", "", "checks ports admission device link walls gate armable error", "ports", ()),
    Row("firmware build", "--board list", "name description rate_maximum settings", "mps2",
        (("--board arduino", 2, "mps2"),)),
    Row("firmware amplifiers", "",
        "name description source drive set_point_delay_s most_a steps pwm_frequency settings set_up", "escon",
        (("extra", 2, "unexpected extra argument"),)),
    Row("firmware wiring", "", "parts nets drawing", "wiring.svg", (("--board arduino", 2, "mps2"),), "wiring.svg"),
    Row("firmware info", "sim://koul-rigid",
        "device firmware simulated protocol our_protocol dictionary_hash position_rate_default "
        "position_rate_maximum current_quantum_a law settings source facts checks compatible", "compatible",
        (("mine.toml", 2, "mine.toml"),)),
    Row("firmware flash", "tests/system/test_cli_firmware.py::test_an_image_is_flashed_to_a_pico",
        "", "", (("none.uf2 --drive .", 2, "none.uf2"),)),
    Row("firmware selftest", "sim://koul-rigid --rig koul-rigid --rate 2000 --seconds 0.1",
        "url device firmware simulated checks passed", "ok ticks: 2000.00 Hz",
        (("sim://koul-rigid --rig chawda-linear --rate 1000 --seconds 0.1", 5, "--rig chawda-linear"),)),
    Row("firmware check-port", "tests/firmware/test_port_check.py::test_the_command_says_the_duty_that_is_broken",
        "", "", (("sim://koul-rigid", 5, "rig firmware build --check-port"),)),
    Row("serve rig", "tests/system/test_commands.py::test_a_rig_is_served_on_a_port_until_a_signal", "url rig", "",
        (("--rate 1", 2, "from 50 to 20000 Hz"), ("--rig unknown", 2, "unknown"))),
    Row("serve moteus",
        "tests/extras/drives/test_bridge_process.py::test_the_command_serves_one_host_after_the_other", "", "",
        (("/dev/nothere --id 200", 2, "--id"),)),
    Row("serve odrive",
        "tests/extras/drives/test_bridge_process.py::test_an_odrive_gets_no_torque_when_its_bridge_is_killed", "",
        "", (("can0", 2, "--endpoints"),)),
    Row("serve lsl", "tests/extras/lsl/test_lsl.py::test_markers_of_a_session_are_its_log_without_the_walls", "",
        "", (("--rate 0", 2, "rate"),)),
    Row("serve docs", "tests/system/test_docs.py::test_a_site_is_built", "", "",
        (("extra", 2, "unexpected extra argument"),)),
    Row("console", "tests/extras/console/test_console.py::test_a_killed_console_leaves_nothing_that_moves", "", "",
        (("--port 70000", 2, "70000"),)),
    Row("stop", "--list", "loops hidden", "", (("unknown", 2, "unknown"),)),
    Row("set", "stiffness=1", "pid number changes wall active ended", "active", (("stiffness", 2, "key=value"),)),
)  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a directory with one file of each kind that a command reads."""
    place = tmp_path_factory.mktemp("made")
    (place / "mine.toml").write_text('preset = "koul-compliant"\n')
    (place / "wrong.toml").write_text('preset = "koul-compliant"\n[wall]\nstifness = 3.0\n')
    (place / "broken.toml").write_text('preset = "koul-compliant"\n[wall\n')
    (place / "mine.parquet").write_bytes(b"PAR1 but not really")
    (place / "reference.toml").write_text(
        'preset = "koul-rigid"\n[rig.reference]\nindex = true\nlimit_switch = "minimum"\n'
        "position = -0.3\ntravel = 1.1\n"
    )
    (place / "log.csv").write_text("t,counts\n" + "".join(f"{n / 1000},{n * n // 50}\n" for n in range(200)))
    (place / "quick.toml").write_text(
        PROTOCOL.replace("repeats = 2", "repeats = 1").replace("most = 3", "most = 1")
    )
    (place / "directory").mkdir()
    quick = shlex.split(f"hit -q --no-plot {HIT} -o")
    assert rig.cli.run([*quick, str(place / "hits")]) == 0
    (hit,) = (place / "hits").iterdir()
    hit.rename(place / "hit.parquet")
    (place / "hits").rmdir()
    rehearse = ["session", "run", str(place / "quick.toml"), "P01", "--rehearse", "--study", str(place)]
    assert rig.cli.run([*rehearse, "--json"]) == 0
    return place


@pytest.fixture
def copied_files(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)


@pytest.fixture
def linked_files(made: Path, tmp_path: Path) -> None:
    """Link to the files of `made` from the working directory, for commands that write nothing."""
    for path in made.iterdir():
        (tmp_path / path.name).symlink_to(path)


@pytest.fixture
def brief_wake_ups(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measure for a twentieth of a second, in place of a whole one, how late this machine wakes a thread."""
    measure = wake_up.measure
    monkeypatch.setattr(wake_up, "measure", lambda request, seconds: measure(request, 0.05 * seconds))


@pytest.fixture
def accepting_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the running real-time loop by one that accepts each change of its wall."""
    done = live.LiveChange(7, 3, {"wall.stiffness": 1.0}, {}, active=True, ended=False)
    monkeypatch.setattr(live, "change_wall", lambda *_, **__: done)


def test_every_command_has_a_row_with_a_good_run() -> None:
    assert [row.name for row in ROWS] == [" ".join(words) for words, _ in commands()]
    for path, _, name in (row.good.partition("::") for row in ROWS if "::" in row.good):
        assert f"\ndef {name}(" in (ROOT / path).read_text(encoding="utf-8"), name


@pytest.mark.usefixtures("copied_files", "undrawn", "few_curve_points", "brief_wake_ups", "accepting_loop")
@pytest.mark.parametrize("row", [row for row in ROWS if "::" not in row.good], ids=lambda row: row.name)
def test_a_good_run_ends_with_0_as_json_and_as_text(row: Row, run: Any, tmp_path: Path) -> None:
    words = shlex.split(f"{row.name} {row.good}")
    code, out, err = run(*words, "--json")
    assert code == 0, err
    found = json.loads(out)
    assert set(found[0] if isinstance(found, list) else found) == set(row.keys.split())
    assert "next:" not in err
    if row.name in WRITES_ONCE:
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        (tmp_path / "new.toml").unlink(missing_ok=True)
    options = resolve(words)[0].command.params
    code, out, err = run(*words, *["--no-plot" for one in options if "--no-plot" in one.secondary_opts])
    assert code == 0, err
    assert row.word in out, out
    assert not row.files or list(tmp_path.glob(row.files)), sorted(tmp_path.rglob("*"))


REFUSALS = [(row.name, *refused) for row in ROWS for refused in row.refused]


@pytest.mark.usefixtures("linked_files")
@pytest.mark.parametrize(
    ("name", "given", "code", "words"), REFUSALS, ids=[f"{n} {g}" for n, g, *_ in REFUSALS]
)
def test_a_refusal_is_one_line_with_its_exit_code_and_leaves_nothing(
    name: str, given: str, code: int, words: str, run: Any, made: Path, tmp_path: Path
) -> None:
    before = {*tmp_path.rglob("*"), *made.rglob("*")}
    found, _, err = run(*shlex.split(f"{name} {given}"))
    assert (found, words in err) == (code, True), (found, err)
    assert any(line.startswith(("rig: ", "Error: ")) for line in err.splitlines())
    left = {path.suffix for path in {*tmp_path.rglob("*"), *made.rglob("*")} - before}
    assert left.isdisjoint((".rigcap", ".parquet", ".png", ".toml"))


@pytest.mark.quiet
def test_a_rig_is_served_on_a_port_until_a_signal(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(framed, "DRIFT_S", 0.2)  # how well the drift is known does not matter here
    command = (sys.executable, "-m", "rig", "serve", "rig", "--json")
    with started(*command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        served = json.loads("".join(iter(process.stdout.readline, "}\n")) + "}")
        assert served["rig"] == "koul-compliant"
        code, out, err = run("device", "show", served["url"], "--json")
        assert code == 0, err
        found = json.loads(out)
        assert (found["device"], found["messages"]) == ("koul-compliant", [])
        assert found["port"]["device"] == served["url"].removeprefix("serial://")
        process.send_signal(signal.SIGINT)
        assert process.wait(20.0) == 0
