"""The search for a scheme: its theory against brute force, its hits against all hits, its resumption after a stop."""

import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import rig
from rig import config
from rig.analysis import theory
from rig.config import presets
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError, NoStableWallError
from rig.devices.device import LINK_SHARE, STATE_BYTES
from rig.experiments.design import (
    Candidate,
    DesignRequest,
    LawPlace,
    UnmetError,
    Wishes,
    design,
    directory_for,
    listed,
    places_for,
)
from rig.experiments.design import _device as device
from rig.experiments.design import _linear as linear
from rig.experiments.design import _listing as listing
from rig.experiments.design import _margin as margin
from rig.experiments.design import _paths as paths
from rig.experiments.design import _search as searching
from rig.experiments.design._rules import BoundaryMeasures
from rig.experiments.design._search import Round
from rig.experiments.mapping import _maps as maps
from rig.experiments.mapping._ranges import search_for
from rig.experiments.mapping._rendering import RENDERED, rendered_share
from rig.experiments.mapping.zwidth import MapPlan
from rig.firmware.tick_budget import CALLS
from tests.conformance.made_links import link
from tests.conformance.maps import SHORT, short_map
from tests.conformance.tiers import first_by_default

X = config.override(presets.load("koul-compliant"), SHORT)
RESOLUTION = X.rig.encoder.resolution
SCHEMES = tuple(
    Scheme.parse(text)
    for text in (
        "uniform:10k,estimator=fdm",
        "uniform:2k,estimator=fdm-butterworth,cutoff_hz=200",
        "dual:10k/2k,estimator=fdm-butterworth,cutoff_hz=400",
        "dual:10k/1k,estimator=kalman,bandwidth_hz=100,gain=steady",
        "dual:10k/2k,estimator=levant,lipschitz=70",
    )
)
ROUNDS = (
    Round(name="first", enter=5, ratio=2.0, columns=3, offsets=(0.1,)),
    Round(name="second", enter=3, way="ladder", ratio=1.5, columns=3, offsets=(0.1,)),
)
IDENTIFIED = margin.IDENTIFIED
QUICK = (replace(ROUNDS[0], columns=2, enter=2),)
REQUEST = DesignRequest(experiment=X, schemes=SCHEMES, rounds=ROUNDS, places=places_for(X))


