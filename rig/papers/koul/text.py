"""Sections of the report on Koul et al.: what each picture shows, in sentences made of the numbers beside it."""

from __future__ import annotations

from collections.abc import Sequence

from rig.control.verdict import CRITERIA
from rig.experiments.zwidth import ZWidth
from rig.papers.frame import Claim, Picture, Section, Status, Table, shown
from rig.papers.koul import text_ideas as koul_text_ideas
from rig.papers.koul import text_theory as koul_text_theory
from rig.papers.koul import ways as koul_ways
from rig.papers.koul.compare import FIXED, STATE_BITS
from rig.papers.koul.results import Koul
from rig.papers.koul.rigs import (
    COMPLIANT,
    DUAL,
    FAST,
    FAST_1K,
    HELD,
    LABELS,
    LAGS,
    LOWEST_STIFFNESS,
    MAIN,
    NAMES,
    PRESETS,
    PUSH_EFFORT,
    PUSH_START,
    RIGID,
    SCHEMES,
    SLOW,
    WITH_LAG,
    WITHOUT_LAG,
)
from rig.papers.koul.rules import NULL
from rig.papers.koul.words import FLOAT, JUDGED, ORDER, at_least, growth, how, offsets, peak_of, percent


def summary(koul: Koul, claims: Sequence[Claim]) -> tuple[str, ...]:
    """What stands first."""
    count = {status: sum(c.finding.status is status for c in claims) for status in Status}
    return (
        f"Of {len(claims)} claims {count[Status.REPRODUCED]} are reproduced, {count[Status.ONLY_WITH]} only under a "
        f"condition, {count[Status.NOT]} are not. Every verdict is computed from the numbers of this run by the rule "
        "beside it.",
        f"{koul.hits} simulated wall hits on two rigs: {RIGID}, of which nothing is fitted, and {COMPLIANT}, which "
        "was fitted on the paper's own stability limits, so that agreement of its absolute numbers confirms nothing.",
    )


def sections(koul: Koul) -> tuple[Section, ...]:
    """All sections in the order of the report."""
    return (
        _figure_5(koul),
        *(_figure_6(koul, preset) for preset in PRESETS),
        _hands(koul),
        _ways(koul),
        _figure_7(koul),
        _figure_8(koul),
        koul_text_theory.theory(koul),
        koul_text_theory.effects(koul),
        koul_text_theory.plants(koul),
        koul_text_ideas.ideas(koul),
    )


def _figure_5(koul: Koul) -> Section:
    rates, rows, said = koul.scale.rates, [], []
    for preset in PRESETS:
        for lag in LAGS:
            found, linear = koul.kmax[preset, lag], koul.kmax_theory[preset, lag]
            for criterion in ("felt", "any"):
                cells = [at_least(b.stiffness, bool(b.capped)) for b in found.curve(criterion)]
                rows.append((f"{NAMES[preset]}, {lag}, {criterion}", *cells))
            rows.append((f"{NAMES[preset]}, {lag}, linear theory", *(shown(k) for k in linear)))
        ratios = [koul.kmax[preset, lag].saturation("any") for lag in (WITH_LAG, WITHOUT_LAG)]
        linear_ratios = [growth(koul.kmax_theory[preset, lag], rates) for lag in (WITH_LAG, WITHOUT_LAG)]
        said.append(
            f"{NAMES[preset]}: from 20 to 50 kHz the limit grows by a factor {shown(ratios[0])} with the electrical "
            f"lag and {'beyond the search' if ratios[1] is None else 'by ' + shown(ratios[1])} without it "
            f"(linear theory {shown(linear_ratios[0])} and {shown(linear_ratios[1])})."
        )
    return Section(
        key="figure-5",
        title="Fig. 5: the stiffest undamped wall over the sampling rate",
        text=tuple(said),
        conditions=(
            f"Normal hand, B = 0, bisection with rungs {percent(koul.scale.kmax_ratio)} apart, {offsets(koul)}; "
            "≥: the limit lies beyond the highest stiffness in which the push rests two counts deep.",
            JUDGED,
        ),
        pictures=(Picture("figure-5", "Largest stable stiffness at B = 0 against 1/T1."),),
        tables=(Table("K_max (N·m/rad)", ("rig", *(f"{rate / 1e3:g} kHz" for rate in rates)), tuple(rows)),),
    )


