"""The limits of linear theory beside a slider: a passive limit of zero, and one that theory does not compute."""

import json
import shutil
import subprocess

import pytest

from rig.config import override, presets
from rig.extras.console.regions import regions
from tests.extras.console.test_page import PAGE

SCRIPT = """
import { describeRegions } from "%s";
const shown = (passive) =>
  describeRegions({ passive, stable: 5, hand: "no hand" }, 3, "N/m", true);
const both = (passive) => [shown(passive).text, shown(passive).bands.map(([, , colour]) => colour).join(" ")];
console.log(JSON.stringify([null, 0, 2, 4].map(both)));
"""


def test_a_passive_limit_that_theory_does_not_compute_differs_from_zero() -> None:
    experiment = presets.load("koul-compliant")
    assert regions(experiment, 1, 0.2).passive == 0.0
    by_effort = regions(override(experiment, {"controller.estimator": "disturbance"}), 1, 0.2)
    assert by_effort.passive is None
    assert by_effort.stable is not None
    assert "no theory with the effort" in by_effort.note


def test_a_page_shows_a_wall_as_passive_only_where_theory_does() -> None:
    if shutil.which("node") is None:
        pytest.skip("no JavaScript: install nodejs")
    command = ["node", "--input-type=module", "--eval", SCRIPT % (PAGE / "wall.js").as_uri()]
    shown = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    limit = "stable up to 5 N/m, no hand)"
    assert [text for text, _ in shown] == [
        f"stable (passivity not computed, {limit}",
        f"stable, not passive (no wall is passive, {limit}",
        f"stable, not passive (passive up to 2, {limit}",
        f"passive (passive up to 4, {limit}",
    ]
    assert [colours for _, colours in shown] == ["invalid unstable", *["stable limit-cycle unstable"] * 3]
