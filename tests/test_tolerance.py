"""The summary lists the events that real-time tests tolerated, also with workers, counted by test and reason."""

from pathlib import Path

import numpy as np
import pytest

from rig.core.sample import Phase
from rig.recording.data import Recording
from tests.conformance.tiers import first_by_default
from tests.conformance.tolerance import reason_of, taken

pytest_plugins = ["pytester"]

ROOT = Path(__file__).parent.parent
TESTS = """
import pytest
from tests.conformance.tolerance import tolerated, too_busy

@pytest.mark.parametrize("number", range(3))
def test_of_time(number):
    if number < 2:
        tolerated(TimeoutError("no answer"))

def test_that_never_began():
    too_busy("no device")

def test_that_shows_all():
    pass
"""


@pytest.mark.parametrize("workers", first_by_default(["0", "2"]))
def test_tolerated_errors_are_counted_and_printed(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, workers: str
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pytester.makeconftest((ROOT / "tests" / "conftest.py").read_text())
    pytester.makepyfile(test_some=TESTS)
    found = pytester.runpytest_subprocess("-n", workers, "-p", "no:cacheprovider")
    found.assert_outcomes(passed=4, skipped=1)
    summary = found.stdout.str().partition("tolerated on this machine")[2]
    assert "2 × test_some.py::test_of_time: TimeoutError: no answer" in summary
    assert "1 × test_some.py::test_that_never_began: no device" in summary
    assert "test_that_shows_all" not in summary


def test_a_lost_device_is_reported_with_its_place_in_the_run() -> None:
    rows = np.zeros(3, [("phase", "u1"), ("device_time", "<i8")])
    rows["device_time"] = [0, 1_000_000, 42_000_000]
    rows["phase"] = Phase.HOMING
    trailer = {"reason": "link_silent", "error": "no valid command arrived"}
    with pytest.raises(pytest.skip.Exception, match=r"after 3 rows, in homing; at most 41\.0 ms .* row 1"):
        reason_of(Recording({}, rows, trailer, complete=True))
    (tolerated,) = taken()
    assert tolerated[1].startswith("no valid command arrived; ")
