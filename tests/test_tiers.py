"""Each test of the exhaustive tier names a related test of the default tier."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MARK = re.compile(r"mark\.exhaustive(?:\(\s*\"([^\"]*)\"\s*\))?")
RELATIVES = sorted(
    {
        (str(path.relative_to(ROOT)), relative)
        for path in ROOT.glob("tests/**/test_*.py")
        if path != Path(__file__)
        for relative in MARK.findall(path.read_text(encoding="utf-8"))
    }
)


@pytest.mark.parametrize(("file", "relative"), RELATIVES)
def test_a_relative_exists_and_is_run_by_default(file: str, relative: str) -> None:
    place, _, name = relative.partition("::")
    text = (ROOT / (place or file)).read_text(encoding="utf-8")
    assert not re.search(r"^pytestmark = .*exhaustive", text, re.MULTILINE), "all of it is exhaustive"
    before, *found = re.split(rf"\n(?:async )?def {name}\(", text, maxsplit=1)
    assert found, f"{file} names {relative}, which is not there"
    assert "mark.exhaustive" not in f"{before}\n".rpartition("\n\n\n")[2]


def test_no_test_skips_on_a_busy_machine() -> None:
    """Tests that need a quiet machine are marked and pass there; only emulated systems may skip on a busy one."""
    places = [path.relative_to(ROOT / "tests") for path in ROOT.glob("tests/**/*.py")]
    using = {
        place.parts[0]
        for place in places
        if "conformance.tolerance import" in (ROOT / "tests" / place).read_text(encoding="utf-8")
    }
    assert using <= {"browser", "guest", "test_tiers.py"}
