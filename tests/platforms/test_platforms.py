"""The usual commands on emulated Windows and macOS; rig/docs/how-to/other-systems.md has the limits of this."""

import builtins
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from rig.experiments.motion.pulse import PUSHES
from tests.conformance.started import started
from tests.conformance.tiers import first_by_default
from tests.platforms import emulated
from tests.platforms.everyday import LINUX_ALONE

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {**{name: value for name, value in os.environ.items() if name != "CC"}, "PYTHONPATH": str(ROOT)}
WAIT_S = 300.0  # a busy machine with an empty cache took 110


@contextmanager
def programs(place: Path) -> Iterator[Callable[..., Any]]:
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    environment = ENVIRONMENT | {"LOCALAPPDATA": str(place / "local")}
    with ExitStack() as stack:

        def start(module: str, *words: str, **more: Any) -> Any:
            command = (sys.executable, "-m", f"tests.platforms.{module}", *words)
            return stack.enter_context(started(*command, env=environment, **pipes, **more))

        yield start


@pytest.mark.timeout(2 * WAIT_S)
@pytest.mark.exhaustive("::test_commands_load_without_the_modules_of_linux")
def test_usual_commands_off_linux_run_to_the_end_with_equal_rows(tmp_path: Path) -> None:
    # Rows are equal to the last bit: of the readable device without a C compiler, and of the firmware.
    with programs(tmp_path) as start:
        processes = {}
        for platform in ("darwin", "win32"):
            (tmp_path / platform).mkdir()
            processes[platform] = start("everyday", platform, cwd=tmp_path / platform)
        printed = {
            platform: process.communicate(timeout=WAIT_S)[0] for platform, process in processes.items()
        }
    assert {process.returncode for process in processes.values()} == {0}, printed
    rows = [
        pq.read_table(*(tmp_path / platform).glob("recordings/koul-compliant*.parquet"))
        for platform in printed
    ]
    assert rows[0].equals(rows[1])


@pytest.mark.timeout(2 * WAIT_S)
@pytest.mark.quiet
def test_a_board_that_runs_the_law_is_hit_off_linux(tmp_path: Path) -> None:
    with programs(tmp_path) as start:
        board = start("board", cwd=ROOT)
        url = next(line.strip() for line in board.stdout if line.startswith("serial://"))
        host = start("everyday", "win32", url, cwd=tmp_path)
        printed = host.communicate(timeout=WAIT_S)[0]
    assert host.returncode == 0, printed
    _, with_a_person = map(
        json.loads, (line for line in printed.splitlines() if "supervise_lifetime_s" in line)
    )
    assert "hands off the handle" in with_a_person["err"]  # the board had pushed before
    assert len(list(tmp_path.glob("recordings/*-pulse*.parquet"))) == PUSHES


A_GLANCE = """
import sys
from tests.platforms.emulated import emulate
from tests.platforms.everyday import preload
preload()
emulate(sys.argv[1])
from rig import cli
assert cli.run(["device", "list"]) == 0
assert cli.run(["session", "new", "study.toml"]) == 0
sys.exit(cli.run(["serve", "rig"]))
"""


@pytest.mark.parametrize("platform", first_by_default(["win32", "darwin"]))
def test_commands_load_without_the_modules_of_linux(platform: str, tmp_path: Path) -> None:
    environment = ENVIRONMENT | {"LOCALAPPDATA": str(tmp_path)}
    command = [sys.executable, "-c", A_GLANCE, platform]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert LINUX_ALONE in done.stderr
    assert (tmp_path / "study.toml").exists()


def test_emulation_hides_names_from_our_packages_alone_and_keeps_open_files(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(builtins, "__import__", emulated.import_of("win32", builtins.__import__))
    ours, theirs = {"__name__": "rig.core.made_up"}, {"__name__": "numpy.made_up"}
    exec("import os, sys", ours)
    exec("import os, sys, fcntl", theirs)
    assert (ours["sys"].platform, theirs["sys"].platform) == ("win32", "linux")  # type: ignore[attr-defined]
    assert (hasattr(ours["os"], "getuid"), hasattr(theirs["os"], "getuid")) == (False, True)
    with pytest.raises(ModuleNotFoundError):
        exec("import fcntl", ours)
    path = tmp_path / "file"
    with open(path, "wb"), pytest.raises(PermissionError):
        emulated.unless_open(os.unlink)(path)
    emulated.unless_open(os.unlink)(path)


def test_locks_of_windows_lie_after_all_data_and_refuse_a_second_writer(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(builtins, "__import__", emulated.import_of("win32", builtins.__import__))
    place = ROOT / "rig" / "core" / "locks.py"
    locks: dict[str, Any] = {"__name__": "rig.core.locks"}
    exec(compile(place.read_text(), str(place), "exec"), locks)
    assert "msvcrt" in locks
    path = tmp_path / "file"
    path.write_bytes(b"some data")
    with open(path, "rb+") as first, open(path, "rb") as second:
        first.seek(4)
        assert locks["lock"](first.fileno())
        assert first.tell() == 4
        assert not locks["lock"](second.fileno())
        assert second.read() == b"some data"
        assert locks["is_locked"](path)
        locks["unlock"](first.fileno())
        assert not locks["is_locked"](path)
