"""A protocol file is either a valid protocol, or one error that lists everything wrong with it."""

import json
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.config._files import parse_toml
from rig.config._table import parameters_of
from rig.core.errors import ConfigError, RecordingError
from rig.session.planning._conditions import Walls, base_of
from rig.session.planning._load import (
    as_mapping,
    check_code,
    json_schema,
    load_protocol,
    protocol_from_mapping,
)
from rig.session.planning._protocol import Protocol
from rig.session.planning._template_files import SCHEMA, template_names, write_template
from tests.conformance.tiers import first_by_default

TEXT = """
[study]
title = "Two schemes"
preset = "koul-compliant"
changes."operator.press" = 1.5
changes."trial.minimum_rest_counts" = 1.0

[[condition]]
name = "uniform"
scheme = "uniform:20k"

[[condition]]
name = "dual"
scheme = "dual:20k/2k"
damping = [0.0, 0.1]

[search]
lowest = 100
highest = 600
step = 25
"""
TABLE = parse_toml(TEXT, "study.toml")


def write_protocol(folder: Path, text: str = TEXT) -> Path:
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return path


def change(changes: dict[str, Any]) -> dict[str, Any]:
    """Return the table with some keys changed; `condition.0.name` is a key of the first item in a list."""
    return _changed(json.loads(json.dumps(TABLE)), changes)


def _changed(table: Any, changes: dict[str, Any]) -> Any:
    for key, value in changes.items():
        node, *path = table, *key.split(".")
        for part in path[:-1]:
            node = node[int(part)] if part.isdecimal() else node.setdefault(part, {})
        node[path[-1]] = value
    return table


def refusal(changes: dict[str, Any]) -> str:
    with pytest.raises(ConfigError) as caught:
        protocol_from_mapping(change(changes), "study.toml")
    return str(caught.value)


def refusal_of_file(folder: Path, changes: dict[str, Any]) -> str:
    with pytest.raises(ConfigError) as caught:
        load_protocol(write_protocol(folder, toml(change(changes))))
    return str(caught.value)


def toml(table: dict[str, Any]) -> str:
    """Return a table as TOML, one key a line, with inline tables written almost as JSON."""

    def value(one: Any) -> str:
        if isinstance(one, dict):
            return "{" + ", ".join(f"{json.dumps(k)} = {value(v)}" for k, v in one.items()) + "}"
        if isinstance(one, list):
            return "[" + ", ".join(map(value, one)) + "]"
        return json.dumps(one)

    return "\n".join(f"{key} = {value(one)}" for key, one in table.items())


# What is right


def test_a_file_is_a_protocol_with_defaults_for_what_it_leaves_out(tmp_path: Path) -> None:
    protocol = load_protocol(write_protocol(tmp_path))
    assert [one.name for one in protocol.condition] == ["uniform", "dual"]
    assert protocol.condition[1].damping == (0.0, 0.1)
    assert protocol.search.lowest == 100.0
    assert (protocol.order.kind, protocol.study.blind, protocol.rest.every) == ("latin-square", "both", 0)
    assert protocol.search_of(protocol.condition_named("dual")) is protocol.search


def test_changes_are_dotted_keys_with_or_without_quotes(tmp_path: Path) -> None:
    quoted = load_protocol(write_protocol(tmp_path))
    bare = TEXT.replace('changes."operator.press"', "changes.operator.press")
    assert load_protocol(write_protocol(tmp_path, bare)) == quoted
    assert quoted.study.changes["operator.press"] == 1.5


def test_an_experiment_file_lies_beside_the_protocol(tmp_path: Path) -> None:
    (tmp_path / "rigs").mkdir()
    (tmp_path / "rigs" / "mine.toml").write_text('preset = "koul-compliant"\n[trial]\nduration_s = 1.2\n')
    text = TEXT.replace('preset = "koul-compliant"', 'experiment = "rigs/mine.toml"')
    protocol = load_protocol(write_protocol(tmp_path, text))
    base = base_of(protocol, tmp_path)
    assert Walls(protocol, base).at(protocol.condition[0], 0.0, 200.0).trial.duration_s == 1.2


def test_a_condition_becomes_an_experiment_with_all_its_settings(tmp_path: Path) -> None:
    own = {
        "trial": {"duration_s": 0.9},
        "caps": {"effort": 0.25, "speed": 5.0, "energy": 0.5},
        "condition.1.changes": {"controller.friction_compensation": 0.5, "rig.encoder.ratio": 20.0},
        "condition.1.fit": "the other encoder",
        "order.blocks": "condition",
    }
    protocol = load_protocol(write_protocol(tmp_path, toml(change(own))))
    base = base_of(protocol, tmp_path)
    x = Walls(protocol, base).at(protocol.condition[1], 0.1, 225.0, seed=9)
    assert (x.wall.stiffness, x.wall.damping, x.trial.seed, x.trial.repeats) == (225.0, 0.1, 9, 1)
    assert (x.controller.position_rate, x.controller.velocity_rate) == (20000, 2000)
    assert (x.controller.friction_compensation, x.rig.encoder.ratio) == (0.5, 20.0)
    assert (x.trial.kind, x.trial.duration_s) == ("human", 0.9)
    assert (x.rig.limits.effort, x.rig.limits.speed, x.rig.limits.energy) == (0.25, 5.0, 0.5)


