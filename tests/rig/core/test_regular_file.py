"""A file named by a user or a page is read only if it is a regular file of limited size."""

import itertools
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from rig.config import presets
from rig.core import regular_file
from rig.core.errors import RigError
from rig.experiments.mapping import _maps as maps
from rig.experiments.sweep._journal import read_on
from rig.extras.drives.odrive import Endpoints
from rig.firmware._flash import read_image
from rig.recording.counts import read_counts
from rig.recording.reader import open_facts, open_recording
from rig.session.planning._load import load_protocol

if sys.platform == "win32":
    pytest.skip("no file there is a FIFO or a device", allow_module_level=True)

READERS: dict[str, Callable[[Path], Any]] = {
    "a rig": presets.load_named,
    "a protocol": load_protocol,
    "a recording": open_recording,
    "a recording's header": open_facts,
    "a map": lambda path: maps.read_plan(path.parent),
    "a journal": read_on,
    "an image": read_image,
    "endpoints": lambda path: Endpoints.load(str(path)),
    "counts": lambda path: read_counts(path, count="count", resolution=1e-3, period_s=1e-3),
}
NAMED = {"a map": maps.PLAN, "a rig": "rig.toml"}


@pytest.mark.timeout(60)  # a reader that opens a FIFO never comes back
@pytest.mark.parametrize("what", ["fifo", "/dev/zero", "directory"])
@pytest.mark.parametrize("kind", READERS)
def test_no_reader_opens_a_file_that_is_not_regular(kind: str, what: str, tmp_path: Path) -> None:
    path = tmp_path / NAMED.get(kind, "file")
    if what == "fifo":
        os.mkfifo(path)
    elif what == "directory":
        path.mkdir()
    else:
        path.symlink_to(what)
    with pytest.raises(RigError, match=r"not a regular file|[Ii]s a directory") as refused:
        READERS[kind](path)
    assert refused.value.remedy


@pytest.mark.parametrize("kind", ["a rig", "a protocol", "a map", "an image", "endpoints", "counts"])
def test_a_text_is_read_up_to_a_bound(kind: str, tmp_path: Path) -> None:
    path = tmp_path / NAMED.get(kind, "file")
    with open(path, "wb") as file:
        file.truncate(1 << 40)  # it takes no room on the disk
    with pytest.raises(RigError, match=r"larger than 1 MiB|larger than 64 MiB|larger than 2048 MiB"):
        READERS[kind](path)


def test_a_file_that_changes_into_a_fifo_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "fifo")
    looked = os.stat(__file__)
    monkeypatch.setattr(regular_file.os, "stat", lambda path: looked)
    with pytest.raises(OSError, match="not a regular file"):
        regular_file.open_regular(tmp_path / "fifo")


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_ctrl_c_at_any_line_of_opening_is_ctrl_c(tmp_path: Path) -> None:
    """An interrupt after `os.fdopen` once became "Bad file descriptor", because the descriptor was closed twice."""
    (tmp_path / "file").write_bytes(b"text")

    def interrupted_at(step: int) -> bool:
        steps = itertools.count()

        def trace(frame: FrameType, event: str, value: object) -> Any:
            del value  # the traceback would keep a returned file
            if frame.f_globals.get("__name__") not in (regular_file.__name__, "os"):
                return None
            if event in ("line", "return") and next(steps) == step:
                raise KeyboardInterrupt
            return trace

        traced = sys.gettrace()
        sys.settrace(trace)
        try:
            regular_file.open_regular(tmp_path / "file").close()
        except KeyboardInterrupt:
            return True
        finally:
            sys.settrace(traced)
        return False

    assert sum(itertools.takewhile(bool, map(interrupted_at, itertools.count()))) > 5
