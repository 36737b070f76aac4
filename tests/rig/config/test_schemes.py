"""Control schemes: their text form survives a round trip, and what they change in an experiment."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.config import override, presets
from rig.config.schemes import Scheme, describe_cutoffs, parse_rates
from rig.core.errors import ConfigError

KOUL = presets.load("koul-compliant")


@pytest.mark.parametrize(
    ("text", "rates"),
    [
        ("dual:20k/2k", (20_000, 2000)),
        ("uniform:20k", (20_000, 20_000)),
        ("uniform:12345", (12_345, 12_345)),
        (" dual:50k/0.5k ", (50_000, 500)),
    ],
)
def test_rates_are_read_in_hertz_or_kilohertz(text: str, rates: tuple[int, ...]) -> None:
    scheme = Scheme.parse(text)
    assert (scheme.position_rate, scheme.velocity_rate) == rates
    assert scheme.kind == text.strip().partition(":")[0]


@given(
    st.integers(10, 200_000),
    st.integers(10, 200_000),
    st.sampled_from([None, "fdm", "kalman"]),
    st.dictionaries(st.sampled_from(["cutoff_hz", "order", "power"]), st.floats(0.1, 1e6)),
    st.sampled_from([None, "hold", "extrapolate"]),
    st.one_of(st.none(), st.integers(1, 10_000)),
    st.one_of(st.none(), st.floats(0.0, 10.0, allow_subnormal=False)),
)
def test_the_text_form_gives_an_equal_scheme(
    fast: int, slow: int, estimator: Any, parameters: Any, prediction: Any, rate: Any, below: Any
) -> None:
    scheme = Scheme(
        position_rate=fast,
        velocity_rate=slow,
        estimator=estimator,
        parameters=parameters,
        prediction=prediction,
        slow_velocity_rate=rate,
        slow_below=below,
    )
    assert Scheme.parse(scheme.text) == scheme


@pytest.mark.parametrize(
    "text",
    [
        "", "20k", "dual", "triple:20k/2k/1k", "uniform:20k/2k", "dual:x/2k", "dual:20k/2k,cutoff_hz",
        "uniform:0", "uniform:-1k", "uniform:0.5", "dual:20k/2k,slow_velocity_rate=x", "uniform:1e400",
        "dual:20k/2k,slow_velocity_rate=0.5",
    ],
)  # fmt: skip
def test_an_invalid_scheme_is_refused_with_the_form_to_write(text: str) -> None:
    with pytest.raises(ConfigError) as refused:
        Scheme.parse(text)
    assert "20k" in refused.value.remedy or "rate" in refused.value.remedy


def test_a_filter_keeps_its_share_of_the_velocity_rate() -> None:
    uniform = Scheme.parse("uniform:20k").applied(KOUL).controller
    assert (uniform.velocity_rate, uniform.parameters["cutoff_hz"]) == (20_000, 2000.0)
    assert Scheme.parse("uniform:20k,cutoff_hz=1000").applied(KOUL).controller.parameters["cutoff_hz"] == 1000
    assert Scheme.parse("dual:20k/2k").applied(KOUL).controller.parameters["cutoff_hz"] == 200.0


def test_the_same_cutoff_is_kept_where_only_rates_are_compared() -> None:
    same = override(KOUL, {"controller.scheme_cutoff": "same"}, "the test")
    for text in ("uniform:20k", "uniform:2k", "dual:20k/1k", "dual:20k/2k,estimator=fdm-butterworth-fixed"):
        assert Scheme.parse(text).applied(same).controller.parameters["cutoff_hz"] == 200.0
    assert (
        Scheme.parse("uniform:20k,cutoff_hz=1000").applied(same).controller.parameters["cutoff_hz"] == 1000.0
    )


@pytest.mark.parametrize(
    ("texts", "rule", "found"),
    [
        (("dual:20k/2k", "uniform:20k"), "as-in-the-paper", ("200 Hz at 2 kHz", "2000 Hz at 20 kHz")),
        (("dual:20k/2k", "uniform:20k"), "same", None),
        (("dual:20k/2k", "uniform:20k,cutoff_hz=2000"), "as-in-the-paper", None),  # stated, so not silent
        (("dual:20k/2k", "uniform:2k"), "as-in-the-paper", None),
        (("dual:20k/2k", "uniform:20k,estimator=kalman"), "as-in-the-paper", None),
    ],
)
def test_cutoffs_that_differ_with_the_rates_are_named(texts: tuple[str, ...], rule: str, found: Any) -> None:
    experiment = override(KOUL, {"controller.scheme_cutoff": rule}, "the test")
    note = describe_cutoffs(map(Scheme.parse, texts), experiment)
    if found is None:
        assert note is None
    else:
        assert note is not None
        assert all(each in note for each in (*found, "scheme_cutoff"))


def test_another_estimator_brings_its_own_settings_and_leaves_the_old_ones_behind() -> None:
    kalman = Scheme.parse("dual:20k/2k,estimator=kalman").applied(KOUL).controller
    assert kalman.estimator == "kalman"
    assert "cutoff_hz" not in kalman.parameters
    fdm = Scheme.parse("uniform:20k,estimator=fdm").applied(KOUL)
    back = Scheme.parse("uniform:10k,estimator=fdm-butterworth").applied(fdm).controller
    assert back.parameters["cutoff_hz"] == 1000.0


def test_the_scheme_of_an_experiment_applied_to_it_changes_nothing() -> None:
    for name in presets.names():
        experiment = presets.load(name)
        again = Scheme.of(experiment).applied(experiment)
        assert (again.controller, again.wall, again.trial) == (
            experiment.controller,
            experiment.wall,
            experiment.trial,
        )


def test_prediction_and_adaptive_velocity_rate_reach_the_controller() -> None:
    text = "dual:20k/2k,prediction=extrapolate,slow_velocity_rate=500,slow_below=0.1"
    controller = Scheme.parse(text).applied(KOUL).controller
    assert (controller.prediction, controller.slow_velocity_rate, controller.slow_below) == (
        "extrapolate",
        500,
        0.1,
    )


@pytest.mark.parametrize("text", ["dual:20k/3k", "dual:20k/2k,estimator=unknown", "dual:20k/2k,colour=3"])
def test_a_scheme_that_cannot_run_is_an_error_that_names_it(text: str) -> None:
    with pytest.raises(ConfigError, match=text.partition(",")[0]):
        Scheme.parse(text).applied(KOUL)


def test_a_wrong_rate_is_refused_with_the_reason() -> None:
    with pytest.raises(ConfigError, match="too many"):
        parse_rates("20k/2k/1k")
    with pytest.raises(ConfigError, match="whole number"):
        parse_rates("2.5")


def test_a_label_has_rates_estimator_and_cutoff_in_effect() -> None:
    assert Scheme.parse("uniform:20k").label(KOUL) == "uniform 20 kHz, fdm-butterworth 2000 Hz"
    text = "dual:20k/2k,estimator=levant,prediction=extrapolate"
    assert Scheme.parse(text).label(KOUL) == "dual 20/2 kHz, levant, extrapolated"