@pytest.fixture(scope="module", autouse=True)
def few_samples() -> Any:
    """Reduce the number of other rigs in a stability margin; what is done with each stays the same."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(margin, "IDENTIFIED", IDENTIFIED[-3:])
        patch.setattr(margin, "SAMPLES", 1)
        patch.setattr(margin, "RATIO", 1.7)
        patch.setattr(margin, "OFFSETS", (0.1,))
        yield


@pytest.fixture(scope="module")
def stored_design(tmp_path_factory: pytest.TempPathFactory) -> Any:
    place = directory_for(REQUEST, tmp_path_factory.mktemp("designs"))
    return place, design(REQUEST, place)


# --- velocity paths ---------------------------------------------------------------------------------------------------


def controller(text: str) -> Any:
    return Scheme.parse(text).applied(X).controller


def test_noise_of_a_difference_has_half_the_variance_of_a_count() -> None:
    found = paths.noise(controller("uniform:10k,estimator=fdm"), RESOLUTION)
    assert found == pytest.approx(RESOLUTION * 10_000 / np.sqrt(2.0), rel=4.0 / np.sqrt(paths.SAMPLES))


@pytest.mark.parametrize(
    ("lag_s", "ticks", "extrapolate"), [(0.0, 0, False), (1e-4, 2, False), (0.0, 0, True)]
)
def test_fidelity_of_a_difference_is_that_of_its_formula(lag_s: float, ticks: int, extrapolate: bool) -> None:
    period, tick = 1e-3, 1e-4
    prediction = ",prediction=extrapolate" if extrapolate else ""

    def error(hertz: float) -> float:
        turn = 2j * np.pi * hertz * period
        zero = (1.0 - np.exp(-turn)) / turn  # both of the difference and of the hold
        held = (1.0 + turn) * zero**2 if extrapolate else zero
        late = np.exp(-2j * np.pi * hertz * ticks * tick) / (1.0 + 2j * np.pi * hertz * lag_s)
        return abs(zero * held * late - 1.0) - paths.ERROR

    found = paths.fidelity_hz(controller(f"dual:10k/1k,estimator=fdm{prediction}"), RESOLUTION, lag_s, ticks)
    # Interpolated between lines 25 % apart.
    assert found == pytest.approx(brentq(error, 1.0, 400.0), rel=0.03)


def test_cost_is_that_of_a_call_over_its_ticks() -> None:
    for board, core in (("rp2040", "M0+"), ("mps2", "M4F")):
        call = CALLS[core]["fdm-butterworth"]
        dual = controller("dual:10k/1k,estimator=fdm-butterworth")
        assert paths.cost(dual, board) == pytest.approx(call / 10)
        assert paths.cost(controller("uniform:10k,estimator=fdm-butterworth"), board) == call
        no_board_runs_it = controller("uniform:10k,estimator=optimal,lipschitz=70")
        assert paths.cost(no_board_runs_it, board) is None


def test_a_board_without_a_float_unit_has_less_time_for_a_float_law() -> None:
    """The Pico's tick was counted in Cortex-M4F cycles, hence 40 kHz for a law that its M0+ runs at 11.6 kHz."""
    float_law = "estimator=fdm-butterworth,cutoff_hz=200"
    for text, on_pico, with_float_unit in (
        (f"dual:10k/2k,{float_law}", True, True),
        (f"dual:20k/2k,{float_law}", False, True),
        ("uniform:20k,estimator=fdm-butterworth-fixed", True, True),
        ("uniform:2k,estimator=foaw-best,window_limit=16", False, True),
    ):
        assert paths.fits_a_tick(controller(text), "rp2040") is on_pico, text
        assert paths.fits_a_tick(controller(text), "mps2") is with_float_unit, text
    with pytest.raises(ConfigError, match="control tick on board mps2-an385 cannot be estimated"):
        places_for(X, "device", board="mps2-an385")


# --- the listed set ---------------------------------------------------------------------------------------------------


def place(**given: Any) -> LawPlace:
    return LawPlace(**{"loop": "host", "rate_maximum": 5000, **given})


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listing, "CUTOFFS_HZ", (100.0,))
    monkeypatch.setattr(listing, "DIVIDERS", (1, 2))


@pytest.mark.usefixtures("small")
def test_the_listed_set_keeps_to_what_board_and_link_allow() -> None:
    free = listed(X, [place()])
    assert len({one.key for one in free}) == len(free) > 40
    assert max(one.scheme.position_rate for one in free) == 5000
    narrow = listed(X, [place(bytes_per_second=2500 * STATE_BYTES / LINK_SHARE)])
    assert {one.key for one in narrow} < {one.key for one in free}
    assert max(one.scheme.position_rate for one in narrow) == 2000
    on_device = listed(X, [place(loop="device")])
    assert {one.scheme.estimator for one in free} - {one.scheme.estimator for one in on_device} == {"optimal"}
    fast = listed(X, [place(loop="device", rate_maximum=20_000)])
    windowed = {one.scheme.position_rate for one in fast if one.scheme.estimator == "foaw-best"}
    assert max(windowed) == 1000, "51 016 cycles are 51 % of a period at 2 kHz, on a Pico at 200 MHz"


@pytest.mark.usefixtures("small")
def test_a_law_on_the_host_is_late_by_the_round_trip_in_whole_ticks() -> None:
    delays = {one.scheme.position_rate: one.delay_ticks for one in listed(X, [place(round_trip_s=0.45e-3)])}
    assert delays == {1000: 1, 2000: 1, 5000: 3}
    (one,) = listed(X, [place(round_trip_s=0.45e-3)], [Scheme.parse("uniform:5k,estimator=fdm")])
    assert one.applied(X).rig.simulation.computation_delay_ticks == 3