def _figure_6(koul: Koul, preset: str) -> Section:
    held = next(h for h in MAIN if h.preset == preset)
    found = koul.maps[held.name]
    dual, fast, slow = (found.width(ORDER.index(key), "any") for key in (DUAL, FAST, SLOW))
    text: tuple[str, ...] = (
        f"Stiffest walls at their best damping: dual-rate {peak_of(dual)} N·m/rad, "
        f"uniform 20 kHz {peak_of(fast)}, uniform 2 kHz {peak_of(slow)}. "
        f"Ranges of damping of the softest wall ({LOWEST_STIFFNESS:g} N·m/rad): "
        + ", ".join(f"{LABELS[key]} {shown(koul.ranges[held.name][key]['any'].damping)}" for key in SCHEMES)
        + " N·m·s/rad.",
    )
    linear = {key: koul.linear[held.name][key]["peak"] for key in (DUAL, FAST, FAST_1K)}
    narrow = found.width(ORDER.index(FAST_1K), "any")
    text += (
        f"Whether dual-rate is stiffer at its best hangs on the cut-off of the uniform 20 kHz wall, "
        f"which the paper leaves "
        f"open: with 2 kHz that one reaches {peak_of(fast)} N·m/rad (linear theory {shown(linear[FAST])}), with 1 kHz "
        f"{peak_of(narrow)} ({shown(linear[FAST_1K])}); dual-rate {peak_of(dual)} ({shown(linear[DUAL])}).",
    )
    return Section(
        key=f"figure-6-{preset}",
        title=f"Fig. 6: Z-width on {NAMES[preset]}",
        text=text,
        conditions=(how(found), JUDGED, FLOAT),
        pictures=(
            Picture(
                f"figure-6-{preset}",
                "Mean limits over offsets; bands reach from the lowest to the highest; bars are islands; triangles "
                "limits that are caps; dashed, linear theory.",
            ),
        ),
        tables=(_width_table(koul, held.name, found),),
    )


def _width_table(koul: Koul, name: str, found: ZWidth) -> Table:
    rows = []
    for number, key in enumerate(ORDER):
        for criterion in CRITERIA:
            width = found.width(number, criterion)
            limit = koul.ranges[name][key][criterion]
            rows.append(
                (
                    LABELS[key],
                    criterion,
                    shown(width.stiffness_undamped),
                    peak_of(width),
                    shown(width.damping_at_peak),
                    at_least(limit.damping, limit.capped),
                    shown(width.area),
                )
            )
        linear = koul.linear[name][key]
        rows.append(
            (
                LABELS[key],
                "linear theory",
                shown(linear["undamped"]),
                shown(linear["peak"]),
                "",
                shown(linear["range"]),
                "",
            )
        )
    head = ("scheme, cut-off", "criterion", "K at B = 0", "peak K", "at B", "range of B", "area")
    return Table("K in N·m/rad, B in N·m·s/rad", head, tuple(rows))


def _hands(koul: Koul) -> Section:
    rows, said = [], []
    for preset in PRESETS:
        peaks = []
        for held in (h for h in HELD if h.preset == preset):
            found, ranges = koul.maps[held.name], koul.ranges[held.name]
            widths = {key: found.width(ORDER.index(key), "any") for key in SCHEMES}
            dual, slow = (ranges[key]["any"] for key in (DUAL, SLOW))
            peaks.append(widths[DUAL].stiffness_peak)
            rows.append(
                (
                    f"{NAMES[preset]}, {held.push}",
                    shown(widths[DUAL].stiffness_undamped),
                    *(peak_of(widths[key]) for key in (DUAL, FAST, SLOW)),
                    *(at_least(r.damping, r.capped) for r in (dual, ranges[FAST]["any"], slow)),
                )
            )
        said.append(
            f"{NAMES[preset]}: who pushes moves the dual-rate peak between {shown(min(peaks))} and {shown(max(peaks))} "
            "N·m/rad."
        )
    head = (
        "who pushes",
        "dual K at B = 0",
        "peak dual",
        "peak 20 kHz",
        "peak 2 kHz",
        "range dual",
        "range 20 kHz",
        "range 2 kHz",
    )
    return Section(
        key="hands",
        title="Three hands and none",
        text=(
            *said,
            "A wall that holds in one hand need not hold in another: no verdict here is from one hand alone.",
        ),
        conditions=(
            f"Automated: {PUSH_EFFORT:g} N·m through the motor, 70 g at the handle, from "
            f"{1e3 * PUSH_START:g} mrad; its undamped walls have no hand to quiet them. Ladder, rungs "
            f"{percent(koul.scale.ratio**1.5)} apart and one encoder offset but for the normal hand.",
            "A relaxed hand presses less, so that its stiffest walls are caps (≥) sooner: "
            "two counts is the shallowest rest that is trusted.",
        ),
        pictures=(Picture("hands", "Walls neither felt nor heard nor moved."),),
        tables=(Table("criterion any; K in N·m/rad, B in N·m·s/rad", head, tuple(rows)),),
    )


