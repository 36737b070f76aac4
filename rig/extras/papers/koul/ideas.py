"""Map each idea that Koul et al. leave open, on a rig with the normal hand, and rank the ideas by their gain.

The paper's ideas are an adaptive T2, other values of T2 (the velocity period), and finer encoders. This project adds
first-order extrapolation, other cut-offs, and all other velocity estimators in the dual-rate sampling scheme.
Estimators have their default settings and are not tuned for this rig, so a low rank is a rank of the defaults.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from itertools import takewhile
from typing import Any, Literal

from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.control import estimators
from rig.control.verdict import CRITERIA
from rig.core.deferred import integrate
from rig.experiments.mapping.interface import Width, ZWidth
from rig.extras.papers.koul.parts import DampingRange
from rig.extras.papers.koul.rigs import COMPLIANT, RIGID, HeldRig
from rig.extras.papers.rules import over

DUAL_RATES = "dual:20k/2k"
T2_RATES = ("500", "1k", "2k", "4k", "5k", "10k", "20k")
CUTOFFS_HZ = (50, 100, 200, 400, 800)
LINES = ((1000, 1), (1000, 4), (2000, 4), (8000, 4), (40_000, 4))
USUAL_LINES, FINEST_LINES = (1000, 4), (40_000, 4)
SAME = 0.05  # relative changes of an area up to this count as no change
REFERENCE = "reference"


@dataclass(frozen=True, slots=True, kw_only=True)
class Idea:
    """One idea for a larger Z-width: a sampling scheme on a rig with some changed settings.

    `key` is the idea's name in files, `group` its kind, `label` its text in tables.
    """

    key: str
    group: str
    label: str
    scheme: Scheme
    preset: str = COMPLIANT
    changes: Mapping[str, Any] = field(default_factory=dict)

    def experiment(self) -> Experiment:
        """Return the experiment that tests the idea: the rig in the normal hand, with the changed settings."""
        return HeldRig(preset=self.preset, grip="normal").experiment(self.changes)


@dataclass(frozen=True, slots=True)
class Tried:
    """Results of one idea for a larger Z-width.

    `ranges` is the largest damping of the softest wall, by ripple criterion (felt, heard, any). `linear` has peak
    stiffness and largest damping by linear theory; None if the sampling scheme is not linear.
    """

    idea: Idea
    map: ZWidth
    ranges: Mapping[str, DampingRange]
    linear: Mapping[str, Any] | None

    def width(self, criterion: str) -> Width:
        """Return peak stiffness, largest damping and area of the stable walls by one ripple (felt, heard, any)."""
        return self.map.width(0, criterion)

    def area(self, criterion: str) -> float:
        """Return the area (N·m/rad × N·m·s/rad) of the stable walls in the K–B plane, by one ripple criterion."""
        holds = list(takewhile(lambda b: b.stiffness > 0.0, self.map.curve(0, criterion)))
        corners = [(b.damping, b.stiffness) for b in holds]
        end = self.ranges[criterion].damping
        if corners and end > corners[-1][0]:
            corners.append((end, self.map.plan.search.lowest))
        if len(corners) < 2:
            return 0.0
        dampings, stiffnesses = zip(*corners, strict=True)
        return float(integrate.trapezoid(stiffnesses, dampings))

    def as_mapping(self) -> dict[str, Any]:
        """Return idea, limits, areas and ranges for JSON."""
        found = self.map.as_mapping()["schemes"][0]
        return {
            "group": self.idea.group,
            "label": self.idea.label,
            "rig": self.idea.preset,
            "scheme": self.idea.scheme.text,
            "changes": dict(self.idea.changes),
            "widths": found["widths"],
            "curves": found["curves"],
            "linear": None if self.linear is None else dict(self.linear),
            "areas": {criterion: self.area(criterion) for criterion in CRITERIA},
            "ranges": {criterion: asdict(self.ranges[criterion]) for criterion in CRITERIA},
        }


@dataclass(frozen=True, slots=True)
class Change:
    """Results of an idea divided by those of a reference idea: K at B = 0, largest K, largest B, and area."""

    undamped: float
    peak: float
    damping: float
    area: float

    @classmethod
    def of(cls, tried: Tried, reference: Tried) -> Change:
        """Divide the limits and area of one idea by those of a reference idea."""
        new, old = tried.width("any"), reference.width("any")
        return cls(
            over(new.stiffness_undamped or 0.0, old.stiffness_undamped or 0.0),
            over(new.stiffness_peak, old.stiffness_peak),
            over(tried.ranges["any"].damping, reference.ranges["any"].damping),
            over(tried.area("any"), reference.area("any")),
        )


def direction(changes: Iterable[Change]) -> Literal["wider", "narrower", "same", "both"]:
    """Return how all changes affect the area of stable walls: "wider", "narrower", "same" (within 5 %), else "both"."""
    areas = [change.area for change in changes]
    if all(area > 1.0 + SAME for area in areas):
        return "wider"
    if all(area < 1.0 - SAME for area in areas):
        return "narrower"
    return "same" if all(abs(area - 1.0) <= SAME for area in areas) else "both"


def encoder_key(preset: str, scheme: str, lines: tuple[int, int]) -> str:
    """Return the key of the idea to use an encoder with `lines` (per turn, decoding factor) in a sampling scheme."""
    if (preset, scheme, lines) == (COMPLIANT, "dual", USUAL_LINES):
        return REFERENCE
    return f"encoder-{preset}-{scheme}-{lines[0]}x{lines[1]}"


def ideas() -> tuple[Idea, ...]:
    """Return all ideas for a larger Z-width; the first is the paper's dual-rate wall, the reference."""
    return (
        Idea(key=REFERENCE, group=REFERENCE, label="the paper's dual rate", scheme=Scheme.parse(DUAL_RATES)),
        *_prediction(),
        *_adaptive(),
        *_encoders(),
        *_velocity_rates(),
        *_cutoffs(),
        *_estimators(),
    )


