"""The page and the pictures of a study: complete, self-contained, safe against injected text, all deviations listed."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.image
import pytest
from click.testing import CliRunner

from rig.cli import rig
from rig.config._sections import OSCILLATIONS
from rig.config._table import parameters
from rig.extras.study import AnalysisOptions, analyse, cli_report
from rig.extras.study.plots import draw_study, pictures, tracks_name
from rig.extras.study.report import NUMBERS, PAGE, numbers, render, write_session_report
from rig.extras.study.report_events import _with_units, deviations, invalid_trials, notes
from rig.extras.study.report_methods import effective, methods
from rig.extras.study.report_tables import summarise_differences
from rig.session.engine._state import SessionState
from rig.session.search._psychometric import LAPSE_RATES
from rig.views.plots import style
from rig.views.report._writing import interval
from tests.conformance.pages import ParsedPage
from tests.conformance.studies import Person, protocol, sitting, without_sync, write_study
from tests.conformance.tiers import first_by_default

NASTY = "</script><script>alert('K < B & \"C\"')</script> $\\frac$ http://evil"
CONDITIONS = [
    {"name": "uniform <i>", "scheme": "uniform:2k", "damping": [0.0, 0.5]},
    {"name": "_dual $x", "scheme": "dual:20k/2k", "damping": [0.0, 0.5]},
]
SECTIONS = (
    "results", "kmax", "differences", "psychometric", "agreement", "effects", "plan", "participants", "tracks",
    "questionnaire", "deviations", "methods", "provenance",
)  # fmt: skip


def person(offset: float = 0.0, **settings: Any) -> Any:
    return Person(
        threshold=lambda condition, damping: (
            (500.0 + 2.0 * offset if "dual" in condition else 400.0 + offset) + 100.0 * damping
        ),
        **settings,
    )


def make_protocol(**sections: Any) -> Any:
    chosen = {
        "study": {"title": f"Two schemes {NASTY}", "participants": 3, "changes": {"operator.press": 2.0}},
        "search": {"step": 20.0, "settings": {"turns": 2, "most": 40}},
        "order": {"repeats": 2},
        "condition": CONDITIONS,
        "practice": {"stiffness": [100.0]},
        "question": [{"name": "tired", "text": f"Tired? {NASTY}", "when": "end", "kind": "text"}],
    }
    return protocol(**{**chosen, **sections})


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Three people, with every kind of deviation."""
    where = tmp_path_factory.mktemp("study")
    mapping = make_protocol()
    with without_sync():
        with sitting(where / "P01", mapping, person(), row=0, recorded=True) as one:
            one.run(5)
            one.record("note", text=NASTY, trial=5)
            one.record("redone", trial=one.state.newest)
            one.run(4)
            one.record("paused", reason="requested by the operator")
            one.now[0] += 90.0
            one.record("continued")
            one.run()
        with sitting(where / "P02", mapping, person(20.0, invalid=0.1), code="P02", row=1, seed=2) as one:
            one.run(12)
            one.record("stopped", reason="the operator left")
            one.now[0] += 4000.0
            one.record("resumed", where="block", abandoned=[{"file": "trials/t0013.parquet", "sha256": "ab"}])
            one.record("restarted", block=one.state.begun[-1])
            one.run()
        with sitting(where / "P03", mapping, person(-20.0, unsure=0.05), code="P03", row=2, seed=3) as one:
            one.run(6)
            judged = [event.number for event in one.log.events if event.kind == "judged"][-1]
            one.log.append("amended", number=judged, field="verdict", value="unsure", why="the wrong key")
            one.state = SessionState.of(one.log.events)
            one.record("skipped", run=one.state.next().presented.run)
            one.run(20)
            one.record("ended", reason="60 minutes")
    (where / "P01/trials/t0002.parquet").unlink()
    return where


@pytest.fixture(scope="module")
def found(study: Any) -> Any:
    return analyse([study])


@pytest.fixture(scope="module")
def page(found: Any) -> Any:
    return render(found, dict.fromkeys(pictures(found), b"a picture"))


