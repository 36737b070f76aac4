"""Measure what each search rule estimates for observers with a known limit; a test and the guide read the table.

    python -m tests.benchmarks.observers            # all sessions anew, table and guide (minutes)
    python -m tests.benchmarks.observers --guide    # the guide alone, from the committed table
    python -m tests.benchmarks.observers --check    # does the guide show the committed table?

Rules × lapse rates × spreads, as in the guide of `rig.session.search`. Sessions come from seeds, so the same code makes
the same table; `tests/rig/session/test_search_observers.py` goes through a few of them again.
"""

import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from rig.session import search
from rig.session.search._observer import Observer, performance
from tests.conformance import guides

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "tests" / "rig" / "session" / "data" / "search_observers.json"
GUIDE = ROOT / "rig" / "session" / "search" / "README.md"
REGENERATE = "python -m tests.benchmarks.observers"

LEVELS = tuple(float(level) for level in range(100, 825, 25))
THRESHOLD, OFF_LATTICE = 430.0, 12.5  # K50, and half a step about it
BEYOND = 1.2 * LEVELS[-1]  # K50 of a person whose limit no level reaches
LAPSE_RATES = (0.0, 0.02, 0.05)
SPREADS = (5.0, 15.0, 40.0)
GRADUAL = (80.0, 120.0)  # spreads of observers whose verdicts change over half of the levels and more
SESSIONS = 1000
SEED = 8
DIGITS = 4
NUMBERS = ("bias", "scatter", "hits", "covered", "width", "censored")
RULES: Mapping[str, tuple[str, dict[str, Any]]] = {
    "ascending × 5": ("ascending", {"repeats": 5}),
    "ascending × 1": ("ascending", {"repeats": 1}),
    "staircase 1u1d": ("staircase", {"stable_to_rise": 1}),
    "staircase 1u2d": ("staircase", {"stable_to_rise": 2}),
    "staircase 1u3d": ("staircase", {"stable_to_rise": 3}),
    "interleaved": ("interleaved", {}),
    "psi": ("psi", {"hits": 25}),
    "grid × 5": ("grid", {"repeats": 5}),
}

CATCH_SHARE = {"interleaved": 0.1}

Row = dict[str, Any]


def cases() -> list[tuple[str, float, float]]:
    """Return rule, lapse rate and spread of every row."""
    return list(product(RULES, LAPSE_RATES, SPREADS))


def gradual_cases() -> list[tuple[str, float, float]]:
    """Return rule, lapse rate and spread of every row for gradual observers."""
    return list(product(RULES, LAPSE_RATES, GRADUAL))


def row_of(case: tuple[str, float, float], sessions: int = SESSIONS, seed: int = SEED) -> Row:
    """Measure one row of the table."""
    name, lapse_rate, spread = case
    rule, settings = RULES[name]
    make = partial(_create_search, rule, settings)
    observer = Observer(threshold=THRESHOLD, spread=spread, lapse_rate=lapse_rate)
    found = performance(name, make, observer, sessions, seed=seed, off_lattice=OFF_LATTICE)
    return {
        "rule": name,
        "lapse_rate": lapse_rate,
        "spread": spread,
        **{n: _round(getattr(found, n)) for n in NUMBERS},
    }


def _create_search(rule: str, settings: Mapping[str, Any], *, seed: int) -> search.Rule:
    made = search.make(rule, levels=LEVELS, seed=seed, **settings)
    share = CATCH_SHARE.get(rule)
    return made if share is None else search.Catching(rule=made, levels=LEVELS, share=share, seed=seed)


def beyond_of(case: tuple[str, float, float], sessions: int = SESSIONS, seed: int = SEED) -> Row:
    """Measure one row for an observer whose K50 is above all levels: the share of sessions that report this."""
    name, lapse_rate, spread = case
    rule, settings = RULES[name]
    make = partial(_create_search, rule, settings)
    observer = Observer(threshold=BEYOND, spread=spread, lapse_rate=lapse_rate)
    found = performance(name, make, observer, sessions, seed=seed, off_lattice=OFF_LATTICE)
    return {"rule": name, "lapse_rate": lapse_rate, "spread": spread, "marked": _round(found.above)}


