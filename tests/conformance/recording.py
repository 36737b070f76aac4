"""The conformance suite of recording formats, as a function of a writer and a reader."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import RecordingError
from rig.core.sample import COLUMNS, ROW, TRUTH, TRUTH_COLUMNS, Column
from rig.recording.data import Loss, Recording
from rig.recording.header import make_header
from tests.conformance.damaged import each_damaged

AWKWARD = (0.1, -0.0, 5e-324, 1.7976931348623157e308, 1 / 3, float("nan"), float("inf"), float("-inf"))


@dataclass(frozen=True)
class Limits:
    nan_bits: bool = True  # the format keeps the payload of a NaN
    losses: bool = True  # it can report losses of its source
    damage: bool = True  # it detects a changed byte


Write = Callable[[Recording], Path]
Read = Callable[[Path], Recording]


def example_header(**changes: Any) -> dict[str, Any]:
    """Return a header with non-ASCII text, integers above 2**53 and floats that are hard to print exactly."""
    facts: dict[str, Any] = {
        "rig": "Prüfstand 力",
        "motion": "rotary",
        "experiment": {"wall": {"stiffness": 560.0, "damping": 0.1}, "note": 'quote " and\nline'},
        "identity": {"serial": "0007", "current_quantum": 1 / 3},
        "clocks": {"host": {"kind": "virtual", "origin": 2**62 + 1}},
        "seed": 7,
        "protocol": "1.0",
        "initial_state": {"estimator": np.array(AWKWARD), "counts": np.array([2**62 + 1, -1])},
    }
    return make_header(**(facts | changes))


def example_rows(count: int, seed: int = 1, dtype: np.dtype[np.void] = ROW) -> NDArray[np.void]:
    """Return rows of random bits: every integer, every float, every kind of NaN."""
    rows = np.frombuffer(np.random.default_rng(seed).bytes(count * dtype.itemsize), dtype).copy()
    floats = [name for name in dtype.names or () if dtype[name] == np.float64]
    for row, name in zip(range(count), floats, strict=False):
        rows[name][row] = AWKWARD[row % len(AWKWARD)]
    return rows


def example_truth(sample_index: NDArray[np.int64]) -> NDArray[np.void]:
    """Return simulated truth whose values encode their sample index."""
    truth = np.zeros(len(sample_index), TRUTH)
    truth["sample_index"] = sample_index
    for number, column in enumerate(TRUTH_COLUMNS):
        truth[column.name] = sample_index + number / 8
    return truth


def check_recording_format(write: Write, read: Read, limits: Limits) -> None:
    """Run all checks on one format; `write` puts a recording in a new place, `read` may raise `RecordingError`."""
    check_every_row_comes_back(write, read, limits)
    check_header_and_trailer_come_back(write, read)
    check_any_columns_come_back(write, read, limits)
    check_an_unfinished_recording_stays_unfinished(write, read)
    if limits.losses:
        check_losses_are_passed_on(write, read)
    if limits.damage:
        check_no_damage_is_silent(write, read)


def check_every_row_comes_back(write: Write, read: Read, limits: Limits) -> None:
    """Rows keep all bits of all columns, for row counts around the size of a block."""
    for count in (0, 1, 2, 999, 1000, 1001):
        recording = Recording(example_header(), example_rows(count, seed=count), {"reason": "finished"})
        _assert_equal_rows(read(write(recording)), recording, limits)


def check_header_and_trailer_come_back(write: Write, read: Read) -> None:
    """Header, trailer, units and descriptions are kept; floats keep all their bits."""
    trailer = {"reason": "stopped — by a person", "statistics": {"p99_ns": 12345, "ripple": 0.1 + 0.2}}
    recording = Recording(example_header(), example_rows(3), trailer)
    found = read(write(recording))
    assert found.header == recording.header
    assert found.trailer == trailer
    assert found.complete
    assert found.lost == ()
    assert found.units["effort_sent"] == "N·m"
    assert found.units["received_at"] == "ns"
    assert found.descriptions == {column.name: column.description for column in COLUMNS}
    state = np.array([float(value) for value in found.header["initial_state"]["estimator"]])
    assert _bits(state) == _bits(np.array(AWKWARD))


def check_any_columns_come_back(write: Write, read: Read, limits: Limits) -> None:
    """Additional columns of other types are kept; so is a linear rig."""
    other = (
        Column("temperature_of_the_winding", "<f4", "K", "not known to this version"),
        Column("small", "|u1", "1", "one byte"),
        Column("half", "<i2", "count", "two bytes"),
    )
    for columns in (COLUMNS, (*COLUMNS, *TRUTH_COLUMNS), (*COLUMNS, *other)):
        dtype = np.dtype([(column.name, column.dtype) for column in columns], align=True)
        header = example_header(motion="linear", columns=columns)
        recording = Recording(header, example_rows(50, dtype=dtype), {"reason": "finished"})
        found = read(write(recording))
        _assert_equal_rows(found, recording, limits)
        assert found.units == recording.units


def check_an_unfinished_recording_stays_unfinished(write: Write, read: Read) -> None:
    """A recording without a trailer never becomes a complete one."""
    found = read(write(Recording(example_header(), example_rows(5), None, complete=False)))
    assert not found.complete
    assert found.trailer is None
    assert len(found) == 5


def check_losses_are_passed_on(write: Write, read: Read) -> None:
    """Losses of the source are reported by the copy."""
    lost = (Loss("damaged block", 4096, 2048, 10, 8), Loss("torn tail", 9000, 17, 30, None))
    assert read(write(Recording(example_header(), example_rows(5), {}, True, lost))).lost == lost


def check_no_damage_is_silent(write: Write, read: Read) -> None:
    """A changed byte gives an error, a reported loss or no difference; never other content.

    A byte without effect is, for example, padding, or statistics that no reader of recordings uses.
    """
    recording = Recording(example_header(), example_rows(40), {"reason": "finished"})
    path = write(recording)
    good = path.read_bytes()
    rng = np.random.default_rng(3)
    places = {*rng.integers(0, len(good), 60), *range(16), *range(len(good) - 16, len(good))}
    for _ in each_damaged(path, sorted(map(int, places)), (1 << int(rng.integers(8)) for _ in places)):
        with suppress(RecordingError):
            found = read(path)
            if found.complete and not found.lost:
                _assert_equal_rows(found, recording, Limits())
                assert found.header == recording.header
                assert found.trailer == recording.trailer
    _assert_equal_rows(read(path), recording, Limits())


def _assert_equal_rows(found: Recording, expected: Recording, limits: Limits) -> None:
    assert found.rows.dtype == expected.rows.dtype
    assert len(found) == len(expected)
    for name in expected.names:
        left, right = found.column(name), expected.column(name)
        if not limits.nan_bits and left.dtype.kind == "f":
            left, right = (np.where(np.isnan(values), np.nan, values) for values in (left, right))
            left, right = left.astype(found.rows.dtype[name]), right.astype(found.rows.dtype[name])
        assert _bits(left) == _bits(right), name


def _bits(values: NDArray[Any]) -> bytes:
    return values.tobytes()