def _ways(koul: Koul) -> Section:
    found = koul.maps[MAIN[0].name]
    rows, islands, higher = [], 0, 0
    for number, key in enumerate(ORDER):
        for criterion in ("felt", "any"):
            columns = [
                column
                for offset in found.plan.offsets
                for column in koul_ways.columns(found, number, criterion, offset=offset)
            ]
            with_islands = [c for c in columns if c.islands]
            other = [c for c in columns if c.bisection > c.ladder]
            islands, higher = islands + len(with_islands), higher + len(other)
            dampings = [c.damping for c in columns if c.highest > 0.0]
            ladder = [c.damping for c in columns if c.ladder > 0.0]
            rows.append(
                (
                    LABELS[key],
                    criterion,
                    f"{len(with_islands)} of {len(columns)}",
                    f"{len(other)} of {len(columns)}",
                    shown(max(ladder, default=0.0)),
                    shown(max(dampings, default=0.0)),
                )
            )
    head = (
        "scheme, cut-off",
        "criterion",
        "columns with islands",
        "bisection ends higher",
        "largest B, ladder",
        "largest B, grid",
    )
    return Section(
        key="ways",
        title="Ladder, bisection and grid",
        text=(
            f"Stability is {'not ' if islands else ''}monotone in K here: {islands} columns of the "
            f"grid have stiffer walls "
            f"that hold beyond one that fails. In {higher} a bisection ends above the ladder of the paper.",
        ),
        conditions=(how(found), "Ladder and bisection are read off the hits of the grid."),
        pictures=(Picture("ways", f"{NAMES[COMPLIANT]}, normal hand, criterion any, first encoder offset."),),
        tables=(Table("by damping and encoder offset", head, tuple(rows)),),
    )


def _figure_7(koul: Koul) -> Section:
    rows = []
    for panel in koul.figure_7:
        cells = []
        for name in ("none", "uniform", "dual"):
            outcome = panel.comparison[name]
            cells.append(f"{outcome.numbers.peak:.2f} ({outcome.peaks[0]:g} … {outcome.peaks[1]:g})")
        rows.append((f"{panel.position_rate / 1e3:g} kHz, {panel.arithmetic}", *cells))
    words = [
        (
            f"{row['state_bits']}",
            f"fs/{1 / row['uniform_share']:g}",
            *(
                " / ".join(shown(row[kind][rate]) for kind in ("none", "uniform", "dual"))
                for rate in ("20000", "10000")
            ),
            " / ".join(f"{100 * row['read']['20000'][part]:.0f}" for part in ("early", "late")),
            "yes" if row["as_in_the_paper"] else "no",
        )
        for row in koul.words
    ]
    like = [f"{row[0]} bits with {row[1]}" for row in words if row[-1] == "yes"]
    tried = len(words)
    return Section(
        key="figure-7",
        title="Fig. 7: penetration after the first impact",
        text=(
            f"Of {tried} word lengths and cut-offs, {len(like)} order the peaks as the paper does"
            + (f": {', '.join(like)}." if like else "."),
            "In floating point " + _float_peaks(koul) + " The paper does not give its word length.",
        ),
        conditions=(
            "koul-rigid, no hand, 70 g at the handle, K 40 N·m/rad, B 0.2 N·m·s/rad, 60 mN·m on the link, from −2 mrad "
            f"at 1.5 rad/s, ×4 decoding; mean over encoder offsets {', '.join(map(str, koul.scale.impact_offsets))}; "
            "fixed point: 14-bit coefficients, 4 fractional bits of state, truncation to zero, uniform cut-off fs/20.",
            "As in the paper: at 20 kHz the uniform peak is at least 0.95 of the undamped one, at 10 kHz it is between "
            "the others by 10 %, and the dual-rate one is at most 0.6 of the undamped one at both.",
        ),
        pictures=(
            Picture(
                "figure-7", "Encoder counts inside the wall after the first contact, one encoder offset."
            ),
        ),
        tables=(
            Table(
                "peak penetration in counts: mean (over the offsets)",
                ("panel", "none", "uniform", "dual"),
                tuple(rows),
            ),
            Table(
                "word lengths: none / uniform / dual, counts",
                (
                    "state bits",
                    "uniform cut-off",
                    "20 kHz",
                    "10 kHz",
                    "read at 20 kHz (%): early / late",
                    "as in the paper",
                ),
                tuple(words),
            ),
        ),
    )


