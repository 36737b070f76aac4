"""Measure the cost of a tick of a hit in virtual time over the byte link, for the C firmware and the Python device.

pytest tests/benchmarks/test_byte_link.py -o addopts="" -s
"""

import time
from pathlib import Path

import pytest

from rig import config
from rig.config import presets
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.loop._run import LoopThread
from rig.realtime import control_words

GOAL_US = 3.0
EXPERIMENT = config.override(presets.load("koul-compliant"), {"trial.duration_s": 0.5})


def measure_tick_us(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, url: str) -> float:
    """Return the loop thread's CPU time per tick (µs), without recorder and sealing: the least of three hits."""
    found = []
    run = LoopThread._run

    def timed(self: LoopThread) -> None:
        started = time.thread_time()
        run(self)
        found.append(1e6 * (time.thread_time() - started) / self.ring.get(control_words.TICKS))

    with monkeypatch.context() as patch:
        patch.setattr(LoopThread, "_run", timed)
        for _ in range(3):
            list(hit(HitRequest(experiment=EXPERIMENT, url=url, output=tmp_path), admit))
    return min(found)


def test_a_tick_over_the_byte_link_passes_no_python(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    readable = measure_tick_us(monkeypatch, tmp_path, "sim://?firmware=0")
    firmware = measure_tick_us(monkeypatch, tmp_path, "sim://")
    print(f"\nbyte link, a tick: {firmware:.2f} µs (goal {GOAL_US:g} µs), through Python {readable:.1f} µs")
    assert firmware < 0.2 * readable
