"""Repeat a test, each time with one fault at another frame of its link.

The plug-in's marker ``rig_every_frame`` uses it. It must not be used on a real rig.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import wraps
from typing import Any

import pytest

from rig.devices.fault_script import Direction, FaultKind, FrameFault
from rig.testing.fault_words import DIRECTIONS, KINDS, direction_of, kind_of
from rig.testing.hits import Hits

# In each direction: a run with more frames is not a short one (`rig_experiment.short()`).
MOST_FRAMES = 1000


def with_every_frame(
    test: Callable[..., object], hits: Hits, kinds: Sequence[str], to: str | None
) -> Callable[..., None]:
    """Return a test that runs the given test with a fault at each frame in turn.

    The test runs once without a fault, then once for each kind of fault and each frame of its run. Frames with pages of
    the device's dictionary are left out, because a process reads them only once. Fixtures are created once for all
    runs. The error is that of the first run that failed, with a note on the frame and on the number of failed runs.
    Raise `ConfigError` if the kind or the direction is unknown.

    Parameters
    ----------
    test
        Test function, which must run its trial with the fixture `rig_hit`.
    hits
        The test's fixture `rig_hit`, which injects the faults.
    kinds
        Kinds of faults of `rig.testing.FaultWords.link`; empty for all kinds.
    to
        Receiver of the frames: ``host`` or ``device``; None for both.
    """
    chosen = [kind_of(word) for word in kinds or KINDS]
    ways = [direction_of(word) for word in ([to] if to else DIRECTIONS)]

    @wraps(test)
    def every(**given: Any) -> None:
        test(**given)
        if hits.last is None:
            pytest.fail("a test with rig_every_frame must hit by the fixture rig_hit, and this one does not")
        failed: list[tuple[FrameFault, BaseException]] = []
        runs, before = 0, hits.faults.script
        for fault in (one for kind in chosen for way in ways for one in _faults(kind, way, hits)):
            hits.faults.script, hits.last = before, None
            hits.faults.add(frames=(fault,))
            try:
                test(**given)
            except pytest.exit.Exception:  # a person's stop
                raise
            except (Exception, pytest.fail.Exception) as error:
                failed.append((fault, error))
            runs += _struck(hits)
        hits.faults.script = before
        if failed:
            fault, first = failed[0]
            first.add_note(
                f"rig_every_frame: {len(failed)} of {runs} faults fail; the first: {fault.kind.value} of frame "
                f"{fault.frame} {fault.direction.value}"
            )
            raise first

    return every


def _struck(hits: Hits) -> bool:
    """Return True if the latest run applied the fault to a frame, or if it raised an error before its end."""
    return hits.last is None or hits.last.struck > 0


def _faults(kind: FaultKind, direction: Direction, hits: Hits) -> Iterator[FrameFault]:
    """Yield a fault of frame 0, 1, …, until a run has no frame with this number; fail the test beyond 1000 frames."""
    for frame in range(MOST_FRAMES):
        yield FrameFault(kind=kind, direction=direction, frame=frame, byte=frame, bit=frame % 8)
        if not _struck(hits):
            return
    pytest.fail(
        f"rig_every_frame: the run has more than {MOST_FRAMES} frames; make it short: rig_experiment.short()"
    )
