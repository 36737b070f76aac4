"""A runner opens its simulated device anew when the operator takes over the scripted hand."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from rig import config
from rig.config import presets
from rig.session.engine import _hits as hits

HELD = config.override(presets.load("koul-compliant"), {"trial.kind": "human"})


@dataclass
class Opened:
    """A device with only its URL."""

    url: str


def test_a_hand_taken_over_by_the_operator_needs_another_device(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = []

    @contextmanager
    def opened(url: Any, model: Any, **options: Any) -> Iterator[Any]:
        yield Opened(url)
        closed.append(url)

    monkeypatch.setattr(hits, "opened", opened)
    runner = hits.DeviceRunner(realtime=True)
    scripted = runner._device(HELD, {})
    assert runner._device(HELD, {}) is scripted
    runner.hand = Path("/somewhere/hand")
    driven = runner._device(HELD, {})
    assert (scripted.url, driven.url) == ("sim://", "sim://?hand=/somewhere/hand")
    assert closed == [scripted.url]
    assert runner._device(HELD, {}) is driven
    runner.close()
    assert closed == [scripted.url, driven.url]
