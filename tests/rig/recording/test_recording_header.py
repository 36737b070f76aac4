"""The recording header: canonical JSON, exact floats, units by motion, and volatile values in three keys only."""

import json
import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.core.sample import COLUMNS, TRUTH_COLUMNS
from rig.recording.canonical import canonical_json
from rig.recording.header import VOLATILE, git_revision, make_schema, repeatable
from tests.conformance.recording import example_header

texts = st.text(st.characters())
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | texts,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4),
    max_leaves=20,
)


@given(json_values)
def test_json_values_come_back_from_one_spelling(value: Any) -> None:
    """File names that are not UTF-8 work too; Python represents them as lone surrogates."""
    spelled = canonical_json(value)
    assert json.loads(spelled) == value
    assert canonical_json(_reversed(value)) == spelled


def _reversed(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _reversed(value[key]) for key in reversed(list(value))}
    return [_reversed(item) for item in value] if isinstance(value, list) else value


@given(st.lists(st.floats(allow_nan=False)))
def test_floats_keep_their_bits(values: list[float]) -> None:
    back = [float(value) for value in json.loads(canonical_json(np.array(values)))]
    assert np.array(back).tobytes() == np.array(values).tobytes()


def test_nan_is_spelled_as_a_string() -> None:
    """Strict JSON can be read in every language, and `float` parses the string."""
    text = canonical_json({"state": np.array([np.nan, -np.inf, 1.5])})
    assert text == b'{"state":["NaN","-Infinity",1.5]}'
    assert np.isnan(float(json.loads(text)["state"][0]))


@pytest.mark.parametrize(("motion", "unit"), [("rotary", "N·m"), ("linear", "N")])
def test_units_follow_the_motion(motion: Any, unit: str) -> None:
    units = {
        column["name"]: column["unit"]
        for column in make_schema([*COLUMNS, *TRUTH_COLUMNS], motion)["columns"]
    }
    assert units["effort_wall"] == units["effort_true"] == unit
    assert units["current_measured"] == "A"
    assert not {"position", "velocity", "effort"} & set(units.values())


def test_headers_of_equal_runs_differ_only_in_three_keys() -> None:
    first, second = example_header(), example_header(host={"scheduling": "fifo"})
    assert first["host"] != second["host"]
    assert canonical_json(repeatable(first)) == canonical_json(repeatable(second))
    assert set(first) - set(repeatable(first)) == set(VOLATILE) == {"created", "host", "git"}


GIT = str(shutil.which("git"))


def git(place: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=x", "-c", "user.email=x@example.org", "-c", "commit.gpgsign=false"]
    command = [GIT, "-C", str(place), *identity, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


# What a repository may name a program in; each would run in `git describe --dirty`, `git status`, or a fetch of
# objects that are missing.
PROGRAMS = (
    "core.fsmonitor", "filter.any.clean", "filter.any.smudge", "filter.any.process", "diff.any.textconv",
    "diff.any.command", "diff.external", "core.pager", "pager.status", "pager.rev-parse", "core.editor",
    "core.sshCommand", "core.alternateRefsCommand", "credential.helper", "gpg.program", "uploadpack.packObjectsHook",
)  # fmt: skip


def test_no_program_that_a_checkout_names_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place, marker = tmp_path / "checkout", tmp_path / "ran"
    inside = place / "inside"
    inside.mkdir(parents=True)
    hooks = place / "hooks"
    hooks.mkdir()
    program = hooks / "post-index-change"
    program.write_text(f'#!/bin/sh\necho "$0 $*" >> {marker}\ncat\n')
    program.chmod(0o755)
    for name in ("git", "reference-transaction"):
        shutil.copy(program, place / name)
        shutil.copy(program, inside / name)

    git(place, "init", "-q")
    (place / "a").write_text("1")
    (place / ".gitattributes").write_text("* filter=any diff=any\n")
    git(place, "add", "a", ".gitattributes")
    git(place, "commit", "-qm", "first")
    for key in PROGRAMS:
        git(place, "config", key, str(program))
    git(place, "config", "core.hooksPath", str(hooks))
    os.utime(place / "a", (1e9, 1e9))  # so that only its content shows that it is as committed
    revision = git(place, "rev-parse", "HEAD")
    monkeypatch.chdir(inside)
    monkeypatch.setenv("PATH", os.pathsep.join(["", ".", os.environ["PATH"]]))

    assert git_revision(inside) == {"revision": revision, "dirty": False}
    (place / "a").write_text("2")
    assert git_revision(place) == {"revision": revision, "dirty": True}
    assert not marker.exists(), marker.read_text()
    git(place, "describe", "--dirty", "--always")
    assert marker.exists(), "the test's own programs do not run"


def test_revision_without_its_commit_is_not_called_clean(tmp_path: Path) -> None:
    subprocess.run([GIT, "init", "-q", str(tmp_path)], check=True)
    (tmp_path / ".git" / "HEAD").write_text("0" * 39 + "1\n")  # a commit that is missing
    assert git_revision(tmp_path) == {"revision": "0" * 39 + "1", "dirty": None}


def test_without_git_there_is_no_revision(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert git_revision(tmp_path) is None
