"""An experiment file is either a valid experiment, or one error that lists everything wrong with it."""

import itertools
import json
import math
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.config import (
    Experiment,
    VerdictLimits,
    as_mapping,
    check_plugins,
    describe,
    experiment_from_mapping,
    json_schema,
    load_experiment,
    override,
    presets,
    rig_model,
    verdict_thresholds,
    with_realtime,
)
from rig.config._files import flatten, nest
from rig.config._table import parameters
from rig.core.errors import ConfigError
from tests.conformance.tiers import first_by_default

KOUL = presets.load("koul-compliant")
CHAWDA = presets.load("chawda-linear")


def refusal(changes: dict[str, Any], base: Experiment = KOUL) -> str:
    """Return the text of the error that these changes cause."""
    with pytest.raises(ConfigError) as caught:
        override(base, changes, "hit.toml")
    return str(caught.value)


def written(folder: Path, text: str) -> Path:
    path = folder / "hit.toml"
    path.write_text(text, encoding="utf-8")
    return path


# Files


def test_a_file_has_only_the_differences_from_its_preset(tmp_path: Path) -> None:
    path = written(tmp_path, 'preset = "koul-compliant"\nwall.stiffness = 150\n[trial]\nrepeats = 5\n')
    experiment = load_experiment(path)
    assert experiment == override(KOUL, {"wall.stiffness": 150.0, "trial.repeats": 5})
    assert isinstance(experiment.wall.stiffness, float)  # 150 in the file is a number, not a whole number


def test_a_complete_file_needs_no_preset(tmp_path: Path) -> None:
    path = written(tmp_path, presets.text("chawda-linear"))
    assert load_experiment(str(path)) == CHAWDA


def experiment_or_error(make: Callable[[], Experiment]) -> Experiment | str:
    try:
        return make()
    except ConfigError as error:
        return str(error)


VALUES = (None, -1, 2.0, math.nan, True, "x", "firm", [1.0, 2], {"a": 1})


@pytest.mark.parametrize(("name", "every"), first_by_default([("koul-compliant", 4), ("chawda-linear", 1)]))
def test_a_change_is_equal_to_a_file_on_that_preset_or_refused_alike(name: str, every: int) -> None:
    """A change sets fields of a checked experiment, whereas a file is checked as a whole."""
    base, source = presets.load(name), f"hit.toml (on preset {name})"
    names = parameters().keys() - {"rig.name"}  # a file with a name of its own has a homing servo of its own
    keys = [*sorted(names), "realtime.wall.stiffness", "realtime.nonsense", "rig.limits", "wall.nonsense", ""]
    for key, value in itertools.islice(itertools.product(keys, VALUES), 0, None, every):
        file = {"preset": name, **nest({key: value})}
        expected = experiment_or_error(partial(experiment_from_mapping, file, "hit.toml"))
        found = experiment_or_error(partial(override, base, {key: value}, source))
        assert found == expected, (key, value)


def test_rules_are_checked_also_where_nothing_changes() -> None:
    """An experiment may be built in Python, and must not be armed without the rules."""
    limits = replace(KOUL.rig.limits, effort=100.0)
    with pytest.raises(ConfigError, match=r"rig\.limits\.effort = 100\.0 N·m: must be at most"):
        override(replace(KOUL, rig=replace(KOUL.rig, limits=limits)), {})


