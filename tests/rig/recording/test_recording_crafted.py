"""Forged recordings with a valid checksum: every command ends with exit code 9 and a sentence."""

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import rig.cli
from rig.core.errors import RecordingError
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.recording import _parquet as parquet
from rig.recording._capture import END_MAGIC, ROWS_MAGIC, pack_block, pack_header
from rig.recording._shape import DEPTH, parse_json
from rig.recording.canonical import canonical_json
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from rig.testing import Experiments
from tests.conformance.tiers import first_by_default

COMMANDS = (
    ["recording", "show", "--marks"],
    ["recording", "show", "--json"],
    ["recording", "timing", "--no-plot"],
    ["recording", "replay", "--json"],
    ["recording", "recover"],
)


def nested(levels: int) -> list[Any]:
    value: list[Any] = []
    for _ in range(levels):
        value = [value]
    return value


# Place → value, in header or trailer.
CRAFTED: dict[str, Any] = {
    "header.extra": 1e300,
    "header.extra.deep": nested(300),
    "header.motion": "sideways",
    "header.experiment": 3,
    "header.experiment.wall": "\udcff",
    "header.experiment.controller.position_rate": 1e-300,
    "header.experiment.rig.mechanics.link_inertia": {},
    "header.initial_state.control.release_ticks": {"a": 1},
    "header.initial_state.estimator.state_f": [],
    "header.initial_state.law.state": [0.0] * 1000,
    "header.schema.row_bytes": 1 << 62,
    "trailer": 10**30,
    "trailer.clock": [None],
    "trailer.clock.offset_ns": 10**30,
    "trailer.parameter_sets": [{"tick": 0}],
    "trailer.reason": 7,
    "trailer.verdict": {"kind": 3},
}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    experiment = Experiments("koul-compliant", Path()).short()
    (result,) = hit(HitRequest(experiment=experiment, output=tmp_path_factory.mktemp("good")), admit)
    return open_recording(result.path)


def changed(good: Recording, place: str, value: Any) -> dict[str, Any]:
    facts: dict[str, Any] = copy.deepcopy({"header": good.header, "trailer": good.trailer})
    *way, last = place.split(".")
    inside = facts
    for key in way:
        inside = inside[key]
    inside[last] = value
    return facts


def capture(path: Path, good: Recording, facts: dict[str, Any]) -> None:
    rows = pack_block(ROWS_MAGIC, 0, 0, len(good.rows), good.rows.tobytes())
    trailer = canonical_json(facts["trailer"])
    trailer += b" " * (-len(trailer) % 8)
    path.write_bytes(
        pack_header(facts["header"]) + rows + pack_block(END_MAGIC, 1, len(good.rows), 0, trailer)
    )


def sealed(path: Path, good: Recording, facts: dict[str, Any]) -> None:
    facts_in_order = iter((facts["header"], facts["trailer"], True, []))
    with pytest.MonkeyPatch.context() as patched, open(path, "wb") as file:
        patched.setattr(parquet, "canonical_json", lambda fact: canonical_json(next(facts_in_order)))
        parquet.write_parquet(file, good)


@pytest.mark.parametrize("write", first_by_default([capture, sealed]))
@pytest.mark.parametrize("place", CRAFTED)
def test_crafted_recording_is_exit_code_9_or_is_read(
    place: str,
    write: Callable[[Path, Recording, dict[str, Any]], None],
    good: Recording,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / ("made.rigcap" if write is capture else "made.parquet")
    write(path, good, changed(good, place, CRAFTED[place]))
    codes = set()
    for group, command, *options in COMMANDS if write is capture else COMMANDS[1:4]:
        codes.add(rig.cli.run([group, command, str(path), *options]))
        assert "internal error" not in capsys.readouterr().err
    assert codes <= {0, 9}
    assert 9 in codes or (place == "trailer" and write is capture), "a torn end is no error"


def test_uncrafted_recording_is_read(good: Recording, tmp_path: Path) -> None:
    for write, name in ((capture, "a.rigcap"), (sealed, "a.parquet")):
        write(tmp_path / name, good, changed(good, "trailer.error", None))
        assert replace(open_recording(tmp_path / name), path=None).header == good.header


@pytest.mark.parametrize("size", [0, 1, 12, 16, 200])
def test_capture_cut_in_its_header_is_named(
    size: int, good: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "killed.rigcap"
    path.write_bytes(pack_header(good.header)[:size])
    assert rig.cli.run(["recording", "recover", str(tmp_path)]) == 9
    assert "killed.rigcap" in capsys.readouterr().err
    with pytest.raises(RecordingError):
        open_recording(path)


def test_a_json_of_any_depth_is_read_or_refused() -> None:
    assert parse_json(b"[" * (DEPTH - 1) + b"]" * (DEPTH - 1)) is not None
    for depth in (DEPTH + 1, 900, 100_000):
        with pytest.raises(ValueError, match="nested"):
            parse_json(b"[" * depth + b"]" * depth)
