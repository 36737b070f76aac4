"""How commands print: aligned lines for people, JSON for machines, signs of life on standard error."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import click

from rig.core.errors import RigError

_COLOURS = {"stable": "green", "limit cycle": "yellow", "unstable": "red", "invalid": "magenta"}


def print_json(value: Any) -> None:
    """One JSON document on standard output; what is not finite becomes null."""
    click.echo(json.dumps(_finite(value), ensure_ascii=False, indent=2))


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


def print_pairs(pairs: list[tuple[str, str]]) -> None:
    """Name and value, one pair a line, aligned."""
    width = max((len(name) for name, _ in pairs), default=0)
    for name, value in pairs:
        click.echo(f"  {name:<{width}}  {value}")


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Rows of texts in aligned columns, the first of them left, the others right; the first row is the head."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        first, *others = (
            cell.ljust(w) if i == 0 else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        click.echo("  " + "  ".join([first, *others]).rstrip())


def duration(value_ns: float) -> str:
    """Time of three digits in the unit that suits it: ``412 ns``, ``87.5 µs``, ``-1.2 ms``."""
    for limit, factor, unit in ((1e3, 1.0, "ns"), (1e6, 1e-3, "µs"), (1e9, 1e-6, "ms")):
        if abs(value_ns) < 0.9995 * limit:
            return f"{value_ns * factor:.3g} {unit}"
    return f"{value_ns * 1e-9:.4g} s"


def clock_pairs(clock: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Lines of a clock fit (`rig.core.clock_fit.ClockFit.as_mapping`)."""
    asymmetry = duration(clock["asymmetry_bound_ns"])
    return [
        (
            "clock offset",
            f"{clock['offset_ns'] * 1e-9:.9f} s ± {duration(clock['offset_sd_ns'])}, "
            f"and at most {asymmetry} if the ways differ",
        ),
        ("clock drift", f"{clock['drift_ppm']:.2f} ± {clock['drift_sd_ppm']:.2g} ppm"),
        ("round trip", f"{duration(clock['round_trip_ns'])} at least"),
        (
            "exchanges",
            f"{clock['used']} over {duration(clock['span_ns'])}, {clock['rejected']} rejected",
        ),
    ]


def coloured(kind: str) -> str:
    """Return a verdict in its colour."""
    return click.style(kind, fg=_COLOURS.get(kind), bold=True)


def on_terminal() -> bool:
    """Whether somebody looks: progress is drawn on a terminal only."""
    return sys.stderr is not None and sys.stderr.isatty()


def error_facts(error: RigError) -> dict[str, Any]:
    """Return an error for a machine."""
    return {
        "error": error.message,
        "kind": type(error).__name__,
        "remedy": error.remedy,
        "recording": None if error.recording is None else str(error.recording),
        "messages": list(error.messages),
        "exit_code": error.exit_code,
    }
