"""Compare the runs of a test with golden recordings: recordings that a person has checked and stored as expected.

In virtual time a run is reproducible to the last bit on one machine, but another processor or another build of a
library may round differently. So integers (counts, currents, flags, ticks) must be equal, and real columns may differ
by the rounding errors that can accumulate over the run. The fixture ``rig_golden`` returns it. It must not write a
recording unless the user requests an update.
"""

import shutil
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import RecordingError
from rig.core.present import duration, written
from rig.core.sample import phase_name
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from rig.testing.asserts import Subject, recording_of

# Roundings of half a unit in the last place that a tick of law and plant may add to a column, in units of its peak:
# some tens of floating-point operations each. A stable loop does not amplify them, so they add up at most. Measured on
# 2026-11-26: kernels for a generic x86-64 and another BLAS left every recorded column equal, and the truth within 0.09.
ROUNDINGS = 64
DIRECTORY = "golden"


class Golden:
    """Callable that compares the recordings of a test with its stored, checked ones (the fixture ``rig_golden``).

    Parameters
    ----------
    test, name
        The test's file and its name, which give the path of its golden recordings.
    update
        True to replace the golden recordings by the present recordings.
    """

    def __init__(self, test: Path, name: str, *, update: bool) -> None:
        self._directory, self._name, self._update = test.parent / DIRECTORY, f"{test.stem}.{name}", update

    def __call__(
        self, subject: Subject, name: str = "", *, tolerance: Mapping[str, float] | None = None
    ) -> None:
        """Compare a recording with its golden recording, or replace the golden recording (``--rig-golden=update``).

        Parameters
        ----------
        subject
            The result of a hit (fixture `rig_hit`), or a finished recording.
        name
            Name that distinguishes several golden recordings of one test.
        tolerance
            Allowed difference of each named column, in the column's unit. For other columns, only rounding errors are
            allowed.
        """
        __tracebackhide__ = True
        recording = recording_of(subject)
        # Quoted, so that no two names share a file: "soft wall" and "soft_wall" are two tests.
        quoted = quote(f"{self._name}{name and f'.{name}'}", safe="[]=,")
        golden = self._directory / f"{quoted}.parquet"
        if self._update:
            assert recording.path is not None, (
                "a recording without a file cannot be compared with a golden recording"
            )
            golden.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(recording.path, golden)
            return
        if not golden.exists():
            raise AssertionError(
                f"there is no golden recording {golden}: look at {recording.path}, and if it is right, run pytest "
                "--rig-golden=update and commit the file"
            )
        differences = difference(open_recording(golden), recording, tolerance or {})
        if differences:
            raise AssertionError(
                f"{differences}\ngolden: {golden}\ntoday:  {recording.path}\n"
                "if today's recording is right, run: pytest --rig-golden=update"
            )


def difference(golden: Recording, today: Recording, tolerance: Mapping[str, float]) -> str:
    """Return a text about the first row in which two recordings differ, with all different columns; "" if they agree.

    `tolerance` is the allowed difference by column. Raise `RecordingError` for a tolerance of an unknown column.
    """
    names = [name for name in golden.names if name in today.names]
    unknown = [name for name in tolerance if name not in names]
    if unknown:
        raise RecordingError(
            f"a tolerance is given for the unknown column {unknown[0]!r}",
            remedy=f"choose one of the columns: {', '.join(names)}",
        )
    rows = min(len(golden), len(today))
    differing = {name: _differing_rows(golden, today, name, rows, tolerance.get(name)) for name in names}
    first = min((int(found.argmax()) for found in differing.values() if found.any()), default=rows)
    if first == rows:
        return (
            ""
            if len(golden) == len(today)
            else f"{len(today)} rows, and {len(golden)} in the golden recording"
        )
    passed = duration(int(golden.rows["device_time"][first] - golden.rows["device_time"][0]))
    phase = phase_name(int(golden.rows["phase"][first]))
    columns = sum(found.any() for found in differing.values())
    lines = [
        f"differs from the golden recording from row {first} on ({passed}, {phase}), in {columns} columns; there:"
    ]
    for name in names:
        if differing[name][first]:
            was, now = golden.rows[name][first].item(), today.rows[name][first].item()
            line = f"  {name}: {now!r} {golden.units[name]}, was {was!r} (by {written(now - was)}"
            allowed = 0.0 if isinstance(was, int) else _allowed_difference(golden, name, tolerance.get(name))
            lines.append(f"{line}, allowed {written(allowed, 2)})")
    return "\n".join(lines)


def _differing_rows(
    golden: Recording, today: Recording, name: str, rows: int, tolerance: float | None
) -> NDArray[np.bool_]:
    was, now = golden.column(name)[:rows], today.column(name)[:rows]
    if was.dtype.kind != "f" and tolerance is None:
        return np.asarray(was != now)
    allowed = _allowed_difference(golden, name, tolerance)
    return np.asarray(~np.isclose(now, was, rtol=0.0, atol=allowed, equal_nan=True))


def _allowed_difference(golden: Recording, name: str, tolerance: float | None) -> float:
    """Return the allowed difference of a column: `tolerance`, or if it is None, the rounding errors of all ticks."""
    if tolerance is not None:
        return tolerance
    peak = float(np.nanmax(np.abs(golden.column(name)), initial=0.0))
    return 0.5 * ROUNDINGS * len(golden) * float(np.finfo(np.float64).eps) * peak