def test_a_byte_order_mark_is_no_error(tmp_path: Path) -> None:
    path = tmp_path / "hit.toml"
    path.write_bytes(b'\xef\xbb\xbfpreset = "koul-rigid"\n')
    assert load_experiment(path) == presets.load("koul-rigid")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"[wall]\nstiffness = = 3\n", ("hit.toml", "not valid TOML", "line 2")),
        (b"[wall]\nstiffness = 1\nstiffness = 2\n", ("hit.toml", "not valid TOML", "line 3")),
        (b"a = " + b"[" * 100_000, ("hit.toml", "not valid TOML")),
        (b"a = " + b"1" * 10_000, ("hit.toml", "not valid TOML")),
        (b'preset = "\xff"', ("hit.toml", "UTF-8", "byte 10")),
        ("a = 1\n\u00a0b = 2".encode(), ("line 2", "U+00A0 NO-BREAK SPACE", "retype these characters")),
        ("stiff\u200bness = 2".encode(), ("line 1", "U+200B ZERO WIDTH SPACE")),
        ('stiffness = \u22123  # N·m "°'.encode(), ("line 1, column 13", "contains U+2212 MINUS SIGN;")),
        ("preset = \u201ckoul-rigid\u201d".encode(), ("U+201C LEFT DOUBLE", "U+201D RIGHT DOUBLE")),
        (b"a = 1\0", ("line 1", "U+0000 control character")),
        ("[wall]\nstiffness = = 3  # N·m".encode(), ("correct the file at this line and column",)),
    ],
)
def test_a_file_that_is_not_toml_is_named_with_the_place(tmp_path: Path, content: bytes, words: Any) -> None:
    path = tmp_path / "hit.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        load_experiment(path)
    for word in words:
        assert word in str(caught.value)
    assert caught.value.__cause__ is None


def test_a_missing_file_suggests_its_neighbour(tmp_path: Path) -> None:
    written(tmp_path, "")
    with pytest.raises(ConfigError, match=r"hti\.toml: no such file; did you mean hit\.toml\?"):
        load_experiment(tmp_path / "hti.toml")
    with pytest.raises(ConfigError, match="no such file"):
        load_experiment(tmp_path / "nowhere" / "hit.toml")


@pytest.mark.parametrize("name", ["", "\0.toml"])
def test_a_path_that_cannot_be_read_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_experiment(tmp_path / name)  # a directory; a path that no system takes


def test_a_file_lists_every_section_that_is_missing_and_an_empty_one_is_called_that(tmp_path: Path) -> None:
    """A failed command before ``>`` leaves an empty file."""
    with pytest.raises(ConfigError, match=r"hit\.toml: is empty"):
        load_experiment(written(tmp_path, "# nothing\n"))
    with pytest.raises(ConfigError) as caught:
        load_experiment(written(tmp_path, "verdict.tail_s = 0.4\n"))
    for section in ("rig", "controller", "wall", "homing", "trial"):
        assert f"hit.toml: [{section}]: is missing" in str(caught.value)
    assert "preset = " in str(caught.value)


def test_tables_nested_beyond_reason_are_unknown_keys() -> None:
    deep: dict[str, Any] = {}
    for _ in range(50_000):
        deep = {"a": deep}
    assert "a: is not a known key" in refusal({"a": deep})
    assert "wall.position = a table" in refusal({"wall.position": deep})


# Values


def test_every_problem_is_listed_on_its_own_line_with_file_key_value_range_and_remedy() -> None:
    wrong = {"wall.stiffness": -3.0, "controller.position_rate": 20000.5, "trial.start": "far", "wall.pul": 1}
    text = refusal(wrong)
    assert len(text.splitlines()) == len(wrong)
    for words in (
        "hit.toml: wall.stiffness = -3.0: must be a number ≥ 0 N·m/rad (K); choose a value in",
        "controller.position_rate = 20000.5: must be a whole number ≥ 10 and ≤ 200000 Hz",
        'trial.start = "far": must be a number in rad',
        "wall.pul: is not a known key; did you mean pull?",
    ):
        assert words in text


