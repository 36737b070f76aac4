"""The limits of linear theory beside a slider: a passive limit of zero, and one that theory does not compute."""

import json
import shutil
import subprocess

import pytest

from rig.config import override, presets
from rig.extras.console.regions import regions
from tests.extras.console.test_page import PAGE

LIMITED = "stable up to 5 N/m, no hand)"
DESCRIBED = {
    "unknown": ((None, 3.0, True), f"stable (passivity not computed, {LIMITED}", ["invalid", "unstable"]),
    "none": ((0.0, 0.0, True), f"stable, not passive (no wall is passive, {LIMITED}", None),
    "passive": ((2.0, 1.0, True), f"passive (passive up to 2, {LIMITED}", None),
    "not passive": ((2.0, 3.0, True), f"stable, not passive (passive up to 2, {LIMITED}", None),
    "unstable": ((None, 6.0, True), f"unstable (passivity not computed, {LIMITED}", ["invalid", "unstable"]),
    "without a server": ((None, 3.0, False), f"stable ({LIMITED}", ["stable", "unstable"]),
}
SCRIPT = """
import { describeRegions } from "%s";
const describe = ([passive, stiffness, passivity]) =>
  describeRegions({ passive, stable: 5, hand: "no hand" }, stiffness, "N/m", passivity);
console.log(JSON.stringify(%s.map(describe)));
"""


def test_a_passive_limit_that_theory_does_not_compute_differs_from_zero() -> None:
    experiment = presets.load("koul-compliant")
    assert regions(experiment, 1, 0.2).passive == 0.0
    by_effort = regions(override(experiment, {"controller.estimator": "disturbance"}), 1, 0.2)
    assert by_effort.passive is None
    assert by_effort.stable is not None
    assert "no theory with the effort" in by_effort.note


def test_text_and_colours_of_the_limits() -> None:
    if shutil.which("node") is None:
        pytest.skip("no JavaScript: install nodejs")
    script = SCRIPT % ((PAGE / "wall.js").as_uri(), json.dumps([limits for limits, *_ in DESCRIBED.values()]))
    command = ["node", "--input-type=module", "--eval", script]
    shown = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    usual = ["stable", "limit-cycle", "unstable"]
    found = [(one["text"], [colour for *_, colour in one["bands"]]) for one in shown]
    assert found == [(text, colours or usual) for _, text, colours in DESCRIBED.values()]
