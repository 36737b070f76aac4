"""What a command says while it compiles."""

import sys
import time

import pytest

from rig.cli._compiling import CompilingNotice
from rig.realtime import compiling


def shown(expected: int, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Lines of a log in which twenty kernels are compiled, until the notice has spoken twice."""
    notice = CompilingNotice(expected)
    notice(True)
    said: list[str] = []
    while len(said) < 3:
        time.sleep(0.01)
        said += capsys.readouterr().err.splitlines()
    notice(False)
    return [line.strip() for line in said]


def test_a_log_has_what_is_done_and_what_is_left_where_that_is_known(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.modules[CompilingNotice.__module__], "LINE_S", 0.05)
    monkeypatch.setitem(compiling._count, "kernels", 20)
    first, second, *_ = shown(60, capsys)
    assert first == "compiling the code of this run (once per version and machine) …"
    assert second == "still compiling: 20 kernels in 0 s, about 1 s left"
    assert shown(0, capsys)[1] == shown(20, capsys)[1] == "still compiling: 20 kernels in 0 s"