def test_a_person_meets_no_more_than_nominal_effort_unless_the_study_overrides_it(tmp_path: Path) -> None:
    protocol = load_protocol(write_protocol(tmp_path))
    base = base_of(protocol, tmp_path)
    assert base.rig.limits.effort == 1.3
    held = Walls(protocol, base).at(protocol.condition[0], 0.0, 200.0)
    assert (held.rig.limits.human, held.rig.limits.effort) == (True, 0.286)
    answers = {"rig.limits.override_stall": True, "rig.limits.effort": 1.0}
    protocol = load_protocol(write_protocol(tmp_path, toml(change({"study.changes": answers}))))
    assert Walls(protocol, base).at(protocol.condition[0], 0.0, 200.0).rig.limits.effort == 1.0
    stall = "[rig.limits]\noverride_stall = true\nhuman = true\n"
    (tmp_path / "mine.toml").write_text(f'preset = "koul-compliant"\n{stall}')
    own = load_protocol(
        write_protocol(tmp_path, TEXT.replace('preset = "koul-compliant"', 'experiment = "mine.toml"'))
    )
    allowed = Walls(own, base_of(own, tmp_path)).at(own.condition[0], 0.0, 200.0)
    assert allowed.rig.limits.effort == 1.3
    motor = {"trial": {"kind": "constant-effort"}, "study.changes": {"trial.effort": 0.4}}
    protocol = load_protocol(write_protocol(tmp_path, toml(change(motor))))
    assert Walls(protocol, base).at(protocol.condition[0], 0.0, 200.0).rig.limits.effort == 1.3


# What is wrong


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"study.titel": "x"}, "study.titel: is not a known key; did you mean title?"),
        ({"study.blind": "everybody"}, 'must be one of "both", "operator", "participant", "none"'),
        ({"study.participants": 0}, "≥ 1 and ≤ 10000"),
        ({"study.participants": 12.0}, "write a whole number in this range"),
        ({"study.experiment": "rig.toml"}, "only one of the two may name the rig"),
        (
            {"study.changes": {"wall.side": [1]}},
            "wall.side = [1]: must be a finite number, text",
        ),
        ({"condition": []}, "[[condition]]: is missing"),
        ({"condition": {"name": "x"}}, "write [[condition]]"),
        ({"condition.1.name": "Uniform"}, "is used more than once"),
        ({"condition.1.damping": []}, "a list of numbers in N·m·s/rad or N·s/m, at least one"),
        ({"condition.1.damping": [0.0, "x"]}, 'condition 2.damping = [0.0, "x"]'),
        ({"condition.1.damping": [0.1, 0.1]}, "more than once"),
        ({"condition.1.damping": [0.1, -0.1]}, "must not contain a damping below 0"),
        ({"condition.0.scheme": "dual:20k"}, "sampling has two, for position and velocity"),
        (
            {"condition.1.search": {"lowest": 9, "highest": 5, "step": 1}},
            "below condition 2.search.highest, 5",
        ),
        ({"search.lowest": 0}, "search.lowest = 0: must be a number > 0"),
        ({"search.ratio": 1.1}, "only one of the two may give the distance"),
        ({"search.step": 1e-6}, "choose a larger step"),
        ({"search.rule": "stairs"}, "did you mean staircase?"),
        ({"search.settings": {"turn": 3}}, "did you mean turns?"),
        ({"search.settings": {"seed": 3}}, "the seed by study.seed"),
        ({"search.settings": {"levels": [1, 2]}}, "set levels by lowest, highest"),
        ({"search.settings": {"turns": 1}}, "turns = 1 is not a whole number from 2 to 1000"),
        ({"search.settings": {"steps": ["a"]}}, 'steps = ["a"]: must be a list of whole numbers'),
        ({"search.settings": {"start": 5}}, "start = 5 is not one of the levels"),
        ({"order.repeats": 1000, "condition.0.damping": list(range(10))}, "allowed are at most 10000"),
        ({"caps.stiffness": 500}, "search.highest = 600: must be at most caps.stiffness, 500"),
        ({"caps.stiffness": 600, "practice.stiffness": [700]}, "use softer walls for practice"),
        ({"practice.stiffness": [0]}, "must be above 0"),
        ({"practice.condition": "duel"}, "did you mean dual?"),
        (
            {"trial.press": [0.3, 0.1]},
            "[0.3, 0.1]: must be two numbers not below 0, the lower first",
        ),
        (
            {"trial.press": [0.1, 0.3], "trial.kind": "constant-effort"},
            "but the motor hits (trial.kind",
        ),
        ({"study.code": "[A-Z"}, "is not a regular expression"),
        ({"study.code": ".*"}, "names of people"),
        ({"study.code": "[A-Z]{4}"}, "matches 'ANNA'"),
        ({"question": [{"name": "a b", "text": "?"}]}, "it names a column"),
        ({"question": [{"name": "a", "text": "?", "lowest": 7, "highest": 1}]}, "above lowest, 7"),
        ({"question": [{"name": "a", "text": "?", "choices": ["x"]}]}, "is not used by a question"),
        ({"question": [{"name": "a", "text": "?", "kind": "choice"}]}, "two or more different answers"),
        (
            {"question": [{"name": "a", "text": "?", "kind": "choice", "choices": ["2", "1"]}]},
            "the number of another choice",
        ),
        ({"keys.stable": "ab"}, "is not the name of a key"),
        ({"sudy": {}}, "did you mean study?"),
    ],
)
def test_an_error_has_key_range_and_remedy(changes: dict[str, Any], words: str) -> None:
    text = refusal(changes)
    assert text.startswith("study.toml: ")
    assert words in text


