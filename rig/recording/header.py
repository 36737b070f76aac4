"""The header of a recording: everything that is known before the first row.

The same seed, experiment and software versions give the same header, except for the keys in `VOLATILE`, which contain
all facts about the machine and the time of the run. Trials, readers and writers of recordings, studies and sessions use
this module.
"""

import os
import platform
import re
import subprocess
import time
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from rig.core.child import find_program, installed_path
from rig.core.errors import RecordingError
from rig.core.sample import COLUMNS, Column, Motion, unit_of
from rig.core.scratch import scratch
from rig.recording.canonical import lossless

FORMAT = "haptic-rig recording"
# Version of header, columns and trailer; raise it when the meaning of a key or column changes.
VERSION = 2
VOLATILE = ("created", "host", "git")
_SIMPLE_DTYPE = re.compile(r"[<|][iuf][1248]")


def make_schema(columns: Sequence[Column], motion: Motion) -> dict[str, Any]:
    """Return the layout of a row: its size (bytes), and name, dtype, offset, unit and meaning of each column."""
    dtype = np.dtype([(column.name, column.dtype) for column in columns], align=True)
    described = [
        {
            "name": column.name,
            "dtype": column.dtype,
            "offset": _field(dtype, column.name)[1],
            "unit": unit_of(column.unit, motion),
            "description": column.description,
        }
        for column in columns
    ]
    return {"row_bytes": dtype.itemsize, "columns": described}


