"""Compute and draw the gains with which Levant's differentiator converges (Fig. 1 of Chawda et al., extended)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.control.estimators import levant_regions as regions
from rig.views.plots import style

LARGEST_MU1, LARGEST_MU2 = 10.0, 6.0
_POINTS = 121

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LevantRegions:
    """Boundaries of the gains with which Levant's differentiator converges, in μ1 = α/C and μ2 = λ/√C.

    Attributes
    ----------
    hba_mu1, lfba_mu1
        Smallest μ1 at each `mu2` by the homogeneity-based (HBA) and by the Lyapunov-function-based approach (LFBA),
        shape (n,); infinite where no μ1 is allowed.
    worst_case_mu2
        Smallest μ2 at each `mu1` with which the estimation error shrinks in every half cycle, found numerically.
    """

    mu2: Floats
    hba_mu1: Floats
    lfba_mu1: Floats
    mu1: Floats
    worst_case_mu2: Floats

    def as_mapping(self) -> dict[str, Any]:
        """Return the boundaries and the named gains as lists and numbers for JSON (infinite values: null)."""
        return {
            "parameters": "alpha = mu1 * C, lambda = mu2 * sqrt(C)",
            "crossing": dict(zip(("mu1", "mu2"), regions.find_crossing(), strict=True)),
            "named": {
                name: {
                    "mu1": mu1,
                    "mu2": mu2,
                    "in_hba": regions.in_hba(mu1, mu2),
                    "in_lfba": regions.in_lfba(mu1, mu2),
                    "half_cycle_contraction": regions.half_cycle_contraction(mu1, mu2),
                }
                for name, (mu1, mu2) in regions.NAMED_GAINS.items()
            },
            "mu2": self.mu2.tolist(),
            "hba_mu1": self.hba_mu1.tolist(),
            "lfba_mu1": self.lfba_mu1.tolist(),
            "numeric": {"mu1": self.mu1.tolist(), "worst_case_mu2": self.worst_case_mu2.tolist()},
        }


def levant_regions() -> LevantRegions:
    """Compute the boundaries of the gains with which Levant's differentiator converges, for μ1 ≤ 10 and μ2 ≤ 6."""
    mu2 = np.linspace(0.0, LARGEST_MU2, _POINTS)
    mu1 = 1.0 + np.geomspace(0.02, LARGEST_MU1 - 1.0, _POINTS // 2)
    return LevantRegions(
        mu2,
        np.array([regions.hba_mu1(m) for m in mu2]),
        np.array([regions.lfba_mu1(m) for m in mu2]),
        mu1,
        np.array([regions.worst_case_mu2(m) for m in mu1]),
    )


@style.own_style()
def draw_levant_regions(computed: LevantRegions, picture: str | Path) -> Path:
    """Draw the gains with which Levant's differentiator converges, by both proofs and numerically; return the path."""
    figure = style.new_figure(7.0, 5.0)
    axes = figure.subplots()
    for bound, colour, label in (
        (computed.hba_mu1, style.MEASURED, "HBA, equation (10)"),
        (computed.lfba_mu1, style.OTHER, "LFBA, equation (14)"),
    ):
        inside = np.isfinite(bound)
        lower = np.minimum(bound[inside], LARGEST_MU1)
        axes.fill_between(computed.mu2[inside], lower, LARGEST_MU1, color=colour, alpha=0.25, linewidth=0)
        axes.plot(computed.mu2[inside], bound[inside], color=colour, linewidth=1.2, label=label)
    axes.plot(
        computed.worst_case_mu2,
        computed.mu1,
        color=style.SENT,
        linewidth=1.0,
        linestyle="--",
        label="numeric: converges to the right and above",
    )
    _mark(axes, *regions.find_crossing(), "crossing", "o", (6, 6))
    for i, (name, (mu1, mu2)) in enumerate(regions.NAMED_GAINS.items()):
        # Alternate labels above and below the marker, because neighbouring labels overlap otherwise.
        _mark(axes, mu1, mu2, name, "s", (6, -14 if i % 2 == 0 else 6))
    axes.set_xlim(0.0, LARGEST_MU2)
    axes.set_ylim(0.0, LARGEST_MU1)
    axes.set_xlabel("μ2 = λ/√C")
    style.tidy(axes, "μ1 = α/C")
    axes.legend(loc="upper right", fontsize=8)
    axes.set_title("Gains with which Levant's differentiator converges", fontsize=11)
    return style.save(figure, Path(picture))


def _mark(axes: Any, mu1: float, mu2: float, name: str, marker: str, offset: tuple[int, int]) -> None:
    axes.plot([mu2], [mu1], marker, color="#333333", markersize=5)
    label = f"{name} ({mu1:.5g}, {mu2:.5g})"
    axes.annotate(label, (mu2, mu1), xytext=offset, textcoords="offset points", fontsize=8)