def test_the_page_is_whole_and_needs_nothing_else(page: Any) -> None:
    read = ParsedPage(page)
    assert page.startswith("<!DOCTYPE html>")
    assert set(SECTIONS) <= set(read.ids)
    assert len(set(read.ids)) == len(read.ids)
    assert all(source.startswith(("data:image/png;base64,", "#")) for source in read.sources)
    assert {source[1:] for source in read.sources if source.startswith("#")} <= set(read.ids)
    assert "(no picture)" not in read.text
    assert "@media print" in page
    for name in ("Uniform", "nan", "None", "Traceback"):
        assert not re.search(rf"\b{name}\b", read.text)


def test_below_three_participants_there_is_no_p_no_interval_over_them_and_one_sentence_why(
    tmp_path: Path,
) -> None:
    mapping = protocol(search={"step": 50.0, "settings": {"turns": 2}}, order={"repeats": 2})
    with without_sync():
        write_study(tmp_path, mapping, {f"P{n:02d}": person(40.0 * n) for n in range(2)})
    found = analyse([tmp_path])
    read = ParsedPage(render(found, {}))
    assert not [
        head for head, *_ in read.tables if any(name.startswith("p") and "Holm" in name for name in head)
    ]
    assert not re.search(r"p \(Holm\) (=|<)", read.text)
    over = [dict(zip(head, row, strict=True)) for head, *rows in read.tables if "SD" in head for row in rows]
    assert all("participant" in row or "95 %" not in row for row in over)
    text = " ".join(read.text.split())
    (sentence,) = re.findall(r"No interval and no p value for [^;]*?: ([^.]*)", text)
    assert sentence.startswith("2 participants;")
    for one in (*found.paired, *found.over_participants, *found.slopes):
        assert all(math.isnan(value) for value in (one.low, one.high))
        assert one.problem


def test_texts_of_users_are_text(page: Any) -> None:
    read = ParsedPage(page)
    assert read.scripts == 1  # the numbers
    assert read.text.count(NASTY) >= 3  # title, question, note
    assert "uniform <i>" in read.text
    printed = json.loads(read.numbers)
    assert printed["title"].endswith(NASTY)
    assert printed["notes"][0]["detail"] == NASTY


def test_the_numbers_are_those_of_the_analysis(page: Any, found: Any, tmp_path: Path) -> None:
    printed = json.loads(ParsedPage(page).numbers)
    assert printed == json.loads(json.dumps(numbers(found), allow_nan=False))
    assert len(printed["runs"]) == len(found.runs)
    paths = write_session_report(found, {}, tmp_path)
    assert [path.name for path in paths] == [PAGE, NUMBERS]
    assert json.loads(paths[1].read_text(encoding="utf-8")) == printed
    assert "(no picture)" in paths[0].read_text(encoding="utf-8")