def test_units_in_messages_follow_the_motion_of_the_rig() -> None:
    assert "N·m/rad" in refusal({"wall.stiffness": -1.0})
    assert "≥ 0 N/m (K)" in refusal({"wall.stiffness": -1.0}, CHAWDA)
    both = refusal({"wall.stiffness": -1.0, "rig.motion": "sideways"})
    assert "≥ 0 N·m/rad or N/m" in both
    assert 'one of "rotary", "linear"' in both


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("wall.stiffness", math.nan, "nan: must be a number ≥ 0 N·m/rad"),
        ("wall.stiffness", math.inf, "inf: must be a number ≥ 0 N·m/rad"),
        ("wall.stiffness", "300", "write a number, without quotes"),
        ("wall.stiffness", {"a": 1}, "a table: must be a number"),
        ("wall.stiffness", 10**5000, "must be a number"),
        ("trial.seed", 10**5000, "must be a whole number"),
        ("trial.repeats", 2.0, "write a whole number in this range"),
        ("trial.repeats", True, "true: must be a whole number ≥ 1"),
        ("wall.side", 0, "0: must be one of -1, 1"),
        ("wall.pull", "clmp", "did you mean clamp?"),
        ("rig.limits.human", 1, "must be true or false"),
        ("rig.limits.human", "yes", "without quotes"),
        ("rig.name", "", "must be text, not empty"),
        ("controller.loop", "devise", "did you mean device?"),
        ("controller.parameters.cutoff_hz", math.nan, "must be a finite number or text"),
        ("controller.parameters", [1], "must be a table with numbers by name"),
        ("controller.command_lifetime_s", 0.03, "≤ 0.02 s"),
        ("rig.encoder.decoding", 4.0, "must be one of 1, 4"),
        ("wall", 3, "3: must be a table with stiffness, damping"),
        ("realtime", {"wall.stiffness": [1]}, "realtime.wall.stiffness"),
        ("realtime", {"wall.stifness": 1}, "did you mean stiffness?"),
        ("realtime", {"wall.stiffness": math.nan}, "realtime.wall.stiffness = nan"),
        ("stiffness", 3, "did you mean wall.stiffness or homing.stiffness?"),
        ("wal.stiffness", 3, "did you mean wall?"),
        ("zzz", 3, "known keys: preset, rig, controller"),
    ],
    ids=itertools.count(),  # some values have too many digits for a name
)
def test_a_wrong_value_is_refused_in_words(key: str, value: Any, words: str) -> None:
    text = refusal({key: value})
    assert text.startswith("hit.toml: ")
    assert key.partition(".")[0] in text
    assert words in text


def test_a_missing_key_is_asked_for_with_its_range() -> None:
    table = as_mapping(KOUL)
    del table["wall"]["stiffness"], table["rig"]["limits"]["speed"]
    with pytest.raises(ConfigError) as caught:
        experiment_from_mapping(table, "hit.toml")
    assert "wall.stiffness: is missing: a number ≥ 0 N·m/rad (K); add stiffness under [wall]" in str(
        caught.value
    )
    assert "rig.limits.speed: is missing" in str(caught.value)


def test_an_error_of_the_physics_keeps_its_place() -> None:
    text = refusal({"rig.mechanics.transmission_stiffness": 0.0})
    assert text.startswith("hit.toml: [rig.mechanics]: a two-mass rig needs transmission_stiffness")
    assert "transmission_stiffness = 0.0" in text
    assert "change these keys together" in text
    for quantum in (1e-6, None):
        lines = 1000 if quantum else None  # both, or none
        text = refusal({"rig.encoder.quantum": quantum, "rig.encoder.counts_per_revolution": lines})
        assert text.startswith(
            "hit.toml: [rig.encoder]: an encoder needs either counts_per_revolution or quantum"
        )
    assert "(given: quantum = 0.0)" in refusal({"rig.encoder.quantum": 0.0}, CHAWDA)


def test_values_that_overflow_are_no_traceback() -> None:
    assert "hit.toml: some values are too large" in refusal({"rig.mechanics.handle_radius": 1e200})


def test_a_rounding_residue_is_a_position_and_a_float_that_cannot_be_squared_is_refused() -> None:
    residue = 0.1 + 0.2 - 0.3
    assert override(KOUL, {"wall.position": residue}).wall.position == residue
    for value in (1e-31, -1e-160, 1e16):
        with pytest.raises(ConfigError, match=r"must be 0, or between 1e-30 and 1e\+15 in magnitude"):
            override(KOUL, {"wall.position": value})


def test_an_unknown_preset_suggests_the_nearest() -> None:
    with pytest.raises(
        ConfigError, match=r'hit\.toml: preset = "koul-complaint".*did you mean koul-compliant\?'
    ):
        experiment_from_mapping({"preset": "koul-complaint"}, "hit.toml")
    with pytest.raises(ConfigError, match="choose one of: chawda-linear, course-paddle, hapkit"):
        experiment_from_mapping({"preset": 3}, "hit.toml")


