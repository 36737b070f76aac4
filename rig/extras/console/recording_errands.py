"""Work for a page outside the server's process: list recordings, cut a time span, replay, draw and export.

`errand_worker` calls these functions. They must not change or delete an existing recording.
"""

import io
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig import cut_recording
from rig.core.errors import ConfigError, RigError
from rig.core.sample import unit_of
from rig.experiments.trials.replay import ReplayResult
from rig.experiments.trials.replay import replay as replayed
from rig.extras.console.history import HistoryExcerpt
from rig.extras.console.view import pack
from rig.recording.data import Recording
from rig.recording.export import EXPORTERS, write_sidecar
from rig.recording.origin import cut_facts
from rig.recording.reader import open_facts, open_recording
from rig.recording.seal import SEALED_SUFFIX
from rig.recording.seal import SUFFIX as CAPTURE
from rig.views.plots.hit import draw_hit

SUFFIXES = (SEALED_SUFFIX, CAPTURE)
PICTURES = {".png": "image/png", ".svg": "image/svg+xml"}
PAGE = 50  # recordings in one answer
POINTS = 1500  # of a cut
GREATEST = 1e300  # larger numbers of a setting are not shown
COMPARED = ("velocity", "effort_sent")  # columns of a replay that the page compares
MIME = {"csv": "text/csv; charset=utf-8", "json": "application/json"}


# The list -------------------------------------------------------------------------------------------


def list_recordings(directory: str, search: str, first: int) -> dict[str, Any]:
    """Return up to `PAGE` recordings that match every word of `search`, newest first, skipping the `first` ones.

    ``more`` is True if further recordings match.
    """
    entries = (_entry(path, changed_ns) for path, changed_ns in _newest(Path(directory)))
    words = search.lower().split()
    if words:
        entries = (entry for entry in entries if all(word in _text(entry) for word in words))
    found: list[dict[str, Any]] = []
    for number, entry in enumerate(entries):
        if number >= first + PAGE:
            return {"recordings": found, "more": True}
        if number >= first:
            found.append({**entry, "picture": _picture(Path(directory) / entry["name"]) is not None})
    return {"recordings": found, "more": False}


def _newest(directory: Path) -> list[tuple[Path, int]]:
    if not directory.is_dir():
        return []
    found = []
    for path in directory.iterdir():
        if path.suffix in SUFFIXES:
            with suppress(OSError):  # the capture was converted meanwhile
                found.append((path, path.lstat().st_mtime_ns))
    return sorted(found, key=lambda one: -one[1])


@lru_cache(maxsize=20_000)
def _entry(path: Path, changed_ns: int) -> dict[str, Any]:
    facts: dict[str, Any] = {"name": path.name, "changed_s": changed_ns * 1e-9, "problem": None}
    try:
        path.name.encode()
        if path.is_symlink():
            raise ConfigError(
                "the recording is a symbolic link, which is not read",
                remedy="replace the link by the recording file",
            )
        return {**facts, **_settings(open_facts(path))}
    except UnicodeEncodeError:
        # JSON carries no lone surrogates: the page shows such a name with escapes, and cannot ask for it.
        name = path.name.encode("utf-8", "backslashreplace").decode()
        return {**facts, "name": name, "problem": "its name is not valid UTF-8; rename it"}
    except RigError as error:
        return {**facts, "problem": str(error)}


def _settings(facts: Recording) -> dict[str, Any]:
    header, trailer = facts.header, facts.trailer or {}
    parts = {name: part for name, part in facts.experiment.items() if isinstance(part, dict)}
    wall, rates, trial, operator = (
        parts.get(name, {}) for name in ("wall", "controller", "trial", "operator")
    )
    motion, verdict = header["motion"], trailer.get("verdict") or {}
    kind = _words(trial.get("kind"))
    return {
        "rig": header["rig"],
        "motion": motion,
        "created": _words(header.get("created")),
        "url": header["identity"].get("url"),
        "kind": verdict.get("kind"),
        "reasons": verdict.get("reasons") or [],
        "ended": trailer.get("reason"),
        "cut": cut_facts(facts),
        "stiffness": _number(wall.get("stiffness")),
        "damping": _number(wall.get("damping")),
        "units": {name: unit_of(name, motion) for name in ("stiffness", "damping")},
        "position_rate": _number(rates.get("position_rate")),
        "velocity_rate": _number(rates.get("velocity_rate")),
        "estimator": _words(rates.get("estimator")),
        "trial": kind if kind != "human" else f"human, {_words(operator.get('grip'))}",
    }


def _words(value: Any) -> str | None:
    return value if isinstance(value, str) else None


def _number(value: Any) -> float | None:
    fits = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < GREATEST
    return float(value) if fits else None


def _text(entry: Mapping[str, Any]) -> str:
    """Return the text that a search examines: all facts of a recording, and stiffness and damping as k=100 and b=5."""
    words = [str(value) for value in entry.values()]
    numbers = {"k": entry.get("stiffness"), "b": entry.get("damping")}
    words += [f"{sign}={value:g}" for sign, value in numbers.items() if value is not None]
    return " ".join(words).lower()


