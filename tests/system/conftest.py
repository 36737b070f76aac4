"""What the tests of commands share."""

from pathlib import Path
from typing import Any

import pytest

import rig.cli
from rig.cli.hit import Artist
from rig.views.plots import style
from rig.views.plots.hit import draw_hit


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run a command line in an empty directory: exit code, standard output, standard error."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: Any) -> Any:
        code = rig.cli.run([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        assert "Traceback" not in err
        return code, out, err

    return call


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures have few pixels, and those of hits are drawn here: to start a process for each costs what a hit does."""

    def draw(artist: Artist, recording: Path) -> str | None:
        ending = artist._ending
        return str(draw_hit(recording, recording.with_suffix(f".{ending}"))) if ending else None

    monkeypatch.setattr(style, "DPI", 10)
    monkeypatch.setattr(Artist, "__enter__", lambda artist: artist)
    monkeypatch.setattr(Artist, "draw", draw)


@pytest.fixture
def undrawn(coarse: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are composed, and their files are empty: layout and drawing are matplotlib's, and take longest."""

    def save(figure: Any, path: Path) -> Path:
        assert figure.axes
        path.touch()
        return path

    monkeypatch.setattr(style, "save", save)
