"""A bench opens its simulated device anew when somebody takes the hand over that was scripted before."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rig import config
from rig.config import presets
from rig.session import hits

HELD = config.override(presets.load("koul-compliant"), {"trial.kind": "human"})


@dataclass
class Opened:
    """A device that only knows where it was opened."""

    url: str


def test_whoever_takes_the_hand_over_gets_another_device(monkeypatch):
    closed = []

    @contextmanager
    def opened(url, model, **options):
        yield Opened(url)
        closed.append(url)

    monkeypatch.setattr(hits, "opened", opened)
    bench = hits.RigBench(realtime=True)
    scripted = bench._device(HELD, {})
    assert bench._device(HELD, {}) is scripted
    bench.hand = Path("/somewhere/hand")
    driven = bench._device(HELD, {})
    assert (scripted.url, driven.url) == ("sim://", "sim://?hand=/somewhere/hand")
    assert closed == [scripted.url]
    assert bench._device(HELD, {}) is driven
    bench.close()
    assert closed == [scripted.url, driven.url]
