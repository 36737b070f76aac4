"""Fixtures of the tests of reproductions."""

import pytest

from rig.views.plots import style


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw pictures with few pixels, and once: the layout would draw each a second time."""
    monkeypatch.setattr(style, "DPI", 10)
    monkeypatch.setattr("matplotlib.figure.Figure.get_layout_engine", lambda _: None)