def test_an_error_under_a_preset_names_both() -> None:
    with pytest.raises(ConfigError, match=r"hit\.toml \(on preset koul-rigid\): wall\.stiffness = -1"):
        experiment_from_mapping({"preset": "koul-rigid", "wall": {"stiffness": -1}}, "hit.toml")


# Rules between keys: each message names the file, the key, its value, the range and the remedy.


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("controller.velocity_rate", 3000, "position_rate = 18000 or 21000 Hz, or velocity_rate = 2500 or 4000 Hz"),
        ("controller.slow_velocity_rate", 1500, "1500 Hz: must divide controller.velocity_rate = 2000 Hz"),
        ("host.heartbeat_s", 0.001, "0.001 s: must be 0 or at least 0.1 s"),
        ("rig.encoder.counts_per_revolution", 10**30, "a number of more than 64 bits: must be > 0 and ≤ 10000000"),
        ("rig.limits.effort", 1.4, "1.4 N·m: must be at most rig.amplifier.effort_limit, 1.3 N·m; lower rig.limits"),
        ("rig.limits.nominal_effort", 2.0, "2.0 N·m: must be at most rig.amplifier"),
        ("homing.effort", 1.4, "1.4 N·m: must be at most rig.limits.effort, 1.3 N·m"),
        ("trial.effort", 1.5, "1.5 N·m: must be at most rig.limits.effort, 1.3 N·m"),
        ("rig.limits.human", True, "effort = 1.3 N·m: must be at most rig.limits.nominal_effort, 0.286 N·m, while"),
        ("rig.limits.position_minimum", 0.6, "0.6 rad: must be below position_maximum, 0.5 rad; swap"),
        ("wall.position", 0.6, "0.6 rad: must lie inside the position window, -0.5 to 0.5 rad"),
        ("trial.start", -0.5, "-0.5 rad: must lie inside the position window, -0.5 to 0.5 rad"),
        ("rig.simulation.initial_position", 1.0, "1.0 rad: must lie inside the position window"),
        ("trial.start", 0.01, "0.01 rad: must be below wall.position, 0 rad: the free side for wall.side = 1"),
        ("wall.side", -1, "trial.start = -0.015 rad: must be above wall.position, 0 rad: the free side for"),
        ("wall.side", -1, "trial.effort = 0.15 N·m: must be < 0 N·m to push into a wall with wall.side = -1"),
        ("trial.effort", 0.0, "0.0 N·m: must be > 0 N·m to push into a wall"),
        ("wall.stiffness", 3000.0, "0.15 N·m: must be at least 0.942 N·m: against wall.stiffness = 3000 N·m/rad"),
        ("homing.speed", 11.0, "11.0 rad/s: must be below rig.limits.speed, 10 rad/s"),
        ("verdict.tail_s", 1.0, "1.0 s: must be shorter than trial.duration_s, 1 s; shorten"),
        ("verdict.highpass_hz", 600.0, "600.0 Hz: must be below verdict.lowpass_hz, 500 Hz; swap"),
        ("rig.amplifier.current_quantum_a", 1e-4, "1.3 N·m: must be ≤ 0.7667 N·m, which is 32767 current quanta"),
        ("rig.amplifier.profile", "escon-50-5", "must be a known amplifier; did you mean escon-50-5-pwm?"),
        ("rig.amplifier.profile", "l298n", "a bridge with two inputs is at full"),
        ("rig.cogging.orders", [0], "[0]: must be different numbers from 1 to 1000"),
        ("rig.cogging.ripple_cosine", [0.02], "must have one number for each of the 0 orders in rig.cogging.orders"),
    ],
    ids=itertools.count(),
)  # fmt: skip
def test_rules_between_keys(key: str, value: Any, words: str) -> None:
    text = refusal({key: value})
    assert words in text
    assert all(line.startswith("hit.toml: ") for line in text.splitlines())


BRIDGE = {"rig.amplifier.profile": "voltage-bridge", "rig.amplifier.set_point_delay_s": 2e-5}
COGS = {
    "rig.cogging.orders": [3],
    "rig.cogging.period": 0.6,
    "rig.cogging.cosine": [0.1],
    "rig.cogging.sine": [0.0],
}


