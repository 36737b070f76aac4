"""Write the page *Which estimator and which law, on which rig?* from results of the ranking.

Every number of the page comes from the results, the rule, or the counted cycles.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence

from firmware_protocol.codegen import table
from rig import config
from rig.core.sample import unit_of
from rig.extras.papers.ranking import rule
from rig.extras.papers.ranking.compare import Ratio, RigResults, scores, stability
from rig.extras.papers.ranking.rule import ESTIMATED, PASSIVE, PLAIN, Ground, Pair
from rig.firmware.tick_budget import TICKS

COMMAND = "rig estimators rank"
USUAL, DUAL = Pair("fdm-butterworth").name, Pair("fdm-butterworth", dual=True).name
WIDTH = 120
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


def page(found: Sequence[RigResults]) -> str:
    """Return the page of results in Markdown."""
    return "\n\n".join(_parts(found)) + "\n"


def _parts(found: Sequence[RigResults]) -> Iterator[str]:
    delays = found[0].axis(1)
    yield "# Which estimator and which law, on which rig?"
    yield f"<!-- made by `{COMMAND}`: do not edit -->"
    missing = [name for name in rule.RIGS if name not in {one.rig for one in found}]
    new = {
        f"{pair} on {one.rig}, delay {n}"
        for one in found
        for n in delays
        for pair in one.recommended(n)
        if is_new(pair)
    }
    yield _wrap(
        "Simulated hits, judged by the rule of [decision 0019](../../decisions/0019-how-estimators-are-ranked.md), "
        "which was committed before any result. A wall counts if its commanded effort is not heard and its stiffness "
        "and damping are rendered as commanded. Each number stands for a rig and eight variations of it "
        "(±20 % of its parameters; the estimator keeps those of the rig) at three encoder offsets. "
        "No board was powered for this page."
    )
    yield _wrap(
        f"Measured: {', '.join(one.rig for one in found)}"
        + (f"; not measured: {', '.join(missing)}" if missing else "")
        + ". Left out: smartknob, whose motor cannot hold the press of a relaxed and of a firm grip"
        + f". Pairs: {len(max((one.pairs for one in found), key=len))} of estimator and law. Delays: "
        f"{', '.join(delays)} ticks. The command, which resumes from its journal:"
    )
    yield f"<!-- not run: about 40 minutes of one core -->\n```sh\n{COMMAND}\n```"
    yield "## Answer"
    yield _wrap(
        "A pair is recommended where it wins or ties against the best other one without a hand and in all three "
        f"grips, and wins in at least one. It wins if its area is more than {rule.WIN:g} times as large and the "
        f"{100 * rule.CONFIDENCE:g} % interval lies above 1. Where none is recommended, the pairs that never lose "
        "are equally good by this rule: take the cheapest."
    )
    yield table(
        ["rig", *(f"delay {n}" for n in delays)],
        ([one.rig, *(_answer(one, n) for n in delays)] for one in found),
    )
    yield _wrap(
        "`rig design` may recommend a tracking loop, a disturbance observer or another law only where this table does: "
        + ("; ".join(sorted(new)) if new else "nowhere")
        + ". A pair does not win where it ties with another law of the same estimator. If only other estimators were "
        "rivals, this would be recommended too: "
        + ("; ".join(text for one in found for n in delays for text in _other_reading(one, n)) or "nothing")
        + ". The rule was committed with the first reading, which therefore decides."
    )
    yield from _dual(found, delays)
    yield _wrap(
        "The disturbance observer, uniform and with a plain wall, over the best pair of an estimator of counts alone "
        "and a plain wall (area, geometric mean and 95 % interval; bold where it wins):"
    )
    yield table(
        ["rig", "delay", *(HANDS[grip] for grip in found[0].axis(0))],
        ([one.rig, n, *(_observer(one, grip, n) for grip in one.axis(0))] for one in found for n in delays),
    )
    yield "## Tuned values, noise and cost"
    yield _wrap(
        "Value of the tuned parameter, with * if the optimum is at the end of its grid; in brackets the rms velocity "
        "of a toggling count at rest (rad/s or m/s). A law takes the value of its estimator."
    )
    yield _tuned(found)
    yield table(
        ["estimator", "cycles a tick, M0+", "M4F"],
        ([f"`{name}`", *(f"{TICKS[core][name]:,}" for core in ("M0+", "M4F"))] for name in rule.ESTIMATORS),
    )
    yield _wrap(
        "Cycles of a whole tick with the estimator in every tick, as `rig design` uses them "
        "(`rig/firmware/tick_budget.py`); counted in an emulator, not measured on a board."
    )
    yield from _rigs(found, delays)
    yield "## Your own entry"
    yield _wrap(
        "An estimator of your own needs a function and an entry point; see [your own "
        "estimator](../tutorials/own-estimator.md). This one is whole:"
    )
    yield "<!-- not run: the tutorial runs one -->\n" + ENTRY
    yield _wrap("With the name `alpha-beta` it is tuned from 10 to 400 Hz and measured beside the others:")
    yield (
        "<!-- not run: needs the entry point -->\n"
        '```sh\nrig estimators rank chawda-linear --entry "alpha-beta:bandwidth_hz=10:400"\n```'
    )


def _rigs(found: Sequence[RigResults], delays: Sequence[str]) -> Iterator[str]:
    """Yield the tables of areas of each rig, and the stability of the ranking."""
    yield "## Each rig"
    yield _wrap(
        f"Area relative to uniform `{USUAL}` with a plain wall (geometric mean, 95 % interval); the largest in bold, "
        "± marks those that tie with it. Then, without delay: limit without damping; at how many dampings, over all "
        "rigs and offsets, even the stiffest wall counts, in which the push rests two counts deep (the area is then a "
        "lower bound); and rms error of the velocity in hits of the preset's own wall."
    )
    for one in found:
        yield f"### {one.rig}"
        yield _impact(one)
        for grip in one.axis(0):
            yield f"{HANDS[grip][0].upper()}{HANDS[grip][1:]}:"
            yield _areas(one, grip, delays)
    if len(found) > 1:
        yield "## Does the ranking depend on one rig?"
        yield _wrap(
            "Kendall's τ (`scipy.stats.kendalltau`) between the ranking of all rigs and that with one left out. Ranked "
            "are the pairs that all rigs can run, by the mean logarithm of area over the largest area."
        )
        taus = {n: stability(found, n) for n in delays}
        yield table(
            ["left out", *(f"delay {n}" for n in delays)],
            ([one.rig, *(f"{taus[n][one.rig]:.2f}" for n in delays)] for one in found),
        )
        yield _wrap("Order of the pairs over all rigs and grips:")
        yield "\n".join(f"* delay {n}: {_order(found, n)}" for n in delays)


def is_new(pair: str) -> bool:
    """Return True for a pair that `rig design` does not list: an observer, or a law other than the plain wall."""
    name, *rest = pair.split(", ")
    return name in ("tracking", "disturbance") or bool({PASSIVE, ESTIMATED} & set(rest))


def _impact(one: RigResults) -> str:
    """Return a sentence on the damping at which the effort limit is reached at the first contact without a hand."""
    x = Ground.of(one.rig).preset
    inertia = config.settings_of_rig(x)["inertia"]
    speed = math.sqrt(2.0 * x.trial.effort * abs(x.trial.start) / inertia)
    units = [unit_of(name, x.rig.motion) for name in ("velocity", "damping")]
    return _wrap(
        f"Without a hand a hit arrives at {speed:.2g} {units[0]} or less. There the effort limit allows a damping of "
        f"{_number(x.rig.limits.effort / speed)} {units[1]}; of a larger one it cuts a part off, with any estimator."
    )


def _answer(one: RigResults, delay: str) -> str:
    chosen = one.recommended(delay)
    if chosen:
        return "; ".join(f"**{pair}**" for pair in chosen)
    equal = one.never_lose(delay)
    return f"none; never lose: {'; '.join(equal)}" if equal else "none: the best differs with the hand"


def _other_reading(one: RigResults, delay: str) -> list[str]:
    """Return what would be recommended if only other estimators were rivals: estimator, rig and delay."""
    more = {*one.recommended(delay, own_laws=False)} - {*one.recommended(delay)}
    return [
        f"{name} on {one.rig}, delay {delay}" for name in sorted({pair.partition(", ")[0] for pair in more})
    ]


def _observer(one: RigResults, grip: str, delay: str) -> str:
    """Return the ratio of the disturbance observer to the best pair that does not know the effort."""
    plain = [pair.name for pair in rule.PAIRS if pair.law == PLAIN and pair.estimator != "disturbance"]
    best = one.best(grip, delay, [name for name in plain if name in one.pairs])
    ratio = one.ratio("disturbance", best, grip, delay)
    text = f"{_ratio(ratio)} over {best}"
    return f"**{text}**" if ratio.outcome == "wins" else text


def _dual(found: Sequence[RigResults], delays: Sequence[str]) -> Iterator[str]:
    """Yield a sentence on dual-rate with a plain filter for each rig that can run it."""
    for one in found:
        if DUAL not in one.pairs:
            continue
        sentences = []
        for n in delays:
            best = [HANDS[grip] for grip in one.axis(0) if one.best(grip, n) == DUAL]
            against = [one.ratio(DUAL, USUAL, grip, n) for grip in one.axis(0)]
            wins = sum(ratio.outcome == "wins" for ratio in against)
            loses = sum(ratio.outcome == "loses" for ratio in against)
            where = f"the largest area with {' and '.join(best)}" if best else "nowhere the largest area"
            sentences.append(
                f"at delay {n} it has {where}; against the uniform filter it wins {wins} and loses {loses} of "
                f"{len(against)}"
            )
        yield _wrap(f"Dual-rate with a plain filter on {one.rig}: {'; '.join(sentences)}.")


def _areas(one: RigResults, grip: str, delays: Sequence[str]) -> str:
    motion = Ground.of(one.rig).preset.rig.motion
    unit = {name: unit_of(name, motion) for name in ("stiffness", "velocity")}
    ends = (f"K at B = 0 ({unit['stiffness']})", "stiffest", f"error ({unit['velocity']})")
    head = ["pair", *(f"delay {n}" for n in delays), *ends]
    best = {n: one.best(grip, n) for n in delays}
    rows = []
    for pair in one.pairs:
        cells = []
        for n in delays:
            text = _ratio(one.ratio(pair, USUAL, grip, n))
            if pair == best[n]:
                text = f"**{text}**"
            elif one.ratio(pair, best[n], grip, n).outcome == "ties":
                text += " ±"
            cells.append(text)
        first = one.cell(pair, grip, delays[0])
        rows.append([pair, *cells, _number(first.undamped), str(first.capped), f"{first.error:.2g}"])
    return table(head, rows)


def _tuned(found: Sequence[RigResults]) -> str:
    names = list(dict.fromkeys(name for one in found for name in one.tuned))
    rows = []
    for name in names:
        cells = []
        for one in found:
            settings = one.tuned.get(name)
            if settings is None:
                cells.append("–")
                continue
            value = "".join(f"{v:.3g}" for v in settings.values() if not isinstance(v, str))
            mark = "*" if name in one.ends else ""
            cells.append(f"{value}{mark} ({one.noise[name]:.2g})".strip())
        rows.append([name, *cells])
    return table(["estimator", *(one.rig for one in found)], rows)


def _order(found: Sequence[RigResults], delay: str) -> str:
    ranking = scores(found, delay)
    return "; ".join(sorted(ranking, key=lambda pair: -ranking[pair]))


def _ratio(ratio: Ratio) -> str:
    return f"{ratio.mean:.2f} ({ratio.low:.2f} to {ratio.high:.2f})"


def _number(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000.0 else f"{value:.3g}"


def _wrap(text: str) -> str:
    return textwrap.fill(text, WIDTH, break_long_words=False, break_on_hyphens=False)
