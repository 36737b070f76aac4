"""Estimators over arrays give the same bits as in the loop, and reject arrays that they cannot interpret."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control import estimators
from rig.control.estimators import estimate, estimate_with_window, quantise
from rig.control.estimators.arrays import OLDEST_EDGE_S, inputs
from rig.control.estimators.estimator import WINDOW
from rig.core.errors import ConfigError
from sim_backend.mechanics.sensors import encoder_count
from tests.conformance.estimator import REQUIRED

GUIDE = Path(estimators.__file__).with_name("README.md")
DT, DELTA = 5e-4, 1e-5


def lively(n: int = 400, seed: int = 1) -> np.ndarray:
    random = np.random.default_rng(seed)
    return np.cumsum(np.round(20 * np.sin(np.arange(n) / 30) + random.normal(0, 2, n)).astype(np.int64))


@given(
    position=st.floats(-10, 10, allow_subnormal=False),
    resolution=st.floats(1e-6, 1e-2),
    offset=st.floats(0, 1, allow_subnormal=False),
    sign=st.sampled_from([-1, 1]),
)
def test_quantise_counts_as_the_encoder(position: float, resolution: float, offset: float, sign: Any) -> None:
    found = quantise(position, sign * resolution, offset=offset)
    assert found == encoder_count(position, resolution, offset, sign)
    assert found.dtype == np.int64
    assert quantise([[position]], resolution, offset=offset).shape == (1, 1)


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        *(([0.0, position], "not finite or is beyond") for position in (math.nan, math.inf, 1e30)),
        (np.zeros(3, "m8[ns]"), "holds durations"),
        (["1.0"], "holds text"),
        ([True], "holds truth values"),
        (np.ma.masked_array([0.0, 9.0], mask=[False, True]), "not finite"),
    ],
)
def test_a_position_of_another_type_or_that_no_counter_holds_is_refused(positions: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        quantise(positions, 1e-6)


@pytest.mark.parametrize("name", estimators.names())
def test_an_array_gives_the_bits_of_the_update_called_sample_by_sample(name: Any) -> None:
    counts, required = lively(), REQUIRED.get(name, {})
    prepared = estimators.get(name).prepare(required, DELTA, DT)
    efforts = np.sin(np.arange(len(counts)))
    whole, age, elapsed = inputs(counts, DT)
    memory = (prepared.state_f, prepared.state_i, prepared.parameters)
    expected, windows = [], []
    for count, edge_age, n, effort in zip(
        whole.tolist(), age.tolist(), elapsed.tolist(), efforts.tolist(), strict=True
    ):
        expected.append(prepared.estimator.update(count, edge_age, n, effort, *memory))
        windows.append(prepared.state_i[WINDOW])
    given: Any = {"resolution": DELTA, "effort": efforts, **required}
    velocity, window = estimate_with_window(name, counts, DT, **given)
    assert velocity.tolist() == expected
    assert window.tolist() == windows
    assert velocity[0] == 0.0
    assert estimate(name, counts, DT, **given).tolist() == expected


def test_rounding_gives_the_finite_difference_its_noise_at_every_rate() -> None:
    """PHYSICS 2i (A) 2: Δ/(√6·T): 0.00408 m/s at 1 kHz, 0.0408 at 10 kHz, 0.0816 at 20 kHz for 10 µm."""
    for rate, noise in ((1000, 0.00408), (10_000, 0.0408), (20_000, 0.0816)):
        k = np.arange(40_000)
        position = DELTA * (0.37 * math.pi * k + 3000 * np.sin(0.0371 * k))
        velocity = estimate("fdm", quantise(position, DELTA), 1 / rate, resolution=DELTA)
        error = velocity[1:] - np.diff(position) * rate
        assert np.std(error) == pytest.approx(noise, rel=0.02)
        assert noise == pytest.approx(DELTA * rate / math.sqrt(6), rel=2e-3)


def test_no_samples_give_no_velocities() -> None:
    assert estimate("fdm", np.zeros(0, np.int64), DT, resolution=DELTA).shape == (0,)
    assert estimate("fdm", [], DT, resolution=DELTA).shape == (0,)


def test_read_only_arrays_are_accepted_and_unchanged() -> None:
    counts = lively()
    counts.setflags(write=False)
    estimate("fdm", counts[::2], DT, resolution=DELTA)
    assert (counts == lively()).all()


def test_without_edge_times_an_edge_happens_at_the_sample_that_first_shows_it() -> None:
    _, age, _ = inputs([5, 5, 6, 6, 6, 4, 4], DT)
    assert age[:2].tolist() == [OLDEST_EDGE_S] * 2
    assert age[2:] == pytest.approx(np.array([0, 1, 2, 0, 1]) * DT)


def test_edge_times_become_ages_at_the_samples_and_none_is_the_oldest() -> None:
    _, age, _ = inputs([0, 1, 2], DT, edge_time=[-math.inf, 0.2 * DT, 1.9 * DT])
    assert age == pytest.approx([OLDEST_EDGE_S, 0.8 * DT, 0.1 * DT])


WRONG = {
    "unknown estimator": ({"name": "fmd"}, "unknown estimator 'fmd'.*fdm, fdm-butterworth"),
    "unknown setting": ({"cutof": 3.0}, "unknown parameter 'cutof'"),
    "setting out of range": ({"cutoff_hz": -1.0}, "out of range"),
    "no period": ({"dt": 0.0}, "not a valid sampling period"),
    "no resolution": ({"resolution": 0.0}, "not a valid travel for one count"),
    "table of counts": ({"counts": [[1, 2]]}, "2 dimensions"),
    "edges of another length": ({"edge_time": [0.0]}, "3 counts are given, but edge_time has shape"),
    "edge in the future": ({"edge_time": [0.0, 0.0, 1.0]}, "later than its sample"),
    "edges as dates": ({"edge_time": np.zeros(3, "M8[ns]")}, "holds dates"),
    "edge that is no number": ({"edge_time": [0.0, 0.0, math.nan]}, "not a number"),
    "elapsed of another length": ({"elapsed": [1, 1]}, "3 counts are given, but 2 values of elapsed"),
}


@pytest.mark.parametrize("case", WRONG)
def test_invalid_arguments_are_refused_with_a_remedy(case: Any) -> None:
    changed, text = WRONG[case]
    arguments = {"name": "fdm-butterworth", "counts": [0, 1, 2], "dt": DT, "resolution": DELTA, **changed}
    with pytest.raises(ConfigError, match=text) as caught:
        estimate(arguments.pop("name"), arguments.pop("counts"), arguments.pop("dt"), **arguments)
    assert caught.value.remedy


def test_files_that_the_guide_names_exist() -> None:
    root = GUIDE.parents[3]
    for name in re.findall(r"`((?:rig|tests)/[\w/.]+)`", GUIDE.read_text(encoding="utf-8")):
        assert (root / name).exists(), name
