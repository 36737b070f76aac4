"""Reproductions: text comes from templates and numbers from results; a page is complete, self-contained and safe."""

import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from jinja2 import UndefinedError

import rig.cli
from rig.experiments.sweep import Task
from rig.extras.papers import reproduction
from rig.extras.papers.chawda.reproduction import CHAWDA
from rig.extras.papers.claims import read_claims
from rig.extras.papers.cli import PAPERS
from rig.extras.papers.koul.reproduction import KOUL
from rig.extras.papers.parts import Part, Parts
from rig.extras.papers.reproduction import Paper, Reproduction, draw_into, render, write_report
from rig.extras.papers.rules import ClaimStatus, Ruling
from rig.views.report import _template as template
from rig.views.report import _writing as writing
from tests.conformance.pages import ParsedPage
from tests.conformance.sweep_work import raise_as_given

NASTY = "</script><script>alert('K < B & \"C\"')</script>"
PNG = b"\x89PNG\r\n\x1a\nnot a picture"
CLAIMS = """[paper]
title: A paper
source: someone
{% for key in rulings if key != "c7" %}
[{{ key }}]
claim: claim {{ key }} {{ nasty }}
paper: 560
ours: {{ rulings[key].ours|n }}
{% if key == "c1" %}
only with: luck,
and nothing else
{% endif %}
in part: its size
needs: nothing
rule: a rule
{% endfor %}
"""
PAGE = """{% extends "extras/papers/page.html.j2" %}
{% from "extras/papers/macros.html.j2" import section, picture, table, row, conditions with context %}
{% block summary %}<p>a summary</p>{% endblock %}
{% block body %}
{% call section("figure-5", "Fig. 5 & more") %}
<p>{{ nasty }}</p>
{{ picture("drawn", "a picture") }}
{{ picture("failed", nasty) }}
{% call table("counts", ["a", nasty]) %}
{{ row("x", nasty, [1.0, none]) }}
{% endcall %}
{% call conditions() %}<li>by hand</li>{% endcall %}
{% endcall %}
{% endblock %}
"""


