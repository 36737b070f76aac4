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


def cases(spreads: Sequence[float] = SPREADS) -> list[tuple[str, float, float]]:
    """Return rule, lapse rate and spread of every row."""
    return list(product(RULES, LAPSE_RATES, spreads))


def row_of(case: tuple[str, float, float], sessions: int = SESSIONS, seed: int = SEED) -> Row:
    found = _performance(case, THRESHOLD, sessions, seed)
    return {**_named(case), **{number: _round(getattr(found, number)) for number in NUMBERS}}


def beyond_of(case: tuple[str, float, float], sessions: int = SESSIONS, seed: int = SEED) -> Row:
    """Measure one row for an observer whose K50 is above all levels: the share of sessions that report this."""
    return {**_named(case), "marked": _round(_performance(case, BEYOND, sessions, seed).above)}


def _named(case: tuple[str, float, float]) -> Row:
    return dict(zip(("rule", "lapse_rate", "spread"), case, strict=True))


def _performance(case: tuple[str, float, float], threshold: float, sessions: int, seed: int) -> Any:
    name, lapse_rate, spread = case
    observer = Observer(threshold=threshold, spread=spread, lapse_rate=lapse_rate)
    make = partial(_create_search, *RULES[name])
    return performance(name, make, observer, sessions, seed=seed, off_lattice=OFF_LATTICE)


def _create_search(rule: str, settings: Mapping[str, Any], *, seed: int) -> search.Rule:
    made = search.make(rule, levels=LEVELS, seed=seed, **settings)
    share = CATCH_SHARE.get(rule)
    return made if share is None else search.Catching(rule=made, levels=LEVELS, share=share, seed=seed)


PARTS: dict[str, tuple[Callable[..., Row], Callable[[], list[tuple[str, float, float]]]]] = {
    "rows": (row_of, cases),
    "gradual": (row_of, lambda: cases(GRADUAL)),
    "beyond": (beyond_of, cases),
}


def make_table() -> dict[str, Any]:
    made: dict[str, list[Row]] = {part: [] for part in PARTS}
    with ProcessPoolExecutor() as pool:
        for part, (measure, of) in PARTS.items():
            for done, row in enumerate(pool.map(measure, of()), start=1):
                made[part].append(row)
                print(f"{part}, {done} of {len(of())}: {row['rule']}", file=sys.stderr)
    return {"made_by": REGENERATE, "sessions": SESSIONS, **made}


def read_table() -> dict[str, Any]:
    return dict(json.loads(TABLE.read_text(encoding="utf-8")))


def write_table(table: dict[str, Any]) -> None:
    """Write the table, one row a line, so that a change reads well in a diff."""
    text = json.dumps({**table, **{part: [] for part in PARTS}}, ensure_ascii=False, indent=1)
    for part in PARTS:
        rows = ",\n".join(f"  {json.dumps(row, ensure_ascii=False)}" for row in table[part])
        text = text.replace(f'"{part}": []', f'"{part}": [\n{rows}\n ]')
    TABLE.write_text(text + "\n", encoding="utf-8")


# --- the guide's sections ---------------------------------------------------------------------------------


def _error(row: Row) -> str:
    return f"{_signed(row['bias'])} ± {row['scatter']:.0f}"


def _coverage(row: Row) -> str:
    return "–" if row["width"] is None else f"{100 * row['covered']:.0f} % ({row['width']:.0f})"


def _censored(row: Row) -> str:
    return f"{100 * row['censored']:.1f} %" if row["censored"] else "0"


SECTIONS: dict[str, Callable[[], str]] = {
    "errors": lambda: _by_observer(_error),
    "intervals": lambda: _by_observer(_coverage),
    "gradual": lambda: _by_observer(lambda row: f"{_error(row)}, {_coverage(row)}", "gradual", GRADUAL),
    "hits": lambda: _by_observer(lambda row: f"{row['hits']:.0f}"),
    "censored": lambda: _by_observer(_censored),
    "beyond": lambda: _by_observer(lambda row: f"{100 * row['marked']:.0f} %", "beyond"),
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
