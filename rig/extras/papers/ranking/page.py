"""Write the page *Which estimator and which law, on which rig?* from results of the ranking.

`rig estimators rank` and the builder of documents use it. Every number of the page comes from the results, the rule,
the counted cycles, or notes with their commands; this file must not run a hit.
"""

import math
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path

from firmware_protocol.codegen import table
from rig import config
from rig.core.sample import unit_of
from rig.extras.papers.ranking import rule
from rig.extras.papers.ranking.compare import Ratio, RigResults, scores, stability
from rig.extras.papers.ranking.rule import PLAIN, Ground, Pair
from rig.firmware.tick_budget import TICKS

COMMAND = "rig estimators rank"
USUAL, DUAL = Pair("fdm-butterworth").name, Pair("fdm-butterworth", dual=True).name
WIDTH, NOTES = 120, Path(__file__).parent / "notes.md"  # on all rigs together
HANDS = {"none": "no hand", **{grip: f"{grip} grip" for grip in rule.GRIPS}}
ENTRY = '''```python
import rig


@rig.estimator(
    parameters={"bandwidth_hz": rig.Parameter(default=200.0, minimum=1.0, maximum=1e4, unit="Hz")},
    memory=("late", "velocity"),
)
def alpha_beta(travel: float, elapsed_s: float, memory: rig.Memory, p: rig.Parameters) -> float:
    """Position and velocity, corrected by the difference to the count: critically damped."""
    keep = 1.0 / (1.0 + 6.283185307179586 * p.bandwidth_hz * elapsed_s)
    ahead = memory.late + travel - memory.velocity * elapsed_s
    memory.velocity += (1.0 - keep) ** 2 * ahead / elapsed_s
    memory.late = keep**2 * ahead
    return memory.velocity
```'''


def page(results: Sequence[RigResults]) -> str:
    """Return the page of results in Markdown."""
    return "\n\n".join(_blocks(results)) + "\n"


def _blocks(results: Sequence[RigResults]) -> Iterator[str]:
    delays = results[0].delays
    yield "# Which estimator and which law, on which rig?"
    yield f"<!-- made by `{COMMAND}`: do not edit -->"
    missing = [name for name in rule.RIGS if name not in {result.rig for result in results}]
    new = {
        f"{pair} on {result.rig}, delay {delay}"
        for result in results
        for delay in delays
        for pair in result.recommended(delay)
        if is_new(pair)
    }
    yield _paragraph(
        "Simulated hits, judged by the rule of [decision 0019](../../decisions/0019-how-estimators-are-ranked.md), "
        "which was committed before any result. A wall counts if its commanded effort is not heard and its stiffness "
        "and damping are rendered as commanded. Each number stands for a rig and eight variations of it "
        "(±20 % of its parameters; the estimator keeps those of the rig) at three encoder offsets. "
        "No board was powered for this page."
    )
    yield _paragraph(
        f"Measured: {', '.join(result.rig for result in results)}"
        + (f"; not measured: {', '.join(missing)}" if missing else "")
        + ". Left out: smartknob, whose motor cannot hold the press of a relaxed and of a firm grip"
        + f". Pairs: {len(max((result.pairs for result in results), key=len))} of estimator and law. Delays: "
        f"{', '.join(delays)} ticks. The command, which resumes from its journal:"
    )
    yield f"<!-- not run: about 40 minutes of one core -->\n```sh\n{COMMAND}\n```"
    yield "## Answer"
    yield _paragraph(
        "A pair is recommended where it wins or ties against the best other one without a hand and in all three "
        f"grips, and wins in at least one. It wins if its area is more than {rule.WIN:g} times as large and the "
        f"{100 * rule.CONFIDENCE:g} % interval lies above 1. Where none is recommended, the pairs that never lose "
        "are equally good by this rule: take the cheapest."
    )
    yield table(
        ["rig", *(f"delay {delay}" for delay in delays)],
        ([result.rig, *(_recommendation(result, delay) for delay in delays)] for result in results),
    )
    notes = [] if missing else NOTES.read_text(encoding="utf-8").strip().split("\n\n")
    yield from notes[:1]
    yield _paragraph(
        "`rig design` may recommend a tracking loop, a disturbance observer or another law only where this table does: "
        + ("; ".join(sorted(new)) if new else "nowhere")
        + ". A pair does not win where it ties with another law of the same estimator. If only other estimators were "
        "rivals, this would be recommended too: "
        + (
            "; ".join(text for one in results for delay in delays for text in _other_reading(one, delay))
            or "nothing"
        )
        + ". The rule was committed with the first reading, which therefore decides."
    )
    yield from _dual_rate_sentences(results, delays)
    yield _paragraph(
        "The disturbance observer, uniform and with a plain wall, over the best pair of an estimator of counts alone "
        "and a plain wall (area, geometric mean and 95 % interval; bold where it wins):"
    )
    yield table(
        ["rig", "delay", *(HANDS[grip] for grip in results[0].grips)],
        (
            [result.rig, delay, *(_observer_ratio(result, grip, delay) for grip in result.grips)]
            for result in results
            for delay in delays
        ),
    )
    yield from notes[1:]
    yield "## Tuned values, noise and cost"
    yield _paragraph(
        "Value of the tuned parameter, with * if the optimum is at the end of its grid; in brackets the rms velocity "
        "of a toggling count at rest (rad/s or m/s). A law takes the value of its estimator."
    )
    yield _tuning_table(results)
    yield table(
        ["estimator", "cycles a tick, M0+", "M4F"],
        ([f"`{name}`", *(f"{TICKS[core][name]:,}" for core in ("M0+", "M4F"))] for name in rule.ESTIMATORS),
    )
    yield _paragraph(
        "Cycles of a whole tick with the estimator in every tick, as `rig design` uses them "
        "(`rig/firmware/tick_budget.py`); counted in an emulator, not measured on a board."
    )
    yield from _rig_sections(results, delays)
    yield "## Your own entry"
    yield _paragraph(
        "An estimator of your own needs a function and [an entry point](ranking-entries.md); see [your own "
        "estimator](../tutorials/own-estimator.md). This one is whole:"
    )
    yield "<!-- not run: the tutorial runs one -->\n" + ENTRY
    yield _paragraph(
        "With the name `alpha-beta` it is tuned from 10 to 400 Hz and measured beside the others:"
    )
    yield (
        "<!-- not run: needs the entry point -->\n"
        '```sh\nrig estimators rank chawda-linear --entry "alpha-beta:bandwidth_hz=10:400"\n```'
    )


