"""Fixtures of the tests of reproductions."""

import pytest

from rig.views.plots import style


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw pictures with few pixels."""
    monkeypatch.setattr(style, "DPI", 10)
