"""Five people in a session with a console, in virtual time: each trial has the right reason, in the log and printed.

One obeys the cue, one anticipates it, one is too slow, one leaves the wall, and one is thrown out of it. Each is a
condition of a blinded study, so that the order of the trials says whose trial it is.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numba
import pytest

from rig.session.hits import DeviceRunner
from rig.session.run import run_session
from sim_backend.operator import Script
from tests.conformance.terminal import Terminal
from tests.system.test_session_console import Operator

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="the loop is compiled")

ANTICIPATES, SLOW, LEAVES = 0.101, 0.102, 0.103  # operator.begin_s, by which a script knows its person
PROTOCOL = f"""
[study]
title = "people"
preset = "koul-compliant"
[study.changes]
rig.limits.override_stall = true
rig.limits.effort = 0.6
operator.press = 1.0
operator.begin_s = 0.1
trial.minimum_rest_counts = 0.0
controller.position_rate = 2000
controller.velocity_rate = 2000
controller.parameters.cutoff_hz = 200.0
verdict.tail_s = 0.3
verdict.lowpass_hz = 400.0
[trial]
baseline_s = 0.3
foreperiod_s = 0.2
duration_s = 1.2
hold_s = 0.8
attempts = 2
[caps]
energy = 0.02
[order]
kind = "fixed"
[search]
rule = "grid"
lowest = 60
highest = 61
step = 1
settings = {{ repeats = 1 }}
[[condition]]
name = "secret obeys"
damping = [0.1]
[[condition]]
name = "secret anticipates"
damping = [0.1]
changes = {{ operator.begin_s = {ANTICIPATES} }}
[[condition]]
name = "secret slow"
damping = [0.1]
changes = {{ operator.begin_s = {SLOW} }}
[[condition]]
name = "secret leaves"
damping = [0.1]
changes = {{ operator.begin_s = {LEAVES} }}
[[condition]]
name = "secret thrown out"
search = {{ rule = "grid", lowest = 1500, highest = 1501, step = 1, settings = {{ repeats = 1 }} }}
"""


def as_they_are(as_told: Any, model: Any, tick_s: float, position: float, session: int = 0) -> Script:
    """What each person does; `as_told` is the script of somebody who does what is asked."""
    who, reach = model.operator.begin_s, model.reach
    later = {ANTICIPATES: -0.3, SLOW: 5.0}.get(who, 0.0)
    planned = replace(model, reach=replace(reach, wait_s=reach.wait_s + later))
    script: Script = as_told(planned, tick_s, position, session)
    if who != LEAVES:
        return script
    rows, gone = script.rows.copy(), script.again + round(0.1 / tick_s)
    rows[gone:] = reach.start, 0.0, 0.0
    return Script(rows=rows, again=gone)


OBEYS, THROWN_OUT = "[1] stable", "[3] unstable"
FALSE_START, ABSENT = "a false start: the handle moved before the cue", "the wall was never touched"
GONE = "the hand left the wall before the end and did not come back: ask to stay in it"
OSCILLATED = "the wall oscillated: the effort alternated between nothing and its limit"
EXPECTED = {  # what the log keeps of both trials of each person: verdict, why the run ended, first reason
    "obeys": ("stable", "finished", None),
    "anticipates": ("invalid", "finished", FALSE_START),
    "slow": ("invalid", "finished", ABSENT),
    "leaves": ("invalid", "finished", GONE.replace("the wall", "the calm wall")),
    "thrown out": ("unstable", "violent", OSCILLATED),
}


def test_every_trial_has_the_reason_of_whoever_was_at_the_handle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Script, "of", partial(as_they_are, Script.of))
    path = tmp_path / "people.toml"
    path.write_text(PROTOCOL)
    with Terminal() as terminal:
        session = partial(run_session, path, "P01", runner=DeviceRunner(), study=tmp_path / "study")
        operator = Operator(terminal, tmp_path, session)

        def hit(expected: str) -> None:
            """Say go, and wait for what is printed then."""
            assert operator.sees("ready?"), operator.result()
            operator.press("g")
            assert operator.sees(expected), operator.result()

        try:
            for _ in range(2):
                hit(OBEYS)
                operator.press("1")
            for first, said in ((3, FALSE_START), (5, ABSENT), (7, GONE)):
                hit(f"trial {first}: invalid, it is repeated: {said}")
                hit(f"2 trials in a row were invalid: {said}")
                operator.press("s")
                assert operator.sees("leave this run")
                operator.press("y")
            for _ in range(2):
                hit(THROWN_OUT)
                operator.press("3")
            assert operator.sees("end the session?")
            operator.press("g")
            assert operator.result().ended == "complete"
        finally:
            operator.close()
    kept = [
        (
            one["condition"].removeprefix("secret "),
            one["automatic"],
            one["ended"],
            next(iter(one["reasons"]), None),
        )
        for one in operator.of_kind("trial")
    ]
    assert kept == [(who, *what) for who, what in EXPECTED.items() for _ in range(2)]
    assert [one["verdict"] for one in operator.of_kind("judged")] == ["stable"] * 2 + ["unstable"] * 2
    assert "secret" not in terminal.printed
    assert "N·m" not in terminal.printed