def _rig_sections(results: Sequence[RigResults], delays: Sequence[str]) -> Iterator[str]:
    yield "## Each rig"
    yield _paragraph(
        f"Area relative to uniform `{USUAL}` with a plain wall (geometric mean, 95 % interval); the largest in bold, "
        "± marks those that tie with it. Then, without delay: limit without damping; at how many dampings, over all "
        "rigs and offsets, even the stiffest wall counts, in which the push rests two counts deep (the area is then a "
        "lower bound); and rms error of the velocity in hits of the preset's own wall."
    )
    for result in results:
        yield f"### {result.rig}"
        yield _impact_sentence(result)
        for grip in result.grips:
            yield f"{HANDS[grip][0].upper()}{HANDS[grip][1:]}:"
            yield _area_table(result, grip, delays)
    if len(results) > 1:
        yield "## Does the ranking depend on one rig?"
        yield _paragraph(
            "Kendall's τ (`scipy.stats.kendalltau`) between the ranking of all rigs and that with one left out. Ranked "
            "are the pairs that all rigs can run, by the mean logarithm of area over the largest area."
        )
        taus = {delay: stability(results, delay) for delay in delays}
        yield table(
            ["left out", *(f"delay {delay}" for delay in delays)],
            ([result.rig, *(f"{taus[delay][result.rig]:.2f}" for delay in delays)] for result in results),
        )
        yield _paragraph("Order of the pairs over all rigs and grips:")
        yield "\n".join(f"* delay {delay}: {_ranked_pairs(results, delay)}" for delay in delays)


def is_new(pair: str) -> bool:
    """Return True for a pair that `rig design` does not list: an observer, an entry, or not a plain wall."""
    return pair.removesuffix(", dual-rate") not in ("fdm", "fdm-butterworth", "foaw-best", "kalman", "levant")


def _impact_sentence(result: RigResults) -> str:
    """Return a sentence on the damping at which the effort limit is reached at the first contact without a hand."""
    experiment = Ground.of(result.rig).preset
    inertia = config.settings_of_rig(experiment)["inertia"]
    speed = math.sqrt(2.0 * experiment.trial.effort * abs(experiment.trial.start) / inertia)
    velocity_unit, damping_unit = (unit_of(name, experiment.rig.motion) for name in ("velocity", "damping"))
    damping = _number(experiment.rig.limits.effort / speed)
    return _paragraph(
        f"Without a hand a hit arrives at {speed:.2g} {velocity_unit} or less. There the effort limit allows a damping "
        f"of {damping} {damping_unit}; of a larger one it cuts a part off, with any estimator."
    )