def test_pictures_that_fail_cost_the_page_nothing_else(
    alone: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(figure: Any, path: Path) -> Path:
        raise RuntimeError("no fonts")

    monkeypatch.setattr(style, "save", fails)
    drawn, page = cli_report.write_report(alone, tmp_path, "svg", lambda *_: None)
    assert drawn == {}
    assert "(no picture)" in page.read_text(encoding="utf-8")
    assert ": no fonts" in capsys.readouterr().err


def test_every_deviation_is_listed(found: Any, page: Any) -> None:
    listed = [(one.participant, one.what, one.detail) for one in deviations(found.study)]
    holds: dict[tuple[str, str], tuple[str, ...]] = {
        ("P01", "redone"): (),
        ("P01", "continued"): ("1 min 30 s",),
        ("P01", "recording missing"): (),
        ("P02", "stopped"): ("the operator left",),
        ("P02", "resumed"): ("1 h 6 min", "trials/t0013.parquet"),
        ("P02", "restarted"): ("block 1", "11 trials"),
        ("P03", "amended"): ("“stable” → “unsure”", "the wrong key"),
        ("P03", "skipped"): ("uniform <i>, B = 0.5 N·m·s/rad",),
        ("P03", "ended"): ("60 minutes",),
    }
    details = {(code, what): detail for code, what, detail in listed}
    assert [(code, what) for code, what, _ in listed] == list(holds)
    for key, parts in holds.items():
        assert all(part in details[key] for part in parts), details[key]
    assert not any("  " in detail or detail.endswith(".") for detail in details.values())
    useless = invalid_trials(found.study)
    assert len(useless) == sum(trial.void == "invalid" for trial in found.trials) + sum(
        trial.automatic == "invalid" and trial.void in ("redone", "restarted") for trial in found.trials
    )
    text = ParsedPage(page).text
    for one in (*deviations(found.study), *useless, *notes(found.study)):
        assert one.detail in text


def test_methods_have_every_number_of_protocol_experiment_and_result_and_no_key_of_ours(found: Any) -> None:
    paragraphs = {paragraph.heading: paragraph.text for paragraph in methods(found)}
    study, counts = found.study, found.counts()
    x = effective(found)["uniform <i>"]
    limits, judged = x.rig.limits, x.verdict
    parts = {
        "Participants": ["Three participants", "3 planned", "2 completed"],
        "Apparatus": [f"{x.rig.encoder.resolution:.4g}", f"{limits.effort:g} N·m"],
        "Conditions": ["20 kHz", "2 kHz", "200 Hz", "2 N", "0 and 0.5 N·m·s/rad"],
        "Task": [f"{x.homing.speed:g} rad/s", "K = 100 N·m/rad", study.protocol.trial.say],
        "Automatic verdict": [
            f"{judged.felt_velocity:g} m/s",
            f"{judged.heard_force:g} N",
            f"{judged.moved:g} m",
        ],
        "Search": ["41 stiffnesses from 100 to 900 N·m/rad, 20 N·m/rad apart", "2 reversals", "40 verdicts"],
        "Order and blinding": ["seed 7", "3 of the 4 rows", "row 2: 1 participant", "not balanced"],
        "Safety and rests": [f"{limits.speed:g} rad/s", OSCILLATIONS, f"{1000 * limits.oscillation_s:g} ms"],
        "Limits": [
            f"Of {counts['recorded']} recorded trials {counts['counted']}",
            *(f"{n} {name}" for name, n in counts.items() if name not in ("recorded", "counted")),
        ],
        "Comparisons": [
            f"{next(one.runs for one in found.mixed if one.measure == 'rule')} runs",
            "2 degrees of freedom",
        ],
        "Psychometric functions and agreement": [
            ", ".join(f"{100 * rate:g}" for rate in LAPSE_RATES[:-1]) + f" and {100 * LAPSE_RATES[-1]:g} %"
        ],
        "Software": ["haptic-rig 0.1.0"],
    }
    assert list(paragraphs) == list(parts)
    for heading, some in parts.items():
        for part in some:
            assert str(part) in paragraphs[heading], (heading, part)
    whole = " ".join(paragraphs.values())
    assert {"in skipped searches", "in unfinished searches", "practice", "redone", "restarted"} <= set(counts)
    assert not re.search(r"\bnan\b|None|\{|\}|  |\.\.| [.,;:)]|\( ", whole)
    keys = set(parameters())
    for section, values in make_protocol().items():
        keys |= {
            f"{section}.{key}" for one in (values if isinstance(values, list) else [values]) for key in one
        }
    assert not [key for key in keys if re.search(rf"\b{re.escape(key)}\b", whole)]


@pytest.mark.parametrize(
    ("rule", "settings", "words"),
    [
        ("ascending", {"repeats": 4}, "Each of 4 ascending series began at the softest level"),
        ("staircase", {"stable_to_rise": 2, "start": 400.0}, "at 400 N·m/rad: 2 stable verdicts in a row"),
        ("interleaved", {}, "20 % of the trials were catch trials"),
        ("psi", {"hits": 30, "enough": 0.05}, "for 30 verdicts, or until K50 was known within 5 %"),
        ("grid", {"repeats": 1}, "Every level was presented 1 time, in a new random order"),
    ],
)
def test_each_rule_is_described_with_the_settings_in_force(
    rule: str, settings: Any, words: str, tmp_path: Path
) -> None:
    search = {"rule": rule, "settings": settings, "lowest": 200.0, "highest": 800.0}
    ways = {"step": None, "ratio": 1.1} if rule == "psi" else {"step": 100.0, "catch_share": 0.2}
    mapping = protocol(search=search | ways)
    with without_sync(), sitting(tmp_path / "P01", mapping, person()) as one:
        one.run(2)
    (text,) = [p.text for p in methods(analyse([tmp_path])) if p.heading == "Search"]
    assert words in text
    assert ("catch trials" in text) == (rule != "psi")
    assert ("each 1.1 times the one before" if rule == "psi" else "100 N·m/rad apart") in text


def test_pictures_are_drawn_with_units_in_their_labels(
    found: Any, alone: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(style, "DPI", 30)
    # The layout engine would draw everything once more.
    monkeypatch.setattr("matplotlib.figure.Figure.get_layout_engine", lambda _: None)
    drawn = draw_study(alone, tmp_path, ("png",))
    expected = {"zwidth", "psychometric", "agreement", "effects"}
    assert {path.stem for path in drawn.values()} == set(pictures(alone)) == {*expected, tracks_name("P01")}
    assert set(pictures(found)) == expected | {tracks_name(f"P0{n}") for n in (1, 2, 3)}
    for path in drawn.values():
        image = matplotlib.image.imread(path)
        assert image.shape[0] > 80
        assert image[..., :3].std() > 0.02  # something is there
    for name, draw in pictures(found).items():
        if name in ("zwidth", "psychometric"):
            axes = draw(found).axes
            assert "N·m/rad" in axes[0].get_ylabel() + axes[-1].get_xlabel()


def one_person(where: Path, trials: int = 10_000, *, invalid: float = 0.0, repeats: int = 1) -> Any:
    mapping = protocol(
        search={"step": 50.0, "settings": {"turns": 2, "most": 10}},
        order={"repeats": repeats},
        condition=[{"name": "dual", "scheme": "dual:20k/2k"}],
    )
    with without_sync(), sitting(where / "P01", mapping, person(invalid=invalid)) as one:
        one.run(trials)
    return analyse([where])


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return one_person(tmp_path_factory.mktemp("alone"))


@pytest.mark.parametrize("trials", [0, 1])
def test_a_session_that_has_hardly_begun_has_a_page(trials: int, tmp_path: Path) -> None:
    with without_sync(), sitting(tmp_path / "P01", make_protocol(), person()) as one:
        one.run(trials)
    found = analyse([tmp_path], AnalysisOptions(measure="K50 person"))
    read = ParsedPage(render(found, {}))
    assert "no limit" in read.text.lower()
    for draw in pictures(found).values():
        figure = draw(found)
        figure.get_layout_engine().execute(figure)


def test_a_study_beyond_the_levels_has_bounds_and_no_tests(tmp_path: Path) -> None:
    """Every wall of one condition is stable for five people: no interval, even if all ends of the levels are equal."""
    mapping = protocol(
        search={"highest": 450.0, "step": 50.0, "settings": {"turns": 2, "most": 30}}, order={"repeats": 1}
    )
    people = {
        f"P0{n}": Person(
            threshold=lambda condition, _, n=n: 900.0 if condition == "dual" else 250.0 + 20.0 * n
        )
        for n in range(1, 6)
    }
    write_study(tmp_path, mapping, people)
    found = analyse([tmp_path])
    ((one, _),) = summarise_differences(found)
    assert (one.bound, one.beyond.count, one.beyond.limits, math.isnan(one.p)) == ("least", 5, 10, True)
    text = ParsedPage(render(found, {})).flat_text
    assert re.search(r"dual − uniform, at B = 0: ≥ \+\d\S* N·m/rad with 5 of 10 limits censored", text)
    assert "p (Holm) =" not in text
    assert "5 above of 5" in text
    assert "≥ " in text
    assert "No model for censored values (Tobit) was used" in text


def test_where_the_mean_over_dampings_is_a_bound_the_summary_has_each_damping(found: Any) -> None:
    """One damping beyond the levels invalidates the difference over all dampings, not those of the others."""
    rule = [one for one in found.paired if one.measure == "rule"]
    assert [one.damping for one in rule] == [0.0, 0.5, None]

    def dampings(paired: Any) -> Any:
        return [
            one.damping for one, _ in summarise_differences(replace(found, paired=tuple(paired), mixed=()))
        ]

    nothing = dict.fromkeys(("low", "high", "p", "holm"), math.nan)
    assert dampings(rule) == [None]
    withheld = [rule[0], *(replace(one, withheld=True, **nothing) for one in rule[1:])]
    assert dampings(withheld) == [0.0, 0.5, None]


@pytest.mark.parametrize(
    ("people", "sentence"),
    first_by_default(
        [
            (2, "Each row was that of 1 participant, so the order was balanced over them"),
            (1, "1 of the 2 rows was used (row 0: 1 participant), so the order was not balanced"),
            (3, "All 2 rows were used, but not equally often (row 0: 2 participants, row 1: 1 participant)"),
        ]
    ),
)
def test_an_order_is_balanced_where_each_row_is_there_equally_often(
    people: int, sentence: str, tmp_path: Path
) -> None:
    sessions = {f"P0{n}": person() for n in range(1, people + 1)}
    write_study(tmp_path, protocol(order={"repeats": 1}, search={"step": 200.0}), sessions)
    texts = {paragraph.heading: paragraph.text for paragraph in methods(analyse([tmp_path]))}
    assert sentence in texts["Order and blinding"]


def apparatus(found: Any) -> str:
    return next(paragraph.text for paragraph in methods(found) if paragraph.heading == "Apparatus")


def test_the_damping_of_a_voltage_drive_is_reported(found: Any, tmp_path: Path) -> None:
    changes = {"rig.amplifier.drive": "voltage", "operator.press": 2.0}
    write_study(tmp_path, protocol(study={"changes": changes}, search={"step": 200.0}), {"P01": person()})
    assert "back-EMF damped the handle by 0.0253 N·m·s/rad" in apparatus(analyse([tmp_path]))
    assert "back-EMF" not in apparatus(found)


def test_measured_values_in_reasons_have_units(found: Any) -> None:
    text = _with_units(found.study.sessions[0], "heard 0.113 above 0.1; felt 2e-05 above 1e-05; it moved")
    assert text == "heard 0.113 above 0.1 N·m; felt 2e-05 above 1e-05 rad/s; it moved"


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (400.0, math.inf, "400 … ∞"),
        (0.0, 500.0, "0 … 500"),
        (0.0, math.inf, "–"),
        (400.0, math.nan, "–"),
    ],
)
def test_an_interval_that_is_open_on_a_side_says_its_end(low: Any, high: Any, text: str) -> None:
    assert interval(low, high) == text


def test_the_command_writes_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mapping = protocol(search={"settings": {"turns": 2, "most": 4}, "step": 100.0}, order={"repeats": 1})
    with without_sync(), sitting(tmp_path / "P01", mapping, person()) as one:
        one.run()
    png = tmp_path / "zwidth.png"
    png.write_bytes(b"made up")
    asked: list[Any] = []

    def draws(found: Any, place: Path, endings: Any, **_: Any) -> dict[str, Path]:
        asked.append(endings)
        return {png.name: png}

    monkeypatch.setattr(cli_report, "draw_study", draws)
    words = ["session", "analyse", str(tmp_path), "--json", "-o", str(tmp_path / "out"), "--format", "pdf"]
    result = CliRunner().invoke(rig, words)
    assert result.exit_code == 0, result.output
    assert asked == [("png", "pdf")]
    answer = json.loads(result.stdout)
    assert answer["report"] == str(tmp_path / "out" / PAGE)
    assert answer["pictures"] == {"zwidth.png": str(png)}
    assert "data:image/png;base64,bWFkZSB1cA==" in (tmp_path / "out" / PAGE).read_text(encoding="utf-8")
