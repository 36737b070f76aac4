"""The section on the ideas that Koul et al. leave open: one sentence of answer for each, made of its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rig.control.verdict import CRITERIA
from rig.papers.frame import Picture, Section, Table, over, shown
from rig.papers.koul.ideas import REFERENCE, USUAL_LINES, Tried, ranked
from rig.papers.koul.results import Koul
from rig.papers.koul.rigs import COMPLIANT, NAMES, PRESETS, RIGID
from rig.papers.koul.words import SAME, at_least, how, peak_of, signed, word


@dataclass(frozen=True, slots=True)
class _Change:
    """What an idea changes against another: ratios of K at B = 0, peak, range and area, criterion any."""

    undamped: float
    peak: float
    damping: float
    area: float

    @classmethod
    def of(cls, tried: Tried, reference: Tried) -> _Change:
        new, old = tried.width("any"), reference.width("any")
        return cls(
            over(new.stiffness_undamped or 0.0, old.stiffness_undamped or 0.0),
            over(new.stiffness_peak, old.stiffness_peak),
            over(tried.ranges["any"].damping, reference.ranges["any"].damping),
            over(tried.area("any"), reference.area("any")),
        )

    def __str__(self) -> str:
        return f"peak {signed(self.peak)}, range {signed(self.damping)}, area {signed(self.area)}"


def answers(koul: Koul) -> dict[str, str]:
    """One sentence for each idea, made of its numbers."""
    tried, reference = koul.ideas, koul.ideas[REFERENCE]
    groups: dict[str, list[Tried]] = {}
    for one in tried.values():
        groups.setdefault(one.idea.group, []).append(one)
    change = {one.idea.key: _Change.of(one, reference) for one in tried.values()}
    said = {
        "extrapolation": f"First-order extrapolation of velocity: {change['extrapolate']}"
        + _linear_change(tried["extrapolate"], reference)
        + ".",
        "adaptive T2": "Adaptive T2 "
        + word([change[one.idea.key].area for one in groups["adaptive T2"]])
        + " the Z-width: "
        + "; ".join(f"{one.idea.label}: {change[one.idea.key]}" for one in groups["adaptive T2"])
        + ".",
        "T2": "T2: " + _best("velocity rate", [*groups["T2"], reference], reference),
        "cut-off": "Cut-off: " + _best("cut-off", [*groups["cut-off"], reference], reference),
        "encoder": _encoder_answer(tried, reference),
        "estimator": "Estimators by their defaults: "
        + _best("estimator", [*groups["estimator"], reference], reference),
    }
    return said


def _linear_change(tried: Tried, reference: Tried) -> str:
    if tried.linear is None or reference.linear is None:
        return ""
    peak, damping = (over(tried.linear[name], reference.linear[name]) for name in ("peak", "range"))
    return f" (linear theory: peak {signed(peak)}, range {signed(damping)})"


def _best(what: str, among: Sequence[Tried], reference: Tried) -> str:
    best = max(among, key=lambda one: one.area("any"))
    change = _Change.of(best, reference)
    if best is reference or change.area < 1.0 + SAME:
        better = "" if best is reference else f" ({best.idea.label} comes to {signed(change.area)} of area)"
        return f"no {what} tried widens the Z-width by more than {100 * SAME:.0f} %{better}."
    wider = sum(_Change.of(one, reference).area > 1.0 + SAME for one in among)
    return (
        f"{wider} of {len(among) - 1} tried widen the Z-width by more than {100 * SAME:.0f} %, most of all "
        f"{best.idea.label}: {change}."
    )


def _encoder_answer(tried: Mapping[str, Tried], reference: Tried) -> str:
    finest = "40000x4"
    usual = f"{USUAL_LINES[0]}x{USUAL_LINES[1]}"

    def of(preset: str, scheme: str, lines: str) -> Tried:
        if (preset, scheme, lines) == (COMPLIANT, "dual", usual):
            return reference
        return tried[f"encoder-{preset}-{scheme}-{lines}"]

    said = []
    for preset in PRESETS:
        dual, fast = of(preset, "dual", finest), of(preset, "uniform", finest)
        ratio = over(fast.area("any"), dual.area("any"))
        said.append(
            f"on {NAMES[preset]} 40000 × 4 gives the dual-rate wall {_Change.of(dual, of(preset, 'dual', usual))}, "
            f"and the uniform 20 kHz wall then has {shown(ratio)} times its area"
            + (" (dual-rate is not needed there)" if ratio >= 1.0 else "")
        )
    return "Encoder: " + "; ".join(said) + "."


def ideas(koul: Koul) -> Section:
    """Everything that was tried, ranked."""
    reference = koul.ideas[REFERENCE]
    order = [*ranked(koul.ideas), *(t for t in koul.ideas.values() if t.idea.preset != reference.idea.preset)]
    rows = []
    for tried in order:
        widths = {criterion: tried.width(criterion) for criterion in CRITERIA}
        on = "" if tried.idea.preset == COMPLIANT else f", {tried.idea.preset}"
        rows.append(
            (
                f"{tried.idea.group}: {tried.idea.label}{on}",
                shown(widths["any"].stiffness_undamped),
                *(peak_of(widths[criterion]) for criterion in CRITERIA),
                *(at_least(tried.ranges[c].damping, tried.ranges[c].capped) for c in CRITERIA),
                shown(tried.area("any")),
                *(shown(None if tried.linear is None else tried.linear[name]) for name in ("peak", "range")),
                signed(over(tried.area("any"), reference.area("any"))) if not on else "",
            )
        )
    head = (
        "idea",
        "K at B = 0",
        *(f"peak K, {c}" for c in CRITERIA),
        *(f"range of B, {c}" for c in CRITERIA),
        "area",
        "peak K, linear",
        "range of B, linear",
        "area against the paper's",
    )
    plan = reference.map.plan
    highest = max(tried.map.plan.search.highest for tried in koul.ideas.values())
    return Section(
        key="ideas",
        title="Ideas tried",
        text=tuple(answers(koul).values()),
        conditions=(
            f"{NAMES[COMPLIANT]} (and {RIGID} where it says so), normal hand; {how(reference.map)}. "
            f"Ranked by the area of the "
            "walls neither felt nor heard nor moved.",
            "Estimators, none tuned for this rig: defaults and a cut-off of a tenth of the rate where they have one.",
            f"Finer encoders are searched up to {highest:.4g} N·m/rad, "
            f"1000 × 4 up to {plan.search.highest:.4g}; ≥: caps.",
        ),
        pictures=(
            Picture("ranking", "Area of the Z-width; black: the dual-rate wall of the paper."),
            Picture("ideas", "Limits over damping; black: the dual-rate wall of the paper."),
        ),
        tables=(Table("K in N·m/rad, B in N·m·s/rad", head, tuple(rows)),),
    )