def test_a_place_behind_a_bridge_is_late_by_its_drive_too(monkeypatch: pytest.MonkeyPatch) -> None:
    carries = SimpleNamespace(bytes_per_second=None, clock=SimpleNamespace(virtual=False))
    says = SimpleNamespace(position_rate_maximum=2500, parameter=lambda name: None)
    opened = nullcontext(SimpleNamespace(dictionary=says, link=carries))
    monkeypatch.setattr(device, "open_for_run", lambda *given, **more: opened)
    monkeypatch.setattr(device, "measured_once", lambda *given: link(0.4e-3, drive={"p999_us": 1300.0}))
    (found,) = device.places_of("moteus:///dev/made-up", X)
    assert found.delay_ticks(X, 1000) == 2


# --- theory -----------------------------------------------------------------------------------------------------------


def test_the_theory_of_the_set_is_that_of_each_wall_by_itself() -> None:
    candidates = [Candidate(scheme=one, loop="host", delay_ticks=late) for one in SCHEMES for late in (0, 1)]
    k, dampings = [20.0, 80.0, 320.0, 1280.0], [0.0, 0.3, 1.2]
    tasks, order = linear.tasks(X, candidates, dampings, k)
    assert len(tasks) == len(SCHEMES), "candidates of one estimator share its realisation"
    by_estimator = [linear.of_estimator(json.loads(json.dumps(task.payload))) for task in tasks]
    found = linear.results(by_estimator, order)
    for candidate, one in zip(candidates, found, strict=True):
        nonlinear = candidate.scheme.estimator == "levant"
        assert one.stands_in == nonlinear
        stand_in = Scheme.parse("dual:10k/2k,estimator=fdm-butterworth,cutoff_hz=200")
        scheme = stand_in if nonlinear else candidate.scheme
        for number, damping in enumerate(dampings):
            limit = 0.0
            for stiffness in k:
                radius = theory.spectral_radius(candidate.condition(X), scheme, stiffness, damping)
                if float(radius) >= 1.0:
                    break
                limit = stiffness
            if rendered_share(candidate.applied(X), damping) < RENDERED:
                limit = 0.0
            assert one.stable[number] == limit
            assert one.quiet[number] <= limit


# --- hits -------------------------------------------------------------------------------------------------------------


@pytest.mark.exhaustive("::test_the_public_function_finds_the_same")
def test_the_search_finds_what_all_hits_find(stored_design: Any) -> None:
    """Hits of all schemes on all walls of the last round find no larger area, within one step of stiffness."""
    _, found = stored_design
    dampings = tuple(b.damping for b in found.recommended.boundary)
    whole = MapPlan(
        experiment=X,
        schemes=(Scheme.of(X), *SCHEMES),
        dampings=dampings,
        search=search_for(X, "grid", ratio=ROUNDS[-1].ratio),
        offsets=ROUNDS[-1].offsets,
    )
    grid = maps.zwidth(whole)
    areas = [
        BoundaryMeasures.of(dampings, [b.stiffness for b in grid.curve(number, "any")]).area
        for number in range(len(whole.schemes))
    ]
    assert max(one.measures.area for one in found.finalists) * ROUNDS[-1].ratio >= max(areas)
    assert found.own.measures.area == pytest.approx(areas[0], rel=ROUNDS[-1].ratio - 1.0)
    assert found.recommended in found.finalists
    assert found.held_out is None or found.held_out.no_worse or found.recommended is found.own
    assert 0.0 < found.margin.worst.share <= found.margin.alone[-1].share


@pytest.mark.parametrize("way", ["ladder", "bisection"])
def test_the_limits_of_any_alone_are_those_of_a_whole_map(way: Any) -> None:
    whole = replace(short_map(0.1, 0.6), search=search_for(X, way, ratio=1.5))
    every, alone = maps.zwidth(whole), maps.zwidth(replace(whole, criteria=("any",)))
    assert [b.stiffness for b in alone.boundaries] == [b.stiffness for b in every.curve(0, "any")]
    assert alone.hits < every.hits