def _picture(path: Path) -> Path | None:
    there = (path.with_suffix(suffix) for suffix in PICTURES)
    return next((picture for picture in there if picture.is_file() and not picture.is_symlink()), None)


# One recording --------------------------------------------------------------------------------------


@lru_cache(maxsize=1)  # a recording at 20 kHz has some 300 MB a minute
def _read(path: str, changed_ns: int) -> Recording:
    return open_recording(path)


def _open(path: str) -> Recording:
    return _read(path, Path(path).stat().st_mtime_ns)


def describe_recording(path: str) -> dict[str, Any]:
    """Return what a scope needs to draw a recording: columns with units, wall, length (s) and lost samples."""
    recording = _open(path)
    times = recording.time_s
    trial = recording.rows["penetration"] > 0.0
    return {
        **_entry(Path(path), Path(path).stat().st_mtime_ns),
        "columns": [
            {"name": name, "unit": recording.units[name], "meaning": recording.descriptions[name]}
            for name in recording.names
        ],
        "wall": recording.experiment.get("wall"),
        "rows": len(recording),
        "length_s": float(times[-1]) if len(times) else 0.0,
        "contact_s": float(times[int(np.argmax(trial))]) if trial.any() else None,
        "complete": recording.complete,
        "lost": [str(loss) for loss in recording.lost],
    }


def cut(
    path: str, columns: Sequence[str], first_s: float, last_s: float, changes: Mapping[str, Any] | None = None
) -> tuple[None, bytes]:
    """Return columns between `first_s` and `last_s` (s since the first row) as bytes for a scope.

    With `changes` of settings, replay the recording and return velocity and effort of the replay. Raise `RigError` if a
    column is missing or the recording cannot be replayed.
    """
    recording = _open(path)
    rows, extra = recording.rows, dict[str, Any]()
    if changes:
        result = _replay(path, Path(path).stat().st_mtime_ns, tuple(sorted(changes.items())))
        rows, columns = result.rows, COMPARED
        extra = {
            name: getattr(result, name)
            for name in ("estimator", "exact", "velocity_difference", "effort_difference")
        }
    for name in columns:
        recording.column(name)
    found = _cut(recording.time_s, rows, columns, first_s, last_s)
    return None, pack(found, tuple(columns), kind="recorded", fresh=True, **extra)


def save_cut(
    path: str, first_s: float, last_s: float, output: str, zero_ns: int | None = None
) -> dict[str, Any]:
    """Save a time span (s) as a new recording; return its name, number of rows, and why it cannot be replayed, or None.

    The times count from `zero_ns` (ns, device clock; None: from the first row).
    """
    made = cut_recording(path, first_s, last_s, output=output, zero_ns=zero_ns)
    return {"name": made.path.name, "rows": made.rows, "no_replay": made.no_replay}


@lru_cache(maxsize=1)
def _replay(path: str, changed_ns: int, changes: tuple[tuple[str, Any], ...]) -> ReplayResult:
    return replayed(_read(path, changed_ns), dict(changes))


def _cut(
    times: NDArray[np.float64], rows: NDArray[np.void], columns: Sequence[str], first_s: float, last_s: float
) -> HistoryExcerpt:
    """Return points for a scope: least and greatest value of groups of rows; only the last group may be smaller."""
    first = int(np.searchsorted(times, first_s, "left"))
    last = int(np.searchsorted(times, last_s, "right"))
    step = max(1, -(-(last - first) // POINTS))
    values = np.array([rows[name][first:last] for name in columns], np.float64).reshape(len(columns), -1)
    starts = np.arange(0, last - first, step)
    if step == 1 or not len(starts):
        return HistoryExcerpt(first, 1, times[first:last], values, values)
    low, high = (extreme.reduceat(values, starts, axis=1) for extreme in (np.fmin, np.fmax))
    return HistoryExcerpt(first, step, times[first:last][starts], low, high)


def picture(path: str, draw: bool) -> tuple[str, bytes]:
    """Return media type and bytes of a recording's picture; if it is missing, draw it, or raise `ConfigError`."""
    found = _picture(Path(path))
    if found is None:
        if not draw:
            raise ConfigError(f"{Path(path).name} has no picture", remedy="request the picture with draw=1")
        found = draw_hit(path)
    return PICTURES[found.suffix], found.read_bytes()


def export_recording(path: str, form: str) -> tuple[str, bytes]:
    """Return media type and bytes of a recording in the format `form`; ``json`` is the description of a CSV export."""
    if form not in (*EXPORTERS, "json"):
        raise ConfigError(
            f"{form!r} is not an export format", remedy=f"choose one of {', '.join((*EXPORTERS, 'json'))}"
        )
    file = io.BytesIO()
    (write_sidecar if form == "json" else EXPORTERS[form])(file, _open(path))
    return MIME.get(form, "application/octet-stream"), file.getvalue()