def _recommendation(result: RigResults, delay: str) -> str:
    chosen = result.recommended(delay)
    if chosen:
        return "; ".join(f"**{pair}**" for pair in chosen)
    equal = result.never_lose(delay)
    return f"none; never lose: {'; '.join(equal)}" if equal else "none: the best differs with the hand"


def _other_reading(result: RigResults, delay: str) -> list[str]:
    """Return what would be recommended if only other estimators were rivals: estimator, rig and delay."""
    more = {*result.recommended(delay, own_laws=False)} - {*result.recommended(delay)}
    return [
        f"{name} on {result.rig}, delay {delay}"
        for name in sorted({pair.partition(", ")[0] for pair in more})
    ]


def _observer_ratio(result: RigResults, grip: str, delay: str) -> str:
    plain = [pair.name for pair in rule.PAIRS if pair.law == PLAIN and pair.estimator != "disturbance"]
    best = result.best(grip, delay, [name for name in plain if name in result.pairs])
    ratio = result.ratio("disturbance", best, grip, delay)
    text = f"{_ratio(ratio)} over {best}"
    return f"**{text}**" if ratio.outcome == "wins" else text


def _dual_rate_sentences(results: Sequence[RigResults], delays: Sequence[str]) -> Iterator[str]:
    for result in results:
        if DUAL not in result.pairs:
            continue
        sentences = []
        for delay in delays:
            best = [HANDS[grip] for grip in result.grips if result.best(grip, delay) == DUAL]
            against = [result.ratio(DUAL, USUAL, grip, delay) for grip in result.grips]
            wins = sum(ratio.outcome == "wins" for ratio in against)
            loses = sum(ratio.outcome == "loses" for ratio in against)
            where = f"the largest area with {' and '.join(best)}" if best else "nowhere the largest area"
            sentences.append(
                f"at delay {delay} it has {where}; against the uniform filter it wins {wins} and loses {loses} of "
                f"{len(against)}"
            )
        yield _paragraph(f"Dual-rate with a plain filter on {result.rig}: {'; '.join(sentences)}.")


def _area_table(result: RigResults, grip: str, delays: Sequence[str]) -> str:
    motion = Ground.of(result.rig).preset.rig.motion
    unit = {name: unit_of(name, motion) for name in ("stiffness", "velocity")}
    ends = (f"K at B = 0 ({unit['stiffness']})", "stiffest", f"error ({unit['velocity']})")
    head = ["pair", *(f"delay {delay}" for delay in delays), *ends]
    best = {delay: result.best(grip, delay) for delay in delays}
    rows = []
    for pair in result.pairs:
        cells = []
        for delay in delays:
            text = _ratio(result.ratio(pair, USUAL, grip, delay))
            if pair == best[delay]:
                text = f"**{text}**"
            elif result.ratio(pair, best[delay], grip, delay).outcome == "ties":
                text += " ±"
            cells.append(text)
        first = result.cell(pair, grip, delays[0])
        rows.append([pair, *cells, _number(first.undamped), str(first.capped), f"{first.error:.2g}"])
    return table(head, rows)


def _tuning_table(results: Sequence[RigResults]) -> str:
    names = list(dict.fromkeys(name for result in results for name in result.tuned))
    rows = []
    for name in names:
        cells = []
        for result in results:
            settings = result.tuned.get(name)
            if settings is None:
                cells.append("–")
                continue
            value = "".join(f"{value:.3g}" for value in settings.values() if not isinstance(value, str))
            mark = "*" if name in result.ends else ""
            cells.append(f"{value}{mark} ({result.noise[name]:.2g})".strip())
        rows.append([name, *cells])
    return table(["estimator", *(result.rig for result in results)], rows)


def _ranked_pairs(results: Sequence[RigResults], delay: str) -> str:
    ranking = scores(results, delay)
    return "; ".join(sorted(ranking, key=lambda pair: -ranking[pair]))


def _ratio(ratio: Ratio) -> str:
    return f"{ratio.mean:.2f} ({ratio.low:.2f} to {ratio.high:.2f})"


def _number(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000.0 else f"{value:.3g}"


def _paragraph(text: str) -> str:
    return textwrap.fill(text, WIDTH, break_long_words=False, break_on_hyphens=False)