def test_all_errors_are_listed_at_once(tmp_path: Path) -> None:
    text = refusal(
        {"study.participants": 0, "order.knd": "fixed", "condition.0.damping": "x", "search.step": None}
    )
    assert len(text.splitlines()) >= 3
    for key in ("study.participants", "order.knd", "condition 1.damping"):
        assert key in text
    with pytest.raises(ConfigError) as caught:
        load_protocol(write_protocol(tmp_path, ""))
    for section in ("[study]", "[condition]", "[search]", "study.preset"):
        assert section in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"study.preset": "koul-complaint"}, "did you mean koul-compliant?"),
        ({"study.changes": {"operator.pres": 1.5}}, "is not a key of an experiment; did you mean press?"),
        ({"study.changes": {"wall.stiffness": 5.0}}, "is set by [search]"),
        ({"condition.0.changes": {"trial.kind": "human"}}, "is set by trial.kind of the protocol"),
        ({"study.changes": {}}, "operator.press"),  # pushes harder than a person's motor may
        ({"condition.0.scheme": "dual:20k/3k"}, 'condition 1, "uniform": cannot be run'),
        ({"condition.0.scheme": "uniform:20k,estimator=kalmann"}, "did you mean kalman?"),
        ({"search.highest": 5000}, "cannot be run at K = 5000 N·m/rad"),
        ({"caps.effort": 3.0}, "must be at most rig.limits.effort of the rig, 1.3 N·m"),
        ({"practice.stiffness": [9000]}, "cannot be run at K = 9000 N·m/rad"),
        (
            {
                "study.changes": {"trial.effort": 0.4},
                "trial.kind": "constant-effort",
                "trial.baseline_s": 0.3,
            },
            'trial.baseline_s = 0.3 s: must be 0 with trial.kind = "constant-effort"',
        ),
        (
            {"trial.press": [0.1, 3.0]},
            "must end at rig.limits.effort at most, 0.286 N·m; lower",
        ),
        (
            {"trial.impact_speed": [1.0, 100.0]},
            "[1.0, 100.0] rad/s: must end at rig.limits.speed",
        ),
        ({"search.lowest": "soft"}, "a number > 0 N·m/rad"),  # the unit of this rig alone
    ],
)
def test_settings_that_the_rig_does_not_allow_are_refused_with_the_file(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    text = refusal_of_file(tmp_path, changes)
    assert "study.toml: " in text
    assert words in text


def test_a_missing_protocol_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: no such file; give the path of a protocol file"):
        load_protocol(tmp_path / "none.toml")


def test_a_missing_or_wrong_experiment_file_is_named(tmp_path: Path) -> None:
    changes = {"study": {"title": "x", "experiment": "mine.toml"}}
    assert "mine.toml: no such file" in refusal_of_file(tmp_path, changes)
    (tmp_path / "mine.toml").write_text('preset = "koul-compliant"\n[wall]\nstifness = 3\n')
    assert "did you mean stiffness?" in refusal_of_file(tmp_path, changes)


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)
KEYS = [key.replace("[]", ".0") for key in parameters_of(Protocol)]