@pytest.mark.parametrize(
    ("base", "changes", "words"),
    [
        (KOUL, {"rig.encoder.counts_per_revolution": None, "rig.encoder.quantum": 1e-6}, 'motion = "linear"; rig.mo'),
        (KOUL, {**BRIDGE, "rig.amplifier.profile": "escon-50-5-pwm"}, "set_point_delay_s = 2e-05 s: must be ≥ 0.00025"),
        (KOUL, BRIDGE, 'drive = "current": must be voltage with rig.amplifier.profile = "voltage-bridge"; set it to'),
        (KOUL, {**BRIDGE, "rig.amplifier.drive": "voltage", "rig.amplifier.back_emf_damping": 0.0}, "must be > 0 on a"),
        (KOUL, {**COGS, "rig.cogging.orders": [1, 7]}, "one number for each of the 2 orders in rig.cogging.orders"),
        (KOUL, {**COGS, "rig.cogging.period": None}, "period = None rad: must be given with rig.cogging.orders"),
        (KOUL, {**COGS, "rig.cogging.ripple_cosine": [0.8], "rig.cogging.ripple_sine": [0.6]}, "up to 1 of the effort"),
        (KOUL, {"rig.cogging.minimum": 0.2, "rig.cogging.maximum": 0.1}, "minimum = 0.2 rad: must lie below"),
        (CHAWDA, {"rig.encoder.quantum": None, "rig.encoder.counts_per_revolution": 1000}, 'motion = "rotary"; rig.mo'),
        (CHAWDA, {"rig.mechanics.handle_radius": 0.1}, "handle_radius = 0.1 m: must be 1 on a linear rig"),
    ],
    ids=itertools.count(),
)  # fmt: skip
def test_rules_of_keys_that_change_together(base: Experiment, changes: dict[str, Any], words: str) -> None:
    assert words in refusal(changes, base)


def test_a_push_into_no_stiffness_has_no_rest_to_refuse() -> None:
    assert override(KOUL, {"wall.stiffness": 0.0}).wall.stiffness == 0.0
    assert (
        override(KOUL, {"wall.stiffness": 3000.0, "trial.minimum_rest_counts": 0.0}).wall.stiffness == 3000.0
    )


def test_the_smallest_push_that_is_allowed_rests_two_counts_deep() -> None:
    resolution = KOUL.rig.encoder.resolution
    assert override(KOUL, {"trial.effort": 2.001 * resolution * 300.0})
    assert "rests 2 counts" in refusal({"trial.effort": 1.999 * resolution * 300.0})


def test_a_wall_on_the_other_side_is_pushed_with_negative_effort() -> None:
    mirrored = override(KOUL, {"wall.side": -1, "trial.start": 0.015, "trial.effort": -0.15})
    assert mirrored.trial.effort == -0.15


def test_a_person_is_protected_without_an_explicit_override() -> None:
    safe = override(KOUL, {"rig.limits.human": True, "rig.limits.effort": 0.286})
    assert safe.rig.limits.effort == 0.286
    assert (
        override(KOUL, {"rig.limits.human": True, "rig.limits.override_stall": True}).rig.limits.effort == 1.3
    )


def test_by_default_a_person_holds_the_handle_and_the_limit_is_the_nominal_effort() -> None:
    table = as_mapping(KOUL)
    del table["rig"]["limits"]["effort"], table["rig"]["limits"]["human"]
    limits = experiment_from_mapping(table, "hit.toml").rig.limits
    assert limits.human
    assert limits.effort == limits.nominal_effort == 0.286


# Changing, writing back, listing


def test_an_override_names_the_command_line() -> None:
    with pytest.raises(ConfigError, match=r"^command line: wall\.stiffness = -1\.0"):
        override(KOUL, {"wall.stiffness": -1.0})


def test_another_estimator_does_not_inherit_settings() -> None:
    assert override(KOUL, {"controller.estimator": "fdm"}).controller.parameters == {}
    other = experiment_from_mapping(
        {"preset": "koul-rigid", "controller": {"estimator": "foaw", "parameters": {"window": 16}}},
        "hit.toml",
    )
    assert other.controller.parameters == {"window": 16.0}
    same = override(KOUL, {"controller.estimator": "fdm-butterworth", "controller.parameters.order": 2})
    assert same.controller.parameters == {"cutoff_hz": 200.0, "order": 2.0}


