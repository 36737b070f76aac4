"""The accuracy table of the estimators on reference motions, as data that a test and the guide read.

    python -m tests.conformance.estimator_accuracy            # measure, tune anew, write table and guide (minutes)
    python -m tests.conformance.estimator_accuracy --check    # does the guide show the table that is committed?

`tests/rig/control/test_estimator_accuracy.py` scores every row again and fails when one has become worse. Rows with
``tuned`` carry the settings that `rig estimators tune` found for them; the others run with default settings.
"""

import json
import math
import platform
import sys
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

from rig.control import estimators
from rig.core.errors import ConfigError
from rig.experiments.estimation._signals import SIGNALS
from rig.experiments.estimation.cases import Case, signal_case
from rig.experiments.estimation.estimators import Score, Variant, cost_ns, score
from rig.experiments.estimation.tuning import tune_estimator
from tests.conformance import guides
from tests.conformance.guides import ROOT

TABLE = ROOT / "tests" / "rig" / "control" / "data" / "estimator_accuracy.json"
GUIDE = ROOT / "rig" / "control" / "estimators" / "README.md"
REGENERATE = "python -m tests.conformance.estimator_accuracy"

FINE, COARSE = 1e-6, 2e-5  # Chawda et al.'s linear encoder, and a handle behind a 1000-line rotary one
RESOLUTIONS = (FINE, COARSE)
RATES = (1000, 2000, 10_000, 20_000, 50_000)
HIT = "wall-bounce"
OBJECTIVE = "rms"
COST_RATE = 20_000
NUMBERS = ("rms", "delay_s", "rms_without_delay", "rest_rms", "toggling_rms")
DIGITS = 4
NOTHING = 1e-7  # m/s, in the guide

Row = dict[str, Any]


@lru_cache(maxsize=1)
def case_of(signal: str, rate_hz: float, resolution: float) -> Case:
    """Return a case; it is cached, because all estimators are scored on the same one."""
    return signal_case(SIGNALS[signal], rate_hz, resolution)


def scored() -> list[str]:
    """Return the names of the estimators that need only counts: the motions of the table have no effort."""
    return [name for name in estimators.names() if not estimators.get(name).uses_effort]


def grid() -> list[tuple[str, int, float]]:
    """Return signal, rate and resolution of the cases: the hit at all rates, the other motions at two."""
    hits = [(HIT, rate, resolution) for resolution in RESOLUTIONS for rate in RATES]
    others = [(s, r, d) for s in SIGNALS if s != HIT for d in RESOLUTIONS for r in (2000, 20_000)]
    return hits + others


def row_of(found: Score, tuned: str | None) -> Row:
    row: Row = {name: getattr(found, name) for name in ("estimator", "case", "rate_hz", "resolution")}
    row |= {"tuned": tuned, "settings": dict(found.settings)}
    if found.refused is not None:
        return {**row, "refused": True}
    return {**row, **{n: _round(getattr(found, n)) for n in NUMBERS}}


def measure(name: str) -> list[Row]:
    """Measure the rows of one estimator: with default settings on every case, and tuned to each hit."""
    rows = []
    for key in grid():
        case = case_of(*key)
        rows.append(row_of(score(case, Variant(name)), None))
        if key[0] != HIT:
            continue
        try:
            tuning = tune_estimator(name, case, objective=OBJECTIVE)
        except ConfigError:  # nothing to tune, or not realisable: the row above says it
            continue
        rows.append(row_of(tuning.after, OBJECTIVE))
    return rows


def make_table(names: Sequence[str]) -> dict[str, Any]:
    case = case_of(HIT, COST_RATE, FINE)
    rows = []
    for name in names:
        print(f"{name} …", file=sys.stderr)
        rows += measure(name)
    costs = {name: round(cost_ns(case, Variant(name)), 1) for name in names}
    machine = f"{platform.machine()}, {_processor()}"
    return {"made_by": REGENERATE, "cost": {"machine": machine, "ns_per_sample": costs}, "rows": rows}


def read_table() -> dict[str, Any]:
    return dict(json.loads(TABLE.read_text(encoding="utf-8")))


def write_table(table: dict[str, Any]) -> None:
    """Write the table, one row a line, so that a change reads well in a diff."""
    head = {key: value for key, value in table.items() if key != "rows"}
    rows = ",\n".join(f"  {json.dumps(row, ensure_ascii=False)}" for row in table["rows"])
    text = json.dumps({**head, "rows": []}, ensure_ascii=False, indent=1)
    TABLE.parent.mkdir(parents=True, exist_ok=True)
    TABLE.write_text(text.replace('"rows": []', f'"rows": [\n{rows}\n ]') + "\n", encoding="utf-8")


# --- the guide's sections ---------------------------------------------------------------------------------


def tuned_hits(resolution: float) -> str:
    """Return the table of the least rms error on the hit, by rate, with the tuned settings."""

    def cells(table: dict[str, Any], name: str) -> list[str]:
        found = {r["rate_hz"]: r for r in _select(table, name, HIT, resolution) if _best(table, r)}
        errors = [_millimetres(found.get(rate), "rms") for rate in RATES]
        return [*errors, _settings(found.get(2000)), _settings(found.get(20_000))]

    return _by_estimator(
        [*(f"{rate // 1000} kHz" for rate in RATES), "settings at 2 kHz", "at 20 kHz"], cells
    )


