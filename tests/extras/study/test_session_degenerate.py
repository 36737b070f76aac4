"""Studies with a variance near zero: tables and report are written, and rounding gives no p value."""

import csv
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.extras.study import StudyAnalysis, analyse, write_study_tables
from rig.extras.study.report import render
from tests.conformance.studies import Person, protocol, write_study
from tests.conformance.tiers import first_by_default

LADDER = {"rule": "ascending", "lowest": 50.0, "highest": 200.0, "step": 10.0, "settings": {"repeats": 1}}
RULES: Mapping[str, Mapping[str, Any]] = {
    "ascending": {"repeats": 2},
    "staircase": {"turns": 4},
    "interleaved": {"turns": 4},
    "psi": {"hits": 10},
    "grid": {"repeats": 1},
}


def people(*limits: tuple[float, float], **settings: Any) -> dict[str, Person]:
    return {
        f"P{number:02d}": Person(
            threshold=lambda condition, _, pair=pair: pair[condition == "dual"],
            **{"spread": 0.01, **settings},
        )
        for number, pair in enumerate(limits, 1)
    }


def reported_inferences(found: StudyAnalysis) -> list[float]:
    differences = [*found.paired, *(one for model in found.mixed for one in model.contrasts)]
    values = [value for one in differences for value in (one.low, one.high, one.p, one.holm)]
    return [value for value in values if math.isfinite(value)]


def test_a_residual_at_the_resolution_of_the_levels_gives_no_p_and_no_interval(tmp_path: Path) -> None:
    """Each person's limits are three rungs apart, which shows the ladder's resolution, not how people differ."""
    mapping = protocol(search=LADDER, order={"repeats": 1})
    write_study(tmp_path, mapping, people((85.0, 115.0), (105.0, 135.0), (125.0, 155.0)))
    found = analyse([tmp_path])
    assert reported_inferences(found) == []
    (rule,) = [one for one in found.paired if one.measure == "rule"]
    assert rule.difference == pytest.approx(30.0)
    (model,) = [one for one in found.mixed if one.measure == "rule"]
    assert all("not larger than rounding to levels gives" in one.problem for one in (rule, model))
    page = render(found, {})
    assert "without interval and p value" in page
    assert not re.search(r"p \(Holm\) (=|&lt;)", page)
    write_study_tables(found, tmp_path / "out")
    with open(tmp_path / "out" / "differences.csv", encoding="utf-8") as file:
        assert all(row["p"] == "" and row["problem"] for row in csv.DictReader(file))


# Cases that the next test does not draw.
CASES: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Person]]] = {
    "equal": ({}, people(*[(410.0, 460.0)] * 3)),
    "equal, many": ({"search": {"rule": "psi", "settings": {"hits": 10}}}, people(*[(410.0, 410.0)] * 9)),
    "one condition": (
        {"condition": [{"name": "dual", "scheme": "dual:20k/2k", "damping": [0.0, 0.5]}]},
        people((400.0, 460.0), (420.0, 480.0), (440.0, 470.0)),
    ),
    "judged by the machine": ({"study": {"judge": "automatic"}}, people(*[(410.0, 460.0)] * 3)),
}


@pytest.mark.parametrize("name", first_by_default(CASES))
def test_a_degenerate_study_has_its_tables_and_its_report(name: str, tmp_path: Path) -> None:
    sections, of = CASES[name]
    mapping = protocol(**{"search": {"step": 50.0}, "order": {"repeats": 1}, **sections})
    write_study(tmp_path, mapping, of)
    found = analyse([tmp_path])
    assert len(found.participants) == len(of)
    written = write_study_tables(found, tmp_path / "out")
    assert {"runs.csv", "differences.csv", "tables.json"} <= set(written)
    assert render(found, {})
    if len(of) < 3 or len({one.threshold("dual", 0.0) for one in of.values()}) == 1:
        assert reported_inferences(found) == []


@pytest.mark.exhaustive("::test_a_degenerate_study_has_its_tables_and_its_report")
@settings(max_examples=4, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_any_small_study_has_its_tables_and_its_page(
    data: Any, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Few people with drawn limits, doubts and slips: no interval is empty or has wrong ends."""
    place = tmp_path_factory.mktemp("study")
    rule = data.draw(st.sampled_from(sorted(RULES)), "rule")
    limit = st.sampled_from([1.0, 95.0, 100.0, 105.0, 125.0, 175.0, 1e5])
    count = data.draw(st.integers(1, 4), "people")
    of = people(
        *[(data.draw(limit, "uniform"), data.draw(limit, "dual")) for _ in range(count)],
        spread=data.draw(st.sampled_from([0.01, 10.0]), "spread"),
        unsure=data.draw(st.sampled_from([0.0, 0.3, 1.0]), "unsure"),
        invalid=data.draw(st.sampled_from([0.0, 0.2]), "invalid"),
    )
    mapping = protocol(
        search={**LADDER, "rule": rule, "step": 25.0, "settings": dict(RULES[rule])},
        order={"repeats": data.draw(st.sampled_from([1, 3]), "repeats")},
    )
    write_study(place, mapping, of)
    found = analyse([place])
    write_study_tables(found, place / "out")
    assert render(found, {})
    for one in (*found.paired, *found.over_participants, *found.slopes):
        assert math.isfinite(one.low) == math.isfinite(one.high) == (one.problem == "")
        assert one.low != one.high
        assert one.participants >= 3 or one.problem