@settings(max_examples=80)
@given(st.dictionaries(st.sampled_from(KEYS), anything, max_size=3))
def test_any_value_of_a_key_is_a_protocol_or_one_typed_error(changes: dict[str, Any]) -> None:
    table = change({"question": [{"name": "tired", "text": "?"}]})
    table["condition"][0]["search"] = {"lowest": 1, "highest": 9, "step": 1}
    try:
        protocol = protocol_from_mapping(_changed(table, changes), "study.toml")
    except ConfigError:
        return
    assert protocol_from_mapping(as_mapping(protocol), "again") == protocol


@settings(max_examples=50)
@given(anything)
def test_any_table_at_all_is_a_protocol_or_one_typed_error(table: Any) -> None:
    with pytest.raises(ConfigError):
        protocol_from_mapping(table, "study.toml")


# Codes


@pytest.mark.parametrize(
    ("pattern", "code"),
    [
        ("P[0-9]{2}", "P01"),
        ("SUB[0-9]{2}", "SUB07"),
        ("(PILOT|MAIN)[0-9]", "PILOT3"),
        ("(?i:pilot)[0-9]", "PILOT3"),
        ("[A-Z]{2}[0-9]{2}", "AS85"),
    ],
)
def test_a_code_of_the_pattern_is_taken(pattern: str, code: str) -> None:
    check_code(protocol_from_mapping(change({"study.code": pattern}), "study.toml"), code)


@pytest.mark.parametrize(
    ("pattern", "code"),
    [
        (r"(?=.*[0-9])[a-zA-Z0-9]{12,14}", "AnnaSchmidt85"),  # no probe is as long
        ("XY-?([a-z]{4}-?)+[0-9]{3}", "XY-anna-smit-001"),
        ("Q[0-9]{5}[a-z]{3,}", "Q00001anna"),
    ],
)
def test_a_pattern_that_allows_names_is_refused(pattern: str, code: str) -> None:
    with pytest.raises(ConfigError, match=r"names of people|looks like a name"):
        check_code(protocol_from_mapping(change({"study.code": pattern}), "study.toml"), code)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("Anna", "looks like a name"),
        ("Anna Schmidt", "spaces"),
        ("anna@lab.org", "e-mail"),
        ("../P01", "parts of a path"),
        (".P01", "parts of a path"),
        ("P01\n", "control characters"),
        ("P" * 40, "1 to 32 characters"),
        ("P1", "does not match the study's pattern P[0-9]{2}"),
    ],
)
def test_a_code_that_identifies_a_person_is_refused(code: str, words: str) -> None:
    with pytest.raises(ConfigError, match="participant code") as caught:
        check_code(protocol_from_mapping(TABLE, "study.toml"), code)
    assert words in str(caught.value)


# Schema and templates


@cache
def editor() -> Any:
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft202012Validator.check_schema(json_schema())
    return jsonschema.Draft202012Validator(json_schema())


@pytest.mark.parametrize("name", first_by_default(template_names()))
def test_an_editor_finds_the_schema_beside_a_new_protocol_and_no_fault_in_it(
    name: str, tmp_path: Path
) -> None:
    path = tmp_path / "study.toml"
    beside = write_template(name, path)
    directive = path.read_text().partition("\n")[0]
    assert beside == tmp_path / directive.removeprefix("#:schema ./")
    schema = json.loads(beside.read_text())
    assert schema == json.loads(json.dumps(json_schema()))
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert list(editor().iter_errors(tomllib.loads(path.read_text()))) == []


@pytest.mark.parametrize(
    ("changes", "place", "reason"),
    [
        ({"study.titel": "x"}, "$.study", "'titel' was unexpected"),
        ({"study.participants": 0}, "$.study.participants", "0 is less than"),
        ({"search.settings": {"turn": 3}}, "$.search.settings", "'turn' was unexpected"),
        ({"search.rule": "psi", "search.settings": {"turns": 3}}, "$.search", "'turns' was unexpected"),
    ],
)
def test_an_editor_underlines_what_is_refused(changes: dict[str, Any], place: str, reason: str) -> None:
    (fault,) = editor().iter_errors(change(changes))
    assert fault.json_path.startswith(place)
    assert reason in fault.message


def test_another_schema_beside_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / SCHEMA).write_text("mine")
    assert write_template("koul-fig6", tmp_path / "study.toml") is None
    assert (tmp_path / SCHEMA).read_text() == "mine"


def test_a_template_overwrites_nothing_and_has_its_name(tmp_path: Path) -> None:
    path = write_protocol(tmp_path)
    with pytest.raises(RecordingError, match="exists") as caught:
        write_template("koul-fig6", path)
    assert "recordings" not in caught.value.remedy
    assert path.read_text() == TEXT
    with pytest.raises(RecordingError):
        write_template("koul-fig6", tmp_path / "nowhere" / "x.toml")
    with pytest.raises(ConfigError, match="unknown template 'koul-fig5'") as unknown:
        write_template("koul-fig5", tmp_path / "other.toml")
    assert "koul-fig6" in str(unknown.value.remedy)
