"""Child processes start programs from where they are installed, never from the working directory."""

import os
import shutil
import sys
from pathlib import Path

import pytest

from rig.core.child import find_program
from rig.realtime._c_library import CLibrary


@pytest.mark.skipif(sys.platform == "win32", reason="a script is no program there")
@pytest.mark.parametrize("entry", ["", ".", "inside"])
def test_a_program_of_the_working_directory_is_not_found_by_its_name(
    entry: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "inside").mkdir()
    for program in (place / name for place in (tmp_path, tmp_path / "inside") for name in ("sh", "cc-here")):
        program.write_text("#!/bin/sh\n")
        program.chmod(0o755)
    installed = shutil.which("sh")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", os.pathsep.join([entry, os.environ["PATH"]]))
    assert shutil.which("cc-here") is not None
    assert find_program("cc-here") is None
    assert find_program("sh") == installed
    assert find_program("./cc-here") == "./cc-here"  # a path is used as it is
    monkeypatch.setenv("PATH", entry)
    assert find_program("sh") is None


@pytest.mark.skipif(
    sys.platform == "win32" or shutil.which("cc") is None, reason="a script as linker of a cc"
)
def test_a_compiler_runs_no_linker_of_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("cc", "gcc", "clang", "as", "ld", "collect2"):
        (tmp_path / name).write_text(f"#!/bin/sh\ntouch {tmp_path}/ran\nexit 1\n")
        (tmp_path / name).chmod(0o755)
    (tmp_path / "sources").mkdir()
    (tmp_path / "sources" / "one.c").write_text("int one(void) { return 1; }\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", os.pathsep.join(["", ".", os.environ["PATH"]]))
    made = CLibrary(name="one", root=tmp_path, parts=("sources",), purpose="for a test").compiled(tmp_path)
    assert made.exists()
    assert not (tmp_path / "ran").exists()