PARTS: dict[str, tuple[Callable[..., Row], Callable[[], list[tuple[str, float, float]]]]] = {
    "rows": (row_of, cases),
    "gradual": (row_of, gradual_cases),
    "beyond": (beyond_of, cases),
}


def make_table() -> dict[str, Any]:
    """Measure all rows anew, on all processors."""
    made: dict[str, list[Row]] = {part: [] for part in PARTS}
    with ProcessPoolExecutor() as pool:
        for part, (measure, of) in PARTS.items():
            for done, row in enumerate(pool.map(measure, of()), start=1):
                made[part].append(row)
                print(f"{part}, {done} of {len(of())}: {row['rule']}", file=sys.stderr)
    return {"made_by": REGENERATE, "sessions": SESSIONS, **made}


def read_table() -> dict[str, Any]:
    """Return the committed table."""
    return dict(json.loads(TABLE.read_text(encoding="utf-8")))


def write_table(table: dict[str, Any]) -> None:
    """Write the table, one row a line, so that a change reads well in a diff."""
    text = json.dumps({**table, **{part: [] for part in PARTS}}, ensure_ascii=False, indent=1)
    for part in PARTS:
        rows = ",\n".join(f"  {json.dumps(row, ensure_ascii=False)}" for row in table[part])
        text = text.replace(f'"{part}": []', f'"{part}": [\n{rows}\n ]')
    TABLE.write_text(text + "\n", encoding="utf-8")


# --- the guide's sections ---------------------------------------------------------------------------------


def errors() -> str:
    """Return the Markdown table of bias and scatter of each rule, for each observer."""
    return _by_observer(lambda row: f"{_signed(row['bias'])} ± {row['scatter']:.0f}")


def intervals() -> str:
    """Return the table of the share of intervals that contain the limit, and their median width."""
    return _by_observer(
        lambda row: "–" if row["width"] is None else f"{100 * row['covered']:.0f} % ({row['width']:.0f})"
    )


def hits() -> str:
    """Return the table of the number of verdicts per session."""
    return _by_observer(lambda row: f"{row['hits']:.0f}")


def censored() -> str:
    """Return the table of the share of sessions that report a limit beyond the levels."""
    return _by_observer(lambda row: f"{100 * row['censored']:.1f} %" if row["censored"] else "0")


def beyond() -> str:
    """Return the table of the share of sessions that correctly report a limit beyond the levels."""
    return _by_observer(lambda row: f"{100 * row['marked']:.0f} %", "beyond")


def gradual() -> str:
    """Return the table of bias, scatter and interval coverage for gradual observers."""
    return _by_observer(
        lambda row: (
            f"{_signed(row['bias'])} ± {row['scatter']:.0f}, "
            + ("–" if row["width"] is None else f"{100 * row['covered']:.0f} % ({row['width']:.0f})")
        ),
        "gradual",
        GRADUAL,
    )


SECTIONS: dict[str, Callable[[], str]] = {
    "errors": errors,
    "intervals": intervals,
    "gradual": gradual,
    "hits": hits,
    "censored": censored,
    "beyond": beyond,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write table and guide; ``--guide`` writes only the guide, ``--check`` only compares it."""
    options = set(sys.argv[1:] if arguments is None else arguments)
    if not options:
        write_table(make_table())
    return guides.publish(GUIDE, SECTIONS, REGENERATE, check="--check" in options)


def _by_observer(cell: Callable[[Row], str], part: str = "rows", spreads: Sequence[float] = SPREADS) -> str:
    found = {(row["rule"], row["lapse_rate"], row["spread"]): row for row in read_table()[part]}
    observers = list(product(LAPSE_RATES, spreads))
    head = ["rule", *(f"{100 * lapse_rate:g} %, {spread:g}" for lapse_rate, spread in observers)]
    rows = [[name, *(cell(found[name, *observer]) for observer in observers)] for name in RULES]
    return guides.markdown(head, rows)


def _signed(value: float) -> str:
    return f"{value:+.0f}".replace("-", "−") if abs(value) >= 0.5 else "0"


def _round(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None


if __name__ == "__main__":
    raise SystemExit(main())
