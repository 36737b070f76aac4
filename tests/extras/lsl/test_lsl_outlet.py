"""The conversion of a loop's rows to samples and markers: no duplicates, counted losses, each at its own time."""

import json
import os
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.config import as_mapping, presets
from rig.core.errors import ConfigError
from rig.core.sample import Phase
from rig.extras.lsl import follow, library
from rig.extras.lsl.follow import SECRETS, Chunk, Follower, decimation, without_secrets
from rig.extras.lsl.serve import Markers, serve
from rig.extras.lsl.session import CUT, LINE_BYTES, marker_line
from tests.conformance.lsl_loop import INFO, OFFSET_NS, HandTurnedLoop

T = int(Phase.TRIAL)


def test_the_info_of_the_tests_has_the_keys_of_a_run() -> None:
    experiment = as_mapping(presets.load("koul-compliant"))
    for section, values in INFO["experiment"].items():  # type: ignore[attr-defined]
        assert values.keys() <= experiment[section].keys()


def contents(chunk: Chunk) -> list[dict[str, Any]]:
    return [marker.content for marker in chunk.markers]


def marks_of(chunk: Chunk, *names: str) -> list[tuple[int, int]]:
    return [(one.content["tick"], one.time_ns) for one in chunk.markers if one.content["mark"] in names]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 40), max_size=12), st.integers(2, 24))
def test_every_row_is_seen_once_and_in_order_or_counted_as_lost(pieces: list[int], capacity: int) -> None:
    loop = HandTurnedLoop(capacity)
    loop.compare_clocks()
    follower = Follower(loop.ring)
    seen: list[int] = []
    for count in pieces:
        lost = follower.lost
        loop.leave(count)
        chunk = follower.poll()
        ticks = chunk.rows["tick"].tolist()
        whole = count < capacity  # of a full ring, the oldest may be about to be written over
        assert (follower.lost == lost) == whole
        assert ticks == list(range(len(loop.published) - len(ticks), len(loop.published))), (
            "the newest, without a gap"
        )
        assert chunk.times_ns.tolist() == (chunk.rows["device_time"] + OFFSET_NS).tolist()
        seen += ticks
    loop.end()
    last = follower.poll()
    assert follower.ended
    assert len(last.rows) == 0
    assert len(seen) == follower.rows == len(loop.published) - follower.lost
    assert contents(last)[-1] == {
        "mark": "end",
        **({"tick": seen[-1], "device_time": 1_000_000 * (100 + seen[-1])} if seen else {}),
        "reason": "finished",
        "rows": len(seen),
        "lost": follower.lost,
    }


def test_a_follower_that_comes_late_begins_with_what_the_ring_still_has() -> None:
    loop = HandTurnedLoop(8)
    loop.leave(20)
    loop.compare_clocks()
    follower = Follower(loop.ring)
    assert follower.poll().rows["tick"].tolist() == list(range(13, 20))
    assert follower.lost == 13


def test_markers_are_at_the_samples_in_which_things_begin_across_chunks_too() -> None:
    phases = [1, 1, 2, T, T, T, T, T, T, 4, 4, 5]
    inside = [1, 0, 0, 0, 1, 1, 0, 1, 1, 1, 0, 0]
    whole, torn = HandTurnedLoop(), HandTurnedLoop()
    chunks = []
    for loop, steps in ((whole, [12]), (torn, [1] * 12)):
        loop.compare_clocks()
        follower, markers = Follower(loop.ring), []
        for size in steps:
            at = slice(len(loop.published), len(loop.published) + size)
            loop.leave(size, phase=phases[at], flags=inside[at])
            markers += follower.poll().markers
        chunks.append(Chunk(loop.published, loop.published["device_time"], markers))
    for chunk in chunks:
        at = {
            tick: int(time) for tick, time in zip(chunk.rows["tick"], chunk.times_ns + OFFSET_NS, strict=True)
        }
        assert marks_of(chunk, "phase") == [(tick, at[tick]) for tick in (0, 2, 3, 9, 11)]
        assert marks_of(chunk, "contact") == [(4, at[4]), (7, at[7])]
        found = contents(chunk)
        assert [one["phase"] for one in found if one["mark"] == "phase"] == [
            "homing", "settle", "trial", "release", "done",
        ]  # fmt: skip
        assert [one["contact"] for one in found if one["mark"] == "contact"] == [1, 2]
        assert found[0] == {
            "mark": "begin", "tick": 0, "device_time": 100_000_000, "rig": "test-rig", "motion": "rotary",
            "position_rate": 1000.0, "rate": 1000.0, "wall": {"stiffness": 560.25, "damping": 0.75},
        }  # fmt: skip
        clock = next(one for one in found if one["mark"] == "clock")
        assert 0.0 < clock["bound_s"] < 1e-3