def _prediction() -> list[Idea]:
    scheme = Scheme.parse(f"{DUAL_RATES},prediction=extrapolate")
    return [Idea(key="extrapolate", group="extrapolation", label="extrapolated velocity", scheme=scheme)]


def _adaptive() -> list[Idea]:
    """Return ideas with the paper's adaptive velocity period T2, which is longer while the handle is slow."""
    return [
        Idea(
            key=f"adaptive-{fast}-{slow}",
            group="adaptive T2",
            label=f"T2 of {_hertz(fast)}, {slow} Hz below {below} rad/s",
            scheme=Scheme.parse(f"dual:20k/{fast},slow_velocity_rate={slow},slow_below={below}"),
        )
        for fast, slow, below in (("5k", 1000, 0.2), ("2k", 1000, 0.2), ("2k", 500, 0.2))
    ]


def _encoders() -> list[Idea]:
    tried = []
    for preset in (COMPLIANT, RIGID):
        for name, text in (("dual", DUAL_RATES), ("uniform", "uniform:20k")):
            for lines, decoding in LINES:
                key = encoder_key(preset, name, (lines, decoding))
                if key == REFERENCE:
                    continue
                if preset == RIGID and (lines, decoding) not in (USUAL_LINES, LINES[-1]):
                    continue
                tried.append(
                    Idea(
                        key=key,
                        group="encoder",
                        label=f"{name}, {lines} × {decoding}",
                        scheme=Scheme.parse(text),
                        preset=preset,
                        changes={
                            "rig.encoder.counts_per_revolution": lines,
                            "rig.encoder.decoding": decoding,
                        },
                    )
                )
    return tried


def _velocity_rates() -> list[Idea]:
    return [
        Idea(
            key=f"rate-{rate}",
            group="T2",
            label=f"velocity at {_hertz(rate)}",
            scheme=Scheme.parse(f"uniform:{rate}" if rate == "20k" else f"dual:20k/{rate}"),
        )
        for rate in T2_RATES
        if rate != "2k"
    ]


def _hertz(rate: str) -> str:
    return f"{rate.removesuffix('k')} {'k' if rate.endswith('k') else ''}Hz"


def _cutoffs() -> list[Idea]:
    return [
        Idea(
            key=f"cutoff-{cutoff}",
            group="cut-off",
            label=f"cut-off {cutoff} Hz",
            scheme=Scheme.parse(f"{DUAL_RATES},cutoff_hz={cutoff}"),
        )
        for cutoff in CUTOFFS_HZ
        if cutoff != 200
    ]


def _estimators() -> list[Idea]:
    return [
        Idea(
            key=f"estimator-{name}",
            group="estimator",
            label=name,
            scheme=Scheme.parse(f"{DUAL_RATES},estimator={name}"),
        )
        for name in estimators.names()
        # The reference itself, and an observer that is unstable at this velocity rate (2 kHz; 3.4 kHz is the lowest).
        if name not in {"fdm-butterworth", "disturbance-two-mass"}
    ]


def rank_ideas(tried: Mapping[str, Tried], criterion: str = "any") -> list[Tried]:
    """Return the ideas on the paper's rig, largest area of stable walls (judged by `criterion`) first."""
    on_rig = [one for one in tried.values() if one.idea.preset == tried[REFERENCE].idea.preset]
    return sorted(on_rig, key=lambda one: (-one.area(criterion), one.idea.key))