def test_realtime_changes_are_stored_and_checked_when_applied() -> None:
    experiment = experiment_from_mapping(
        {"preset": "koul-compliant", "realtime": {"wall": {"stiffness": 50}}}, "hit.toml"
    )
    assert experiment.wall.stiffness == 300.0
    assert experiment.realtime["wall.stiffness"] == 50
    assert experiment.realtime["controller.position_rate"] == 1000  # of the preset
    assert with_realtime(experiment).wall.stiffness == 50.0
    stated = with_realtime(
        experiment_from_mapping({"preset": "koul-compliant", "wall": {"stiffness": 100.0}}, "hit.toml")
    )
    assert (stated.wall.stiffness, stated.wall.damping) == (100.0, 0.2), "the preset's gentler damping"
    broken = override(KOUL, {"realtime.wall.stiffness": -1.0})
    with pytest.raises(ConfigError, match=r"\[realtime\] of koul-compliant: wall\.stiffness = -1\.0"):
        with_realtime(broken)


def _numbers_of(experiment: Experiment) -> st.SearchStrategy[dict[str, Any]]:
    """Generate valid changes of a few keys that do not restrict each other."""
    positive = st.floats(1e-3, 1e3)
    return st.fixed_dictionaries(
        {},
        optional={
            "wall.stiffness": st.just(0.0) | st.floats(1e-9, 400.0),
            "wall.damping": st.just(0.0) | st.floats(1e-9, 1e6),
            "wall.pull": st.sampled_from(["clamp", "allow"]),
            "trial.seed": st.integers(0, 2**63 - 1),
            "trial.start": st.floats(-0.4, -1e-6),
            "controller.velocity_rate": st.sampled_from([1000, 2000, 4000, 20000]),
            "controller.parameters.extra": st.floats(allow_nan=False, allow_infinity=False),
            "controller.command_lifetime_s": st.none() | st.floats(1e-6, 0.02),
            "rig.simulation.initial_position": st.none() | st.floats(-0.4, -1e-9) | st.floats(1e-9, 0.4),
            "rig.description": st.text(st.characters(codec="utf-8")),
            "rig.mechanics.end_mass": positive,
            "operator.grip": st.sampled_from(["relaxed", "normal", "firm"]),
            "operator.press": st.just(0.0) | st.floats(1e-9, 5.0),
            "realtime.wall.damping": positive | st.integers(0, 10),
        },
    )


@given(_numbers_of(KOUL))
def test_a_mapping_brings_back_the_same_experiment_also_through_json(changes: dict[str, Any]) -> None:
    experiment = override(KOUL, changes)
    mapping = as_mapping(experiment)
    assert experiment_from_mapping(mapping, "header") == experiment
    assert experiment_from_mapping(json.loads(json.dumps(mapping)), "header") == experiment


def outcome(load: Callable[[], Experiment], source: str) -> Experiment | None:
    """Return the experiment, or None after a `ConfigError` that names its source."""
    try:
        return load()
    except ConfigError as error:
        text = str(error)
    assert source in text
    return None


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.floats(-1.0, 1.0, allow_subnormal=False).map(lambda x: x * 1e308),
    st.sampled_from([5e-324, 1e200, -0.0, 10**400, 2**64]),
    st.text(max_size=5),
    st.dates(),
    st.binary(max_size=2),
    st.lists(st.integers(), max_size=2),
    st.dictionaries(st.text(max_size=3) | st.integers(), st.integers() | st.text(), max_size=2),
)
PLACES = [
    *parameters(),
    *["wall", "rig", "rig.limits", "controller.parameters", "realtime", "preset", "nothing"],
]


@given(st.sampled_from([KOUL, CHAWDA]), st.sampled_from(PLACES), JUNK)
def test_any_corrupted_value_gives_an_experiment_or_an_error(base: Experiment, key: str, value: Any) -> None:
    table = as_mapping(base)
    corrupted = {**dict(flatten(table)), key: value}
    experiment = outcome(lambda: experiment_from_mapping(nest(corrupted), "hit.toml"), "hit.toml")
    if experiment is not None:
        assert experiment_from_mapping(as_mapping(experiment), "header") == experiment
        assert math.isfinite(experiment.rig.encoder.resolution)