def test_edges_of_the_sync_input_are_at_their_own_time() -> None:
    loop = HandTurnedLoop()
    loop.compare_clocks()
    follower = Follower(loop.ring)
    edge = 102_345_678
    loop.leave(3, sync_time=77)  # was there before
    first = follower.poll()
    loop.leave(2, sync_time=[edge, edge])
    second = follower.poll()
    assert marks_of(first, "sync") == []
    assert marks_of(second, "sync") == [(3, edge + OFFSET_NS)]


def test_a_change_of_the_wall_is_marked() -> None:
    loop = HandTurnedLoop()
    loop.compare_clocks()
    follower = Follower(loop.ring)
    loop.leave(4, parameter_set=[0, 0, 3, 3])
    (marker,) = [one for one in contents(follower.poll()) if one["mark"] == "wall"]
    assert (marker["tick"], marker["set"], marker["wall"]) == (2, 3, {"stiffness": 560.25, "damping": 0.75})


def test_blinded_markers_say_nothing_of_the_wall_and_of_rates_by_which_conditions_differ() -> None:
    loop = HandTurnedLoop()
    loop.compare_clocks()
    follower = Follower(loop.ring, rate=300.0, blind=True)
    loop.leave(4, parameter_set=[0, 0, 3, 3], phase=T, flags=1)
    loop.end()
    found = contents(follower.poll())
    assert {one["mark"] for one in found} == {"begin", "clock", "phase", "contact", "wall", "end"}
    text = json.dumps(found)
    assert "560" not in text
    assert "0.75" not in text
    assert "stiffness" not in text
    assert set(found[0]) == {"mark", "tick", "device_time", "rig", "motion"}


trees = st.recursive(
    st.integers(),
    lambda children: st.dictionaries(st.sampled_from([*sorted(SECRETS), "mark", "trial", "a"]), children, max_size=4),
    max_leaves=12,
)  # fmt: skip


@settings(max_examples=40)
@given(st.dictionaries(st.sampled_from([*sorted(SECRETS), "mark", "trial"]), trees, max_size=5))
def test_no_secret_survives_at_any_depth_and_all_else_does(content: dict[str, Any]) -> None:
    def keys(tree: Any) -> list[str]:
        return (
            []
            if not isinstance(tree, dict)
            else [*tree, *(k for value in tree.values() for k in keys(value))]
        )

    left = without_secrets(content)
    assert not SECRETS & set(keys(left))
    assert [key for key in content if key not in SECRETS] == list(left)
    assert all(
        left[key] == value for key, value in content.items() if key in left and not isinstance(value, dict)
    )


@given(st.floats(50.0, 50_000.0), st.floats(0.01, 1e5))
def test_a_rate_is_never_exceeded_and_never_missed_by_more_than_one_row_in_n(
    position: float, rate: float
) -> None:
    every = decimation(position, rate)
    assert every == 1 or position / (every - 1) > rate * (1 - 1e-12)
    assert position / every <= max(rate, position if every == 1 and rate >= position else 0.0) * (1 + 1e-12)
    assert decimation(position, None) == 1


def test_decimated_samples_are_every_nth_of_the_device_and_markers_miss_nothing() -> None:
    loop = HandTurnedLoop()
    loop.compare_clocks()
    follower = Follower(loop.ring, rate=300.0)
    assert (follower.every, follower.rate) == (4, 250.0)
    seen = []
    for _ in range(5):
        loop.leave(5, phase=T, flags=[0, 1, 0, 0, 0])
        chunk = follower.poll()
        seen += chunk.rows["sample_index"].tolist()
        assert len(marks_of(chunk, "contact")) == 1
    assert seen == list(range(100, 125, 4))