def dtype_of(schema: Mapping[str, Any]) -> np.dtype[np.void]:
    """Return the numpy dtype of the rows that a schema describes; raise `RecordingError` if the schema is invalid."""
    try:
        columns = schema["columns"]
        formats = [column["dtype"] for column in columns]
        if not columns or not all(_SIMPLE_DTYPE.fullmatch(text) for text in formats):
            raise ValueError(f"the dtypes {formats} are not all little-endian integers or floats")
        if not all(isinstance(column[text], str) for column in columns for text in ("unit", "description")):
            raise ValueError("a column has no text for its unit or its description")
        return np.dtype(
            {
                "names": [column["name"] for column in columns],
                "formats": formats,
                "offsets": [column["offset"] for column in columns],
                "itemsize": schema["row_bytes"],
            }
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RecordingError(
            f"the layout of the recording's rows (schema) is invalid: {error}",
            remedy="restore the file from a copy",
        ) from error


def schema_of(schema: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    """Return a row layout with only those columns of `schema` that are in `names`, in unchanged order."""
    columns = [column for column in schema["columns"] if column["name"] in names]
    dtype = np.dtype([(column["name"], column["dtype"]) for column in columns], align=True)
    placed = [{**column, "offset": _field(dtype, column["name"])[1]} for column in columns]
    return {"row_bytes": dtype.itemsize, "columns": placed}


def make_header(
    *,
    rig: str,
    motion: Motion,
    experiment: Mapping[str, Any],
    identity: Mapping[str, Any],
    clocks: Mapping[str, Any],
    seed: int | None,
    protocol: str,
    initial_state: Mapping[str, Any],
    extra: Mapping[str, Any] | None = None,
    host: Mapping[str, Any] | None = None,
    columns: Sequence[Column] = COLUMNS,
) -> dict[str, Any]:
    """Return the header of a recording as JSON types, so that every file format gives back an equal header.

    Parameters
    ----------
    rig
        Name of the rig.
    motion
        "rotary" or "linear", which decides the units of the columns.
    experiment
        All parameters of the experiment, with the values that control law and device use.
    identity
        Description that the device sent of itself, as a dictionary.
    clocks
        Kind, origin and offset of the host's and the device's clock.
    seed
        Seed of all random numbers of the trial; None if the trial uses no random numbers.
    protocol
        Version of the wire protocol.
    initial_state
        State of estimator, control law and guard before the first row, as lists of numbers. All bits are stored, so
        that a replay starts from the same state; ``[float(x) for x in …]`` also restores NaN and infinities.
    extra
        Further facts about the trial that are equal when the trial is repeated.
    host
        Facts about this run on this machine (e.g. the obtained scheduling), added to `host_facts`.
    columns
        Columns of the rows.
    """
    header = lossless(
        {
            "format": FORMAT,
            "version": VERSION,
            "rig": rig,
            "motion": motion,
            "experiment": experiment,
            "identity": identity,
            "clocks": clocks,
            "seed": seed,
            "versions": versions(protocol),
            "schema": make_schema(columns, motion),
            "initial_state": initial_state,
            "extra": extra or {},
            "created": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "host": {**host_facts(), **(host or {})},
            "git": git_revision(Path.cwd()),
        }
    )
    assert isinstance(header, dict)
    return header


def check_version(path: Path, found: object) -> None:
    """Raise `RecordingError` if `found`, the format version of the file `path`, is not the version read here."""
    if found != VERSION:
        raise RecordingError(
            f"{path} is a recording of format version {found}, and this version of haptic-rig reads version {VERSION}",
            remedy="open it with the version of haptic-rig that recorded it, or record again",
        )


def repeatable(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return the header without date, host and git revision: the part that is equal for two runs with the same seed."""
    return {key: value for key, value in header.items() if key not in VOLATILE}


def versions(protocol: str) -> dict[str, str]:
    """Return the versions of Python, haptic-rig, numpy, numba and the wire protocol, by name."""
    installed = {name: _installed(name) for name in ("haptic-rig", "numpy", "numba")}
    return {"python": platform.python_version(), "protocol": protocol, **installed}


# Cached: the search for a package reads the disk, and the loaded version does not change within a process.
@cache
def _installed(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def host_facts() -> dict[str, Any]:
    """Return name, operating system and number of processors of this machine; nothing about the user."""
    system = platform.uname()
    return {
        "name": system.node,
        "system": system.system,
        "release": system.release,
        "machine": system.machine,
        "cpus": os.cpu_count(),
    }


def git_revision(directory: Path) -> dict[str, Any] | None:
    """Return the git commit of a directory (`revision`), and if tracked files were edited (`dirty`); None outside git.

    `dirty` is None if git cannot compare the files. A file that a git filter converts counts as edited after it was
    touched. The result is cached for up to a second.
    """
    # At most one call of git a second: it takes longer than many simulated hits.
    return _describe(directory, int(time.monotonic()))


@lru_cache(maxsize=8)
def _describe(directory: Path, second: int) -> dict[str, Any] | None:
    """Return commit and dirty state for `git_revision`; never run programs that the checkout's configuration names.

    `second` is the current second, by which the result is cached.
    """
    try:
        answer = _git(
            directory, "rev-parse", "HEAD", "--show-toplevel", "--git-path", "index", "--git-path", "objects"
        )
        revision, top, index, objects = answer.removesuffix("\n").split("\n")
        # `git status` with the checkout's own configuration would run the programs in core.fsmonitor and filters. An
        # empty git directory has no configuration and hooks; it refers to the checkout's index and objects.
        with scratch("git") as place:
            empty = str(place)
            for name in ("objects", "refs"):
                (place / name).mkdir()
            (place / "HEAD").write_text(revision, encoding="utf-8")
            own = {
                "GIT_DIR": empty,
                "GIT_WORK_TREE": top,
                "GIT_INDEX_FILE": str(directory / index),
                "GIT_OBJECT_DIRECTORY": str(directory / objects),
                "GIT_CONFIG_NOSYSTEM": "1",
                "HOME": empty,
                "XDG_CONFIG_HOME": empty,
            }
            asked = ("status", "--porcelain", "--untracked-files=no", "--ignore-submodules=dirty")
            try:
                dirty = _git(directory, "-c", "core.fileMode=false", *asked, **own) != ""
            except subprocess.SubprocessError:
                dirty = None
    except (OSError, subprocess.SubprocessError, ValueError):
        return None
    return {"revision": revision, "dirty": dirty}


def _git(directory: Path, *arguments: str, **own: str) -> str:
    """Return the output of a git command; with `own` environment variables, all other GIT_ variables are removed."""
    inherited = {name: value for name, value in os.environ.items() if not (own and name.startswith("GIT_"))}
    return subprocess.run(
        [find_program("git") or "", "-C", str(directory), *arguments],
        capture_output=True,
        check=True,
        timeout=2.0,
        encoding="utf-8",
        errors="surrogateescape",
        stdin=subprocess.DEVNULL,
        env={**inherited, "PATH": installed_path(), "GIT_OPTIONAL_LOCKS": "0", **own},
    ).stdout


@cache
def checkout() -> dict[str, str]:
    """Return ``{"commit": TEXT}`` for the git checkout that this program runs from; {} outside a checkout."""
    sources = Path(__file__).parents[2]
    found = git_revision(sources) if (sources / ".git").exists() else None
    if found is None:
        return {}
    changes = {True: " with changes", False: "", None: ", changes unknown"}
    return {"commit": found["revision"][:12] + changes[found["dirty"]]}


def _field(dtype: np.dtype[np.void], name: str) -> tuple[np.dtype[Any], int]:
    fields = dtype.fields
    assert fields is not None
    return fields[name][0], fields[name][1]
