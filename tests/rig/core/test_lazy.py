"""Public names: declared once, in stubs, and imported at first use."""

import doctest
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import rig
import rig.testing
from rig.core import lazy
from rig.core.lazy import public_names
from tests.conformance.guides import ROOT


@pytest.mark.parametrize("package", [rig, rig.testing])
def test_stub_table_and_package_agree(package: ModuleType) -> None:
    """Each code line of the stub is one name, which exists and is in `dir` and `from … import *`."""
    assert package.__file__ is not None
    table = public_names(package.__file__)
    stub = Path(f"{package.__file__}i").read_text(encoding="utf-8").partition('"""\n\n')[2]
    assert len(stub.split("\n")) == len(table) + 1
    assert package.__all__ == sorted(table)
    assert set(table) <= set(dir(package))
    for name in table:
        assert getattr(package, name) is not None
    assert {name: getattr(package, name) for name in table} == {
        name: value for name, value in _starred(package.__name__).items() if name in table
    }


def test_names_of_a_missing_extra_are_no_names(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    whole = public_names(rig.__file__)
    monkeypatch.setattr(lazy, "_ROOMS", str(tmp_path))
    left = public_names(rig.__file__)
    assert {module.split(".")[1] for name, (module, _) in whole.items() if name not in left} == {"extras"}


def _starred(package: str) -> dict[str, object]:
    names: dict[str, object] = {}
    exec(f"from {package} import *", names)
    return names


EXAMPLES = [name for name in rig.__all__ if ">>>" in (getattr(rig, name).__doc__ or "")]


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_example_of_a_docstring_says_what_comes(name: str) -> None:
    finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner()
    (example,) = finder.find(getattr(rig, name), name, globs={name: getattr(rig, name)})
    assert runner.run(example).failed == 0


@pytest.mark.parametrize(
    ("option", "modules", "heavy"),
    [
        # pytest's plug-in imports it everywhere
        ("-S", "rig, rig.testing", "numpy numba typing re dataclasses"),
        ("-P", "firmware_protocol, rig.cli", "numpy numba scipy matplotlib pyarrow pydantic serial rich"),
    ],
)
def test_importing_it_loads_no_library(option: str, modules: str, heavy: str) -> None:
    script = f"import sys, {modules}; print(*set({heavy!r}.split()) & set(sys.modules))"
    command = [sys.executable, option, "-c", script]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("\n", "")