@pytest.fixture
def templates(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Three templates of a made-up paper, beside the real ones."""
    made_up = {
        "extras/papers/made-up/claims.j2": CLAIMS,
        "extras/papers/made-up/page.html.j2": PAGE,
        "extras/papers/made-up/blank.j2": "The ratio is {{ ratio }}.",
    }
    real = template._text
    template._environment.cache_clear()
    monkeypatch.setattr(template, "_text", lambda name: made_up.get(name) or real(name))
    yield
    template._environment.cache_clear()


def paper(**words: Any) -> Paper:
    return Paper(
        name="made-up",
        quick=None,
        full=None,
        plan=lambda _: pytest.fail("nothing is computed"),
        rulings=lambda _: {
            f"c{number}": Ruling(status=status, cases={"a": True}, numbers={"ours": 1.5})
            for number, status in enumerate(ClaimStatus)
        },
        words=lambda _: {"nasty": NASTY, **words},
        numbers=lambda _: {"a": float("nan"), "b": [1.5, NASTY]},
        provenance=lambda _: {"seed": 0, "version": "1"},
        pictures={},
    )


def made_up() -> Reproduction:
    made = paper()
    head, claims = read_claims(made.template(reproduction.CLAIMS), made.rulings(None), made.words(None))
    given: Any = {"numbers": made.numbers(None), "provenance": made.provenance(None), "seconds": 1.25}
    return Reproduction(paper=made, title=head["title"], source=head["source"], claims=claims, **given)


# --- claims ----------------------------------------------------------------------------------------------------


def test_a_claim_has_the_words_of_its_template_and_the_verdict_of_its_rule(templates: None) -> None:
    claims = made_up().claims
    assert [claim.verdict for claim in claims] == [
        "reproduced", "reproduced only with luck, and nothing else", "reproduced in part: its size",
        "follows from the method", "undecided", "not reproduced",
    ]  # fmt: skip
    assert (claims[0].ours, claims[0].claim) == ("1.50", f"claim c0 {NASTY}")


def test_a_missing_value_is_an_error_and_no_blank(templates: None) -> None:
    assert template.fill_text("extras/papers/made-up/blank.j2", ratio=2) == "The ratio is 2."
    with pytest.raises(UndefinedError, match="ratio"):
        template.fill_text("extras/papers/made-up/blank.j2")


def test_a_ruling_without_words_and_words_without_a_number_are_errors(templates: None) -> None:
    made = paper()
    name, words = made.template(reproduction.CLAIMS), made.words(None)
    nothing = Ruling(status=ClaimStatus.NOT, cases={}, numbers={})
    with pytest.raises(UndefinedError, match="ours"):
        read_claims(name, {"c0": nothing}, words)
    with pytest.raises(KeyError, match="c7"):
        read_claims(name, {"c7": Ruling(status=ClaimStatus.NOT, cases={}, numbers={"ours": 1.0})}, words)


# --- what stands in templates ----------------------------------------------------------------------------------------

ROOM = Path(reproduction.__file__).parent
# Names of figures, rates and quantities, and statements of a paper itself: no result is among them.
CONSTANTS = (
    "Fig. 8a and 8b together", "Fig. 8a", "Fig. 8b", "Figs. 3 and 7", "Figs. 7 and 8", "Fig. 1", "Fig. 3", "Fig. 4",
    "Fig. 5", "Fig. 6", "Fig. 7", "Fig. 8", "equations (10) and (14)", "2013", "50 kHz", "20 kHz",
    "10 kHz", "2 kHz", "1 kHz", "200 Hz", "1 Hz", "from 20 to", "fs/", "20k/2k", "0 < B", "B > 0", "B = 0", "K = 0",
    "5 kHz", "5 %", "of Chawda et al. 2011",
    "T1/2", "1/T1", "T1", "T2", "μ1", "μ2", "×4", "× 4", "10⁴", "±90°", "2b/T", "2π", "b²", ")²", "m/s²", "g·m²",
    "1.17·α·T", "70 g", "1 µm", "α = 6.6", "λ = 2.45", "1.1·C", "C = 6", "10 ms", "1 ms", "30 Hz", "100 %",
)  # fmt: skip
# What other studies of this project found, of which a reproduction computes nothing.
KNOWN = ("0.1 m/s and 34 Hz", "1.5 to 2 g·m²", "2 to 3 kN·m/rad", "0.8 g·m²")


KEY = re.compile(r'"(u2|u20|u20/1k|(figure|table)-.*|extras/papers/.*)"')  # keys in expressions


def names() -> list[str]:
    return sorted(f"extras/papers/{path.relative_to(ROOM)}" for path in ROOM.rglob("*.j2"))


@pytest.mark.parametrize("name", names())
def test_no_number_in_the_words_of_a_template_is_a_result(name: str) -> None:
    """The digits in a template's own text are names or constants of the paper, each listed here."""
    found = []
    for line, kind, text in template._environment(html=True).lex(template._text(name)):
        words = re.sub(r"<[^>]*>|%\.\df", " ", text) if kind in ("data", "string") else ""
        for known in (*KNOWN, *CONSTANTS):
            words = words.replace(known, " ")
        if re.search(r"\d", words) and not KEY.fullmatch(text):
            found.append((line, words.strip()))
    assert found == []


def test_numbers_have_three_digits_and_what_is_no_number_a_sign() -> None:
    values = (0.0, 9.996, 560.4, 0.04567, None, math.nan, math.inf)
    assert [writing.three(value) for value in values] == ["0", "10.00", "560", "0.0457", "–", "–", "∞"]
    assert (writing.limit(560.4, True), writing.limit(560.4, False)) == ("≥ 560", "560"), (
        "a search that ended"
    )


# --- pages -----------------------------------------------------------------------------------------------------------


def test_a_page_has_every_section_and_verdict_and_needs_nothing_from_elsewhere(templates: None) -> None:
    page = ParsedPage(render(made_up(), {"drawn": PNG}))
    assert {"claims", "figure-5", "provenance", "numbers"} <= set(page.ids)
    assert "#figure-5" in page.sources  # the navigation contains it
    text = page.text
    for verdict in ("reproduced", "reproduced only with luck", "not reproduced"):
        assert verdict in text
    assert "(no picture)" in text  # of the one that failed
    assert all(source.startswith(("data:image/png;base64,", "#")) for source in page.sources)


def test_text_is_escaped_wherever_it_stands(templates: None) -> None:
    page = render(made_up(), {})
    assert NASTY not in page
    assert ParsedPage(page).scripts == 1
    assert "alert" in page


def test_numbers_are_attached_as_json_that_any_reader_takes(templates: None, tmp_path: Path) -> None:
    made = made_up()
    html, numbers = write_report(made, tmp_path)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    alone = json.loads(numbers.read_text(encoding="utf-8"), parse_constant=refuse)
    attached = ParsedPage(html.read_text(encoding="utf-8")).numbers
    assert json.loads(attached, parse_constant=refuse) == alone
    assert alone["numbers"] == {"a": None, "b": [1.5, NASTY]}
    assert [claim["verdict"] for claim in alone["claims"]] == [claim.verdict for claim in made.claims]


def test_pictures_lie_beside_the_report_by_paper_and_name(templates: None, tmp_path: Path) -> None:
    drawn = {name: lambda _, path: path.write_bytes(PNG) for name in ("one", "two")}
    made = replace(made_up(), paper=replace(paper(), pictures=drawn))
    assert draw_into(made, tmp_path, "svg") == {name: tmp_path / f"made-up-{name}.svg" for name in drawn}
    assert {path.name for path in tmp_path.iterdir()} == {"made-up-one.svg", "made-up-two.svg"}


class Sums:
    """A reproduction plan of three tasks."""

    def parts(self) -> dict[str, Part]:
        return {"sums": [Task(str(n), raise_as_given, {"number": n}, 1.0) for n in range(3)]}

    def results(self, done: Parts) -> int:
        return sum(done.results["sums"])


def test_the_command_writes_one_report_and_resumes_from_its_journal(
    templates: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    known = replace(
        paper(),
        quick=SimpleNamespace(name="quick"),
        plan=lambda _: Sums(),
        numbers=lambda found: {"sum": found},
        pictures={"drawn": lambda _, path: path.write_bytes(PNG), "failed": lambda _, path: 1 / 0},
    )
    monkeypatch.setitem(PAPERS, "koul", known)
    command = ["reproduce", "koul", "--quick", "--json", "--workers", "1", "-o", str(tmp_path)]
    results = []
    for kept in (0, 3):
        assert rig.cli.run(command) == 0
        out, err = capfd.readouterr()
        results.append(json.loads(out))
        assert (results[-1]["kept"], results[-1]["numbers"]) == (kept, {"sum": 3})
        assert "no picture" in err
    assert results[0]["claims"] == results[1]["claims"]
    page = ParsedPage(Path(results[0]["report"]).read_text(encoding="utf-8"))
    assert "figure-5" in page.ids
    assert sum(source.startswith("data:image/png;base64,") for source in page.sources) == 1
    assert rig.cli.run([*command[:3], "-o", str(tmp_path)]) == 0
    printed = capfd.readouterr().out
    assert all(claim["claim"] in printed for claim in results[0]["claims"])


@pytest.mark.exhaustive("::test_the_command_writes_one_report_and_resumes_from_its_journal")
@pytest.mark.parametrize("paper", [KOUL, CHAWDA], ids=lambda paper: paper.name)
def test_every_scale_plans_every_part_once_and_in_plain_data(paper: Paper) -> None:
    quick, full = (paper.plan(scale).parts() for scale in (paper.quick, paper.full))
    names, all_names = ({name.partition("/")[0] for name in parts} for parts in (quick, full))
    assert names == all_names  # nothing is left out when it is quick
    for part in quick.values():
        assert len({task.key for task in part}) == len(part)
        json.dumps([task.payload for task in part], allow_nan=False)


# --- whole reproductions by the command ------------------------------------------------------------------------------

SECTIONS = {
    "koul": (
        "figure-5", "figure-6-koul-compliant", "figure-6-koul-rigid", "hands", "ways", "figure-7", "figure-8", "theory",
        "effects", "plants", "ideas",
    ),
    "chawda": (
        "figure-1", "figure-3", "hits", "figure-4", "figure-5", "figure-6", "figure-7", "table-1", "readings", "theory",
        "variants", "dual",
    ),
}  # fmt: skip
# Still coarser than `--quick`.
SCALES = {
    "koul": replace(KOUL.quick, ratio=2.0, range_ratio=2.0, idea_ratio=3.0, plants=2, state_bits=(4, 16)),
    "chawda": replace(CHAWDA.quick, dampings=(0.0, 60.0, 700.0), hit_dampings=(0.0, 100.0, 400.0, 800.0),
                      dual_dampings=(0.0,), coarse=4),
}  # fmt: skip
PICTURES = {"koul": 12, "chawda": 11}
# Facts of the reproductions that no grid is too coarse for (patterns).
VERDICTS = {
    "koul": {
        "rises": "reproduced",
        "noisier": "reproduced",
        "same-range-plants": "follows from the method",
        "levels-off": "reproduced only with the electrical lag",
        "penetration": "reproduced only with fixed point",
    },
    "chawda": {
        "levant-limited": "reproduced in part: the direction, by a factor of .*",
        **dict.fromkeys(("regions", "filter-holds", "control-undamped", "control-bare"), "reproduced"),
        **dict.fromkeys(("order", "levant-stiffest", "both", "widths"), "not reproduced"),
    },
}


@pytest.mark.usefixtures("coarse")
@pytest.mark.timeout(300)  # compiles everything when it is cold
@pytest.mark.exhaustive("::test_the_command_writes_one_report_and_resumes_from_its_journal")
@pytest.mark.parametrize("paper", SECTIONS)
def test_quick_reproduces_a_paper_in_one_report(
    paper: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PAPERS, paper, replace(PAPERS[paper], quick=SCALES[paper]))
    # Two workers that share an interpreter cost a tenth more, and other tests need the other core.
    command = ["reproduce", paper, "--quick", "--json", "--workers", "1", "-o", str(tmp_path)]
    assert rig.cli.run(command) == 0
    out, err = capfd.readouterr()
    assert "Traceback" not in err
    found = json.loads(out)
    by_key = {claim["key"]: claim["verdict"] for claim in found["claims"]}
    assert all(verdict.startswith(tuple(ClaimStatus)) for verdict in by_key.values())
    for key, verdict in VERDICTS[paper].items():
        assert re.fullmatch(verdict, by_key[key]), key
    page = (tmp_path / f"{paper}.html").read_text(encoding="utf-8")
    for section in SECTIONS[paper]:
        assert f'id="{section}"' in page
    assert page.count("data:image/png;base64,") == PICTURES[paper]
    assert "(no picture)" not in page


@pytest.mark.exhaustive(
    "tests/extras/papers/test_koul.py::test_few_bits_of_state_take_the_damping_from_a_uniform_wall_alone"
)
def test_figures_7_and_8_of_koul_alone(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert rig.cli.run(["reproduce", "koul", "--impacts", "--plot", "-o", "figures"]) == 0
    printed = capfd.readouterr().out
    assert all(words in printed for words in ("57.00 (57…57)", "39.75 (35…45)", "29.00 (29…29)", "figure 8"))
    assert {p.name for p in (tmp_path / "figures").iterdir()} == {"koul-figure-7.png", "koul-figure-8.png"}
    assert rig.cli.run(["reproduce", "koul", "--impacts", "--json"]) == 0
    assert {"figure_7", "word_lengths", "figure_8"} <= set(json.loads(capfd.readouterr().out))