@given(st.binary(max_size=60), st.integers(0, 5000))
def test_any_damage_to_a_file_gives_an_experiment_or_a_config_error(
    tmp_path_factory: pytest.TempPathFactory, junk: bytes, place: int
) -> None:
    text = presets.text("koul-rigid").encode()
    path = tmp_path_factory.mktemp("damage", numbered=True) / "hit.toml"
    path.write_bytes(text[:place] + junk + text[place + len(junk) :])
    outcome(lambda: load_experiment(path), str(path))


def test_a_listing_has_every_parameter_with_its_unit_and_meaning() -> None:
    lines = {line.key: line for line in describe(KOUL)}
    assert lines["wall.stiffness"] == ("wall.stiffness", 300.0, "N·m/rad", "K")
    assert lines["rig.limits.slew"].unit == "N·m/s"
    assert lines["controller.parameters.cutoff_hz"][1:3] == (200.0, "Hz")
    assert {line.key: line for line in describe(CHAWDA)}["rig.amplifier.effort_per_ampere"].unit == "N/A"
    assert set(lines) >= set(parameters()) - {"controller.parameters", "rig.board"}
    with_board = override(KOUL, {"rig.board.enable_pin": 6})
    assert {line.key: line for line in describe(with_board)}["rig.board.enable_pin"][1] == 6
    assert rig_model(with_board).board == (("enable_pin", 6),)
    assert all(line.meaning for line in lines.values())
    walls = [line.key for line in describe(KOUL, "wall")]
    assert walls == [f"wall.{f.name}" for f in fields(KOUL.wall)]


def test_the_schema_for_editors_knows_presets_ranges_units_and_meanings() -> None:
    schema = json_schema()
    assert schema["properties"]["preset"]["enum"] == list(presets.names())
    stiffness = schema["$defs"]["Wall"]["properties"]["stiffness"]
    assert stiffness["minimum"] == 0
    assert stiffness["description"] == "K [N·m/rad or N/m]"
    assert schema["$defs"]["Wall"]["additionalProperties"] is False
    assert "required" not in json.dumps(schema)


def test_thresholds_at_the_handle_become_thresholds_at_the_link() -> None:
    """5 mm/s, 1 N and 0.125 mm at a handle radius of 0.1 m are 0.05 rad/s, 0.10 N·m and 1.25 mrad."""
    limits = verdict_thresholds(KOUL)
    assert (limits.felt_velocity, limits.heard_effort, limits.moved) == pytest.approx((0.05, 0.10, 1.25e-3))
    linear = verdict_thresholds(CHAWDA)
    assert (linear.felt_velocity, linear.heard_effort, linear.moved) == (0.002, 1.0, 1.25e-4)


def test_a_hit_is_judged_by_the_documented_numbers() -> None:
    """They are those of rig/docs/explanation/verdicts.md and of the reproduction study."""
    known = {
        "tail_s": 0.4, "highpass_hz": 30.0, "lowpass_hz": 500.0, "growth_ratio": 1.2, "saturated_fraction": 0.01,
        "longest_gap": 2, "lost_fraction": 0.01, "late_fraction": 0.003,
    }  # fmt: skip
    for limits in (VerdictLimits(), KOUL.verdict):
        assert {name: getattr(limits, name) for name in known} == known


def test_plug_ins_are_checked_by_name_and_setting() -> None:
    check_plugins(KOUL, "hit.toml")
    with pytest.raises(
        ConfigError, match=r'hit\.toml: controller\.estimator = "fdm-buterworth": .*did you mean fdm-'
    ):
        check_plugins(override(KOUL, {"controller.estimator": "fdm-buterworth"}), "hit.toml")
    with pytest.raises(ConfigError, match=r'hit\.toml: wall\.law = "spring": must be one of spring-damper'):
        check_plugins(override(KOUL, {"wall.law": "spring"}), "hit.toml")
    with pytest.raises(ConfigError, match=r"hit\.toml: controller\.parameters: .*window.*cutoff_hz"):
        check_plugins(override(KOUL, {"controller.parameters.window": 3}), "hit.toml")