def noise_and_delay() -> str:
    """Return the table of delay and noise at rest of the tuned estimators, at 2 and 20 kHz."""

    def cells(table: dict[str, Any], name: str) -> list[str]:
        found = {r["rate_hz"]: r for r in _select(table, name, HIT, COARSE) if _best(table, r)}
        rows = [found.get(rate) for rate in (2000, 20_000)]
        return [
            text
            for row in rows
            for text in (
                _milliseconds(row),
                *(_millimetres(row, n) for n in ("rms_without_delay", "toggling_rms")),
            )
        ]

    columns = ("delay", "error without it", "toggling count")
    return _by_estimator([f"{text}, {rate} kHz" for rate in (2, 20) for text in columns], cells)


def default_motions() -> str:
    """Return the table of rms errors with default settings at 2 kHz on every reference motion."""
    columns = list(product(RESOLUTIONS, SIGNALS))

    def cells(table: dict[str, Any], name: str) -> list[str]:
        chosen = [_select(table, name, motion, resolution) for resolution, motion in columns]
        rows = [next((r for r in one if r["rate_hz"] == 2000 and r["tuned"] is None), None) for one in chosen]
        return [_millimetres(row, "rms") for row in rows]

    return _by_estimator([f"{motion}, {1e6 * resolution:g} µm" for resolution, motion in columns], cells)


def _by_estimator(head: list[str], cells: Callable[[dict[str, Any], str], list[str]]) -> str:
    table = read_table()
    names = dict.fromkeys(row["estimator"] for row in table["rows"])
    return guides.markdown(["estimator", *head], [[f"`{name}`", *cells(table, name)] for name in names])


def cost() -> str:
    """Return the table of the cost of one update with default settings."""
    table = read_table()
    found = table["cost"]
    rows = [[f"`{name}`", f"{ns:.0f}"] for name, ns in found["ns_per_sample"].items()]
    return f"On {found['machine']}:\n\n" + guides.markdown(["estimator", "ns a sample"], rows)


SECTIONS: dict[str, Callable[[], str]] = {
    "hits_fine": lambda: tuned_hits(FINE),
    "hits_coarse": lambda: tuned_hits(COARSE),
    "noise_and_delay": noise_and_delay,
    "default_motions": default_motions,
    "cost": cost,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write table and guide; ``--guide`` writes only the guide, ``--check`` only compares it.

    Names of estimators after the options measure these alone and keep the other rows.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    options = {word for word in words if word.startswith("--")}
    chosen = [word for word in words if word not in options]
    if not options & {"--check", "--guide"}:
        fresh = make_table(chosen or scored())
        write_table(_merge(fresh) if chosen else fresh)
    return guides.publish(GUIDE, SECTIONS, REGENERATE, check="--check" in options)


def _merge(fresh: dict[str, Any]) -> dict[str, Any]:
    """Return the committed table with the rows of `fresh` in place of older ones."""
    if not TABLE.exists():
        return fresh
    old = read_table()
    measured = set(fresh["cost"]["ns_per_sample"])
    rows = [r for r in old["rows"] if r["estimator"] not in measured] + fresh["rows"]
    costs = {**old["cost"]["ns_per_sample"], **fresh["cost"]["ns_per_sample"]}
    names = [name for name in estimators.names() if name in costs]
    return {
        **fresh,
        "cost": {**fresh["cost"], "ns_per_sample": {name: costs[name] for name in names}},
        "rows": [r for name in names for r in rows if r["estimator"] == name],
    }


def _select(table: dict[str, Any], *key: Any) -> list[Row]:
    return [r for r in table["rows"] if (r["estimator"], r["case"], r["resolution"]) == key]


def _best(table: dict[str, Any], row: Row) -> bool:
    """Return True if a row is the tuned one of its case, or the only one."""
    if row.get("refused"):
        return False
    if row["tuned"]:
        return True
    keys = ("estimator", "case", "rate_hz", "resolution")
    return not any(r["tuned"] and all(r[k] == row[k] for k in keys) for r in table["rows"])


def _settings(row: Row | None) -> str:
    if row is None or not row["settings"]:
        return "–"
    return ", ".join(f"{key} {float(f'{value:.3g}'):g}" for key, value in row["settings"].items())


def _millimetres(row: Row | None, number: str) -> str:
    if row is None or row.get("refused"):
        return "–"
    return f"{float(f'{1e3 * row[number]:.2g}'):g}" if row[number] > NOTHING else "0"


def _milliseconds(row: Row | None) -> str:
    return "–" if row is None or row["delay_s"] is None else f"{1e3 * row['delay_s']:.2f}"


def _round(value: float) -> float | None:
    return None if math.isnan(value) else float(f"{value:.{DIGITS}g}")


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return "unknown processor"


if __name__ == "__main__":
    raise SystemExit(main())
