"""Fixtures for the tests of the command line: run a command, and make its pictures quick to draw."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

import rig.cli
from rig.analysis.theory import _summary as summary
from rig.cli.hit import Artist
from rig.views.plots import style
from rig.views.plots.hit import draw_hit


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that runs a command in an empty directory and returns exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: Any) -> Any:
        code = rig.cli.run([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        assert "Traceback" not in err
        return code, out, err

    return call


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw at few pixels and in this process: starting a drawing process takes as long as a whole hit."""

    def draw(artist: Artist, recording: Path) -> str | None:
        ending = artist._ending
        return str(draw_hit(recording, recording.with_suffix(f".{ending}"))) if ending else None

    monkeypatch.setattr(style, "DPI", 10)
    monkeypatch.setattr(Artist, "__enter__", lambda artist: artist)
    monkeypatch.setattr(Artist, "draw", draw)


@pytest.fixture
def undrawn(coarse: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compose each picture but save an empty file: layout and drawing, which are matplotlib's, take longest."""

    def save(figure: Any, path: Path) -> Path:
        assert figure.axes
        path.touch()
        return path

    monkeypatch.setattr(style, "save", save)


@pytest.fixture
def few_curve_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute curves at few points; the limits at B = 0 and at the wall's damping do not depend on the number."""
    for name, number in {"CURVE_POINTS": 5, "CORNER_POINTS": 3, "PASSIVE_POINTS": 5}.items():
        monkeypatch.setattr(summary, name, number)
    with suppress(ImportError):  # without this extra
        monkeypatch.setattr("rig.extras.papers.chawda.levant_plot._POINTS", 10)
