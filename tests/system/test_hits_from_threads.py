"""Hits in real time from several threads of one program: each runs, and nothing of the program is replaced."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import rig
from tests.rig.core.test_process import looks

HITS = 4
SLOW = {"position_rate": 500, "velocity_rate": 500, "duration_s": 0.6}


@pytest.mark.quiet
def test_four_threads_hit_in_real_time_at_once(tmp_path: Path) -> None:
    before, together = looks(), threading.Barrier(HITS)

    def hit(number: int) -> Path:
        together.wait()
        changes = {"controller.parameters": {"cutoff_hz": 100.0}, "verdict.lowpass_hz": 200.0}
        return rig.hit("koul-compliant", realtime=True, output=tmp_path, changes=changes, **SLOW).path

    with ThreadPoolExecutor(HITS) as threads:
        running = [threads.submit(hit, number) for number in range(HITS)]
    assert looks() == before
    assert len({one.result() for one in running}) == HITS
    assert len(list(tmp_path.glob("*.parquet"))) == HITS
