"""Pictures of maps: markers, a legend that names every mark, and no width of a single damping."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from rig.config import presets
from rig.config.schemes import Scheme
from rig.control.verdict import CRITERIA
from rig.experiments.mapping._kmax import KMax, kmax_plan
from rig.experiments.mapping._searches import StiffnessLimit, StiffnessSearch
from rig.experiments.mapping.zwidth import Boundary, MapPlan, ZWidth
from rig.extras.papers.disagreement.disagreement import DisagreementPlan
from rig.extras.papers.disagreement.plot import disagreement_figure
from rig.views.plots import style
from rig.views.plots.zwidth import kmax_figure, zwidth_figure
from tests.conformance.tiers import first_by_default
from tests.rig.views.conftest import check_axes

SEARCH = StiffnessSearch(lowest=10.0, highest=1000.0, ratio=1.1)
SCHEMES = ("uniform:20k", "dual:20k/2k", "uniform:2k")
FIVE = (0.0, 0.5, 1.0, 1.5, 2.0)
Limits = Callable[[int, float, str], Sequence[StiffnessLimit]]


def limit(
    stiffness: float, failed_at: float | None = 1000.0, *islands: tuple[float, float]
) -> StiffnessLimit:
    return StiffnessLimit(stiffness, failed_at, islands, 0)


def peak_limits(scheme: int, damping: float, criterion: str) -> Sequence[StiffnessLimit]:
    """Return limits that are highest in the corner in which a legend used to be."""
    heard = 0.9 if criterion == "heard" else 1.0
    return [limit(heard * (300.0 + 100.0 * scheme + 200.0 * damping + 10.0 * offset)) for offset in (0, 1)]


def mapped(plan: MapPlan, limits: Limits) -> ZWidth:
    boundaries = tuple(
        Boundary.of(number, damping, criterion, limits(number, damping, criterion))
        for number in range(len(plan.schemes))
        for damping in plan.dampings
        for criterion in CRITERIA
    )
    return ZWidth(plan, boundaries, 0, ())


def a_map(
    dampings: Sequence[float] = FIVE, limits: Limits = peak_limits, schemes: Sequence[str] = SCHEMES
) -> ZWidth:
    plan = MapPlan(
        experiment=presets.load("koul-compliant"),
        schemes=tuple(Scheme.parse(text) for text in schemes),
        dampings=tuple(dampings),
        search=SEARCH,
    )
    return mapped(plan, limits)


def over_rates(limits: Limits, rates: Sequence[int] = (1000, 5000, 20_000)) -> KMax:
    return KMax.of(mapped(kmax_plan(presets.load("koul-compliant"), SEARCH, rates=rates), limits))


def key(figure: Any) -> list[str]:
    """Return the texts of the one legend, which is outside of the panels."""
    assert not any(axes.get_legend() for axes in figure.axes)
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def marked(axes: Any) -> list[Any]:
    return [line for line in axes.lines if line.get_marker() == "o" and len(line.get_xdata())]


def test_every_measured_limit_is_marked_at_its_damping() -> None:
    found = a_map()
    for axes, criterion in zip(zwidth_figure(found).axes, ("felt", "heard"), strict=True):
        for number, line in enumerate(marked(axes)):
            limits = [boundary.stiffness for boundary in found.curve(number, criterion)]
            assert (list(line.get_xdata()), list(line.get_ydata())) == (list(FIVE), limits)
        assert len(marked(axes)) == len(SCHEMES)


def test_the_legend_names_the_marks_in_the_picture_and_no_others() -> None:
    plain = key(zwidth_figure(a_map(limits=lambda *_: [limit(300.0)])))
    assert len(plain) == len(SCHEMES)
    capped = key(zwidth_figure(a_map(limits=lambda *_: [limit(300.0, None)])))
    assert capped[len(SCHEMES) :] == ["no wall failed: the limit lies above"]
    islands = key(zwidth_figure(a_map(limits=lambda *_: [limit(300.0, 310.0, (400.0, 500.0))])))
    assert islands[len(SCHEMES) :] == ["island: stable walls beyond the limit"]
    band = key(zwidth_figure(a_map(limits=lambda *_: [limit(300.0), limit(400.0)])))
    assert band[len(SCHEMES) :] == ["from the lowest limit to the highest"]


def test_a_single_damping_is_no_width() -> None:
    figure = zwidth_figure(a_map([0.5]), theory={1: ([0.5, 0.5], [2500.0, 2500.0])})
    assert "Z-width" not in figure._suptitle.get_text()
    for axes in figure.axes:
        assert axes.get_xlabel() == "scheme, at B = 0.5 N·m·s/rad"
        assert [list(line.get_xdata()) for line in marked(axes)] == [[0.0], [1.0], [2.0]]  # beside each other
        assert axes.get_ylim()[1] > 2500.0


@pytest.mark.parametrize(
    ("some", "ending", "painted"),
    first_by_default(
        [
            ([limit(0.0, 10.0)], "png", 0),
            ([limit(300.0, None)], "svg", 1),
            ([limit(300.0), limit(300.0)], "pdf", 2),
        ]
    ),
)
def test_next_to_nothing_is_drawn(some: Any, ending: str, painted: int, tmp_path: Path) -> None:
    """Each kind of picture is composed with almost no data, and rendered once in each format."""
    maps = [zwidth_figure(a_map(dampings, lambda *_: some, SCHEMES[:1])) for dampings in ([0.0], [0.0, 0.1])]
    figures = [check_axes(one) for one in (*maps, kmax_figure(over_rates(lambda *_: some, [1000])))]
    assert style.save(figures[painted], tmp_path / f"x.{ending}").stat().st_size > 4000


def test_an_explained_map_has_a_panel_for_each_scheme_and_names_its_causes() -> None:
    plan = a_map((0.0, 0.5), schemes=SCHEMES[:2]).plan
    row = {"radius": 0.9, "holds_without": True, "hits": 1, "ticks": 1}
    fails = {**row, "holds": False, "cures": [["quantum"]]}
    holds = {**row, "holds": True, "cures": None}
    column = [{**(holds if k < 100.0 else fails), "stiffness": k} for k in plan.search.rungs]
    figure = disagreement_figure(DisagreementPlan(map=plan).found([column] * 4))
    assert "quantum" in key(figure)
    mesh = next(one for one in figure.axes[0].collections if hasattr(one, "get_coordinates"))
    seen = mesh.get_array().reshape(len(plan.search.rungs), 2, 4)[..., 3] > 0.0
    assert seen.tolist() == [[k >= 100.0] * 2 for k in plan.search.rungs], "agreement has no colour"