def test_the_section_to_paste_is_the_recommended_scheme(stored_design: Any, tmp_path: Path) -> None:
    _, found = stored_design
    for one in found.finalists:
        section = replace(found, recommended=one).toml()
        path = tmp_path / "mine.toml"
        path.write_text(f'preset = "koul-compliant"\n{section}')
        pasted = config.load_experiment(path)
        applied = one.candidate.applied(X)
        same = Candidate.own(pasted)
        assert same.law(pasted)[2:] == one.candidate.law(X)[2:]
        assert pasted.controller.loop == applied.controller.loop


# --- wishes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wishes", "message"),
    first_by_default(
        [
            (Wishes(fidelity_hz=4000.0), r"none of \d schemes.*4000 \(`fidelity_to`\).* of it"),
            (Wishes(noise=1e-9), r"limiting one is 1e-09 \(`most_noise`\)"),
            (Wishes(cost=1.0), r"limiting one is 1 \(`most_cost`\)"),
            (Wishes(wall=(470.0, 30.0)), r"K = 470 with B = 30 \(`must_be_stable`\); .* reaches 0 of it"),
        ]
    ),
)
def test_a_wish_that_no_scheme_fulfils_is_named_with_the_best_value(wishes: Wishes, message: str) -> None:
    with pytest.raises(UnmetError, match=message):
        design(DesignRequest(experiment=X, schemes=SCHEMES[:2], rounds=QUICK, wishes=wishes))


def test_no_scheme_is_recommended_where_none_has_a_stable_wall() -> None:
    limits = {"verdict.heard_force": 1e-6, "verdict.felt_velocity": 1e-9, "verdict.moved": 1e-9}
    strict = config.override(X, limits)
    with pytest.raises(NoStableWallError, match=r"none of \d sampling schemes has a stable wall") as refused:
        design(replace(REQUEST, experiment=strict, rounds=QUICK))
    assert refused.value.exit_code == 18


def test_a_scheme_whose_damping_is_not_rendered_gains_nothing_by_it(small: None) -> None:
    """With an unfiltered difference at 20 kHz and 4000 counts a turn, limit·T/Δ is only 0.019 N·m·s/rad."""
    coarse = config.override(X, {"rig.encoder.ratio": 1.0, "rig.limits.effort": 0.6, "wall.stiffness": 20.0})
    schemes = (Scheme.parse("uniform:20k,estimator=fdm"), Scheme.parse("dual:20k/2k"))
    found = design(replace(REQUEST, experiment=coarse, schemes=schemes))
    (bare,) = (one for one in found.standings if "fdm" in one.label.split())
    assert bare.measures.damping <= 0.6 / 20_000 / coarse.rig.encoder.resolution / RENDERED


def test_identified_parameters_are_those_that_a_rig_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(margin, "IDENTIFIED", IDENTIFIED)
    assert len(margin.identified(X)) == len(IDENTIFIED)
    rigid = margin.identified(presets.load("koul-rigid"))
    assert "rig.mechanics.transmission_stiffness" not in rigid
    assert all(value > 0.0 for value in rigid.values())


def test_the_public_function_finds_the_same(stored_design: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    place, whole = stored_design
    monkeypatch.setattr(searching, "ROUNDS", ROUNDS)
    found = rig.design(X, schemes=[scheme.text for scheme in SCHEMES], directory=place.parent)
    assert found.as_mapping() == whole.as_mapping(), "read from the same directory"
    assert repr(found).startswith(f"design of koul-compliant: {found.recommended.label}\n  goal")


def test_an_estimator_of_the_effort_is_refused_as_a_scheme_too() -> None:
    schemes = [Scheme.parse("uniform:1k,estimator=disturbance")]
    with pytest.raises(ConfigError, match="estimator disturbance uses the motor's effort"):
        design(DesignRequest(experiment=X, schemes=tuple(schemes), rounds=QUICK))
