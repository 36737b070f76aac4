"""The notice that a command prints while it compiles."""

import sys
import time

import pytest

from rig.cli._compiling import CompilingNotice
from rig.realtime import compiling


def notice_lines(expected: int, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Announce twenty kernels and return what the notice prints, after at least three lines."""
    notice = CompilingNotice(expected)
    notice(True)
    lines: list[str] = []
    while len(lines) < 3:
        time.sleep(0.01)
        lines += capsys.readouterr().err.splitlines()
    notice(False)
    return [line.strip() for line in lines]


def test_a_log_has_the_compiled_kernels_and_the_remaining_time_where_that_is_known(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.modules[CompilingNotice.__module__], "LINE_S", 0.05)
    monkeypatch.setitem(compiling._count, "kernels", 20)
    first, second, *_ = notice_lines(60, capsys)
    assert first == "compiling the code of this run (once per version and machine) …"
    assert second == "still compiling: 20 kernels in 0 s, about 1 s left"
    assert notice_lines(0, capsys)[1] == notice_lines(20, capsys)[1] == "still compiling: 20 kernels in 0 s"
