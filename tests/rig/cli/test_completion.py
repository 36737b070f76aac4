"""Shell completions: without heavy imports, and from a table that matches the commands."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import rig.cli
from rig.cli import _listing as listing
from rig.cli import _values as values
from rig.cli import complete, completion_table, options
from rig.config import presets
from rig.control import estimators
from rig.control.verdict import Kind
from rig.core.operators import GRIPS
from tests.conformance.tiers import first_by_default

ROOT = str(Path(rig.cli.__file__).parents[2])
TOO_HEAVY = ("numpy", "numba", "scipy", "pydantic", "matplotlib", "pyarrow", "rich")


def asked(words: list[str], shell: str = "fish", **more: Any) -> subprocess.CompletedProcess[str]:
    """Return the completions for a line whose last word is incomplete, as a shell's script requests them."""
    line = {"COMP_WORDS": " ".join(["rig", *words]), "COMP_CWORD": words[-1]}
    return subprocess.run(
        [sys.executable, *more.pop("options", []), "-m", "rig"],
        env={**os.environ, "PYTHONPATH": ROOT, **line, complete.ASKED: f"{shell}_complete"},
        capture_output=True, text=True, timeout=60, check=False, **more,
    )  # fmt: skip


def completed(*words: str) -> list[str]:
    os.environ["COMP_WORDS"] = " ".join(["rig", *words])
    bash = complete.Bash(complete.tree(listing.commands()), {}, "rig", complete.ASKED)
    return [line.partition(",")[2] for line in bash.complete().splitlines()]


def test_the_tables_are_those_of_the_commands() -> None:
    for path, text in completion_table.made().items():
        assert path.read_text(encoding="utf-8") == text, "run: python -m rig.cli.completion_table"


def test_a_completion_imports_nothing_heavy() -> None:
    done = asked(["hit", "--estimator", "ka"], options=["-X", "importtime"])
    imported = {line.rpartition("|")[2].strip().partition(".")[0] for line in done.stderr.splitlines()}
    assert "click" in imported
    assert imported.isdisjoint(TOO_HEAVY)
    assert "kalman" in done.stdout


def test_values_are_completed_by_what_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("mine.toml", "a.parquet", "b.rigcap", "c.csv"):
        (tmp_path / name).write_text("")
    (tmp_path / "below").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COMP_WORDS", "")
    assert completed("im") == ["impedance"]
    assert completed("estimators", "ex") == ["export"]
    assert completed("hit", "--estimator", "kal") == ["kalman"]
    assert completed("hit", "--rig", "") == [*presets.names(), "below/", "mine.toml"]
    assert completed("show", "") == ["a.parquet", "b.rigcap", "below/"]
    assert completed("experiment", "plan", "m") == ["mine.toml"]
    assert completed("zwidth", "--scheme", "du") == ["dual:"]
    assert completed("zwidth", "--scheme", "dual:20k/2k,estimator=lev") == ["dual:20k/2k,estimator=levant"]
    assert completed("hit", "--loop", "d") == ["device"]
    assert completed("hit", "--exp") == ["--expect"]
    assert "sim://koul-rigid" in completed("device", "show", "sim://k")


@pytest.mark.parametrize(
    ("line", "expected"),
    first_by_default(
        [
            ("rig hit --url=sim://koul-r", ["//koul-rigid"]),
            ("rig estimators export ka", ["kalman"]),
            ("rig show here/", ["here/a.parquet"]),
        ]
    ),
)
def test_bash_receives_the_part_of_a_word_that_it_adds(
    line: str, expected: list[str], tmp_path: Path, capsys: Any
) -> None:
    """bash ends a word at : or =, so only the part after the last one is sent."""
    if shutil.which("bash") is None:
        pytest.skip("bash is not installed (package bash)")
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "a.parquet").write_text("")
    program = tmp_path / "rig"
    program.write_text(
        f"#!/bin/sh\nPYTHONPATH={shlex.quote(str(ROOT))} exec {shlex.quote(sys.executable)} -m rig\n"
    )
    program.chmod(0o755)
    assert complete.answer("bash_source") == 0
    asking = f"""{capsys.readouterr().out}
        compopt() {{ :; }}
        COMP_LINE={shlex.quote(line)} COMP_POINT={len(line)} COMPREPLY=()
        _rig_completion {program}
        printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(
        ["bash"], input=asking, capture_output=True, text=True, timeout=60, cwd=tmp_path, check=True
    )
    assert done.stdout.splitlines() == expected, done.stderr


def test_the_names_of_estimators_are_those_of_the_family() -> None:
    assert values.estimators() == estimators.names()


def test_verdicts_and_grips_are_those_of_the_rig() -> None:
    assert ("none", *GRIPS) == values.GRIPS
    assert tuple(kind.value.replace(" ", "-") for kind in Kind) == options.VERDICTS


@pytest.mark.parametrize("shell", complete.SHELLS)
def test_the_script_of_a_shell_requests_our_completions(shell: str, capsys: Any) -> None:
    assert complete.answer(f"{shell}_source") == 0
    text = capsys.readouterr().out
    assert f"{complete.ASKED}={shell}_complete" in text
    found = shutil.which(shell)
    if found is not None:
        subprocess.run([found, "-n"], input=text, text=True, check=True, timeout=20)