def test_without_a_comparison_of_clocks_times_are_receipts_after_a_while(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop = HandTurnedLoop()
    follower = Follower(loop.ring)
    loop.leave(3)
    assert len(follower.poll().rows) == 0, "it waits for one"
    monkeypatch.setattr(follow, "HOLD_S", 0.0)
    chunk = follower.poll()
    assert chunk.times_ns.tolist() == loop.published["received_at"].tolist()
    assert next(one for one in contents(chunk) if one["mark"] == "clock")["bound_s"] is None


def test_times_never_run_backwards_when_the_clocks_are_known_better() -> None:
    loop = HandTurnedLoop()
    follower = Follower(loop.ring)
    loop.compare_clocks(late_ns=20_000_000)
    loop.leave(3)
    before = follower.poll().times_ns
    for _ in range(8):
        loop.compare_clocks()
        follower.poll()
    loop.leave(12)
    after = follower.poll().times_ns
    truth = loop.published["device_time"] + OFFSET_NS
    assert before[0] - truth[0] > 5_000_000, "the first exchange misled it"
    assert (np.diff(np.concatenate((before, after))) >= 0).all()
    assert abs(after[-1] - truth[-1]) < 100_000


def test_a_run_of_another_kind_is_followed_by_its_rows_alone() -> None:
    loop = HandTurnedLoop(info={})
    loop.compare_clocks()
    follower = Follower(loop.ring, rate=10.0)
    loop.leave(3, phase=77)
    assert len(follower.poll().rows) == 3
    assert follower.rate == 0.0


# ---------------------------------------------------------------------- markers from elsewhere


@settings(max_examples=40)
@given(st.lists(st.integers(1, 9), max_size=8))
def test_lines_are_taken_whole_whatever_pieces_they_come_in(cuts: list[int]) -> None:
    lines = [{"at": 5 + i, "marker": {"mark": "ü", "n": i}} for i in range(3)]
    text = (
        b"".join(json.dumps(line).encode() + b"\n" for line in lines) + b"no json\n[1]\n{}\n" + b'{"at": 1, '
    )
    reading, writing = os.pipe()
    try:
        source, taken = Markers(reading), []
        start = 0
        for cut in cuts:
            os.write(writing, text[start : start + cut])
            start += cut
            taken += source.take()
        os.write(writing, text[start:])
        taken += source.take()
        assert not source.over
        assert [(one.time_ns, one.content) for one in taken] == [
            (5 + i, lines[i]["marker"]) for i in range(3)
        ]
        assert source.malformed == 3
    finally:
        os.close(writing)
        assert source.take() == []
        assert source.over
        os.close(reading)


# ---------------------------------------------------------------------- refusals


def test_impossible_settings_and_a_missing_library_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="rate"):
        serve(rate=0.0)
    with pytest.raises(ConfigError, match="position rate"):
        serve(expected=("rotary", -1.0))
    with pytest.raises(ConfigError, match="no running process"):
        serve(2**22 + 1)
    for error, match in ((ImportError(), "not installed"), (RuntimeError(), "no liblsl")):

        def failing(name: str, error: Exception = error) -> None:
            raise error

        monkeypatch.setattr(library, "import_module", failing)
        with pytest.raises(ConfigError, match=match) as caught:
            serve()
        assert caught.value.remedy


@pytest.mark.parametrize("character", ["a", "ä", "€", "😀", "\x1f", '"', "\ud800"])
@pytest.mark.parametrize("length", [1, 500, 700, 5000])
def test_a_long_text_is_cut_and_not_lost(character: str, length: int) -> None:
    text = character * length
    line = marker_line(7, {"mark": "note", "trial": 3, "text": text})
    assert len(line) <= LINE_BYTES
    found = json.loads(line)["marker"]
    whole = text.replace("\ud800", "?")
    assert found["text"] == whole or (found["text"][-1] == CUT and whole.startswith(found["text"][:-1]))
    assert (found["mark"], found["trial"]) == ("note", 3)
    if length <= 500 and character != "\x1f":
        assert found["text"] == whole  # as long as a note at the console may be
    elif found["text"] != whole:
        assert len(line) > LINE_BYTES - 16  # no more is cut than must be
