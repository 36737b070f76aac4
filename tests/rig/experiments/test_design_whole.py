"""A design from a listed set against a paper's scheme: schemes that single hits exclude, against maps of all."""

from dataclasses import replace

import pytest

from rig import config
from rig.config import presets
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.experiments.design import _rules as rules
from rig.experiments.design import _whole as whole
from rig.experiments.design._listing import Candidate
from rig.experiments.design._rounds import Sweeper
from rig.experiments.design._whole import PaperSchemes
from tests.conformance.maps import SHORT

# Some hold at B = 0.
LOOSE = {"verdict.felt_velocity": 0.05, "verdict.heard_force": 5.0, "verdict.moved": 1e-3}
X = config.override(presets.load("koul-compliant"), {**SHORT, **LOOSE})
PAPERS = Scheme.parse("dual:10k/2k,estimator=fdm-butterworth,cutoff_hz=200")
LISTED = tuple(
    Scheme.parse(text)
    for text in (
        "dual:10k/2k,estimator=fdm-butterworth,cutoff_hz=200",
        "uniform:10k,estimator=fdm",
        "uniform:5k,estimator=fdm-butterworth,cutoff_hz=200",
        "dual:10k/2k,estimator=fdm-butterworth,cutoff_hz=800",
        "dual:10k/1k,estimator=kalman,bandwidth_hz=100,gain=steady",
        "uniform:1k,estimator=fdm",
    )
)


def candidate(scheme: Scheme) -> Candidate:
    return Candidate(scheme=scheme, loop="host", delay_ticks=0)


@pytest.fixture(autouse=True)
def few_walls(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"COLUMNS": 4, "BEYOND": (2.0,), "RATIO": 1.4, "OFFSETS": (0.1,), "BATCH": 1}.items():
        monkeypatch.setattr(whole, name, value)


@pytest.mark.exhaustive("::test_the_second_paper_is_held_to_its_table_one")
@pytest.mark.parametrize("papers", [PAPERS, LISTED[-1]])
def test_a_scheme_that_a_hit_rules_out_misses_that_measure_in_its_map(
    papers: Scheme, monkeypatch: pytest.MonkeyPatch
) -> None:
    paper = PaperSchemes(schemes=(papers,), measures=rules.OF_A_PAPER)
    monkeypatch.setattr(PaperSchemes, "of", lambda _: paper)
    (found,) = whole.against_paper(X, [candidate(one) for one in LISTED], Sweeper())
    others = [candidate(one) for one in LISTED if one != papers]
    everything = whole._Whole(X, paper, Sweeper())._map_whole("all", others)
    assert found.paper.values["undamped"] > 0.0
    good = [one for one in everything if not one.misses(found.paper)]
    assert found.listed == len(everything) == len(LISTED) - 1
    assert found.as_good == bool(good)
    for name, count in found.ruled_out.items():
        assert count <= sum(name in one.misses(found.paper) for one in everything), name
    assert sum(found.ruled_out.values()) + len(found.measured) + found.open == found.listed
    assert found.as_good or found.open == 0, "none is as good only where nothing is open"


def test_without_damping_the_estimator_has_no_part() -> None:
    schemes = [one for one in LISTED if one.position_rate == 10_000]
    grid = whole.WallGrid(dampings=(0.0,), search=whole.search_for(X, "grid", ratio=1.5), offsets=(0.1,))
    first, *others = Sweeper().map_each("B = 0", [(X, one, grid) for one in schemes])
    assert len(others) == 3
    assert all(one.series == first.series for one in others)


def test_the_second_paper_is_held_to_its_table_one(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"STIFFNESSES": 2, "DAMPINGS": 2, "COLUMNS": 2}.items():
        monkeypatch.setattr(whole, name, value)
    short = {"realisations": 2, "settle_periods": 1, "periods": 2, "period_s": 0.2, "low_hz": 5.0}
    x = presets.load("chawda-linear")
    x = replace(x, excitation=replace(x.excitation, **short))
    paper = replace(PaperSchemes.of("chawda-linear"), schemes=PaperSchemes.of("chawda-linear").schemes[:1])
    monkeypatch.setattr(PaperSchemes, "of", lambda _: paper)
    filtered = Scheme.parse("uniform:1k,estimator=fdm-butterworth,cutoff_hz=100,order=1")
    schemes = (*paper.schemes, filtered, Scheme.parse("uniform:1k,estimator=fdm"))
    (found,) = whole.against_paper(x, [candidate(one) for one in schemes], Sweeper())
    assert set(found.paper.values) == {*rules.OF_A_PAPER, *rules.OF_TABLE_ONE}
    assert found.paper.misses(found.paper) == []
    assert found.paper.values["tuned"] == 1.0
    assert found.ruled_out["tuned"] == 1, "order 1 is a choice beside the cut-off"
    assert found.listed == 2, "the paper's own is not counted"
    assert found.measured[0].values["tuned"] == 0.0


def test_a_rig_of_no_paper_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"hapkit is not the rig of a paper.*chawda-linear"):
        PaperSchemes.of("hapkit")