def _float_peaks(koul: Koul) -> str:
    said = []
    for panel in koul.figure_7:
        if panel.arithmetic == "floating point":
            none, uniform, dual = panel.peaks
            said.append(
                f"the uniform wall at {panel.position_rate / 1e3:g} kHz stops {100 * (1 - uniform / none):.0f} % "
                f"short of the undamped one, the dual-rate wall {100 * (1 - dual / none):.0f} %"
            )
    return " and ".join(said) + "."


def _figure_8(koul: Koul) -> Section:
    profiles = koul.figure_8
    rows = [
        (
            f"{p.velocity_rate / 1e3:g} kHz, {p.arithmetic}, cut-off {p.cutoff_hz:g} Hz",
            "–" if p.delay_s is None else f"{1e3 * p.delay_s:.3f}",
            shown(p.noise_early),
            shown(p.noise_late),
            f"{100 * p.reading_early:.0f}",
            f"{100 * p.reading_late:.0f}",
        )
        for p in profiles.profiles
    ]
    said = []
    words = f" ({STATE_BITS} bits of state)"
    for arithmetic in dict.fromkeys(p.arithmetic for p in profiles.profiles):
        fast, slow = profiles[20_000, arithmetic], profiles[2000, arithmetic]
        said.append(
            f"In {arithmetic}{words if arithmetic == FIXED else ''} the 20 kHz estimate shows "
            f"{100 * fast.reading_early:.0f} % of the true velocity early in the impact and "
            f"{100 * fast.reading_late:.0f} % late (2 kHz: {100 * slow.reading_early:.0f} % and "
            f"{100 * slow.reading_late:.0f} %)."
        )
    said.append(
        "One encoder count adds to the velocity, rms in floating point: "
        + ", ".join(f"{name} {shown(noise)} rad/s" for name, noise in koul.noise.items())
        + "."
    )
    null = [row for row in koul.words if row["read"]["20000"]["late"] <= NULL]
    early = max((row["read"]["20000"]["early"] for row in null), default=0.0)
    said.append(
        f"Of {len(koul.words)} word lengths and cut-offs {len(null)} read at most {100 * NULL:.0f} % "
        f"late in the impact; early in it they read at most {100 * early:.0f} %"
        + (": what takes the slow velocity away takes the fast one too." if null and early <= NULL else ".")
    )
    head = (
        "estimate",
        "delay (ms)",
        "error early (rad/s)",
        "error late (rad/s)",
        "read early (%)",
        "read late (%)",
    )
    return Section(
        key="figure-8",
        title="Fig. 8: velocity early and late in the impact",
        text=tuple(said),
        conditions=(
            "The motion of the undamped wall of Fig. 7 at 20 kHz, seen by four estimators that do "
            "not act on it; errors "
            "against the truth delayed by each one's own delay. No hand.",
        ),
        pictures=(Picture("figure-8", "Grey: true velocity."),),
        tables=(Table("rms", head, tuple(rows)),),
    )
