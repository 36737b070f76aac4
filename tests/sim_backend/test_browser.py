"""The rig of the documents' first page: its hits are those of the simulated rig, in every row and to the last bit."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig
from rig.config import presets
from rig.core.errors import DeviceFaultError, RigError
from rig.core.sample import TRUTH_COLUMNS
from rig.experiments.hits.hit import left_by
from sim_backend.browser import __main__ as browser
from sim_backend.mechanics.inner import OFFSET
from tests.conformance.tiers import first_by_default

OFFSET_AT = 25 + OFFSET  # in rig_setup
COLUMNS = ("count", "effort_applied", *(column.name for column in TRUTH_COLUMNS))
HITS = 8
GROUPS = 125  # with the first: 1000 hits


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled rig and its tables, as the page has them."""
    pytest.importorskip("ziglang", reason="no compiler for WebAssembly: pip install 'haptic-rig[page]'")
    if shutil.which("node") is None:
        pytest.skip("no JavaScript: install nodejs")
    browser.build(tmp_path_factory.mktemp("wall"))
    return tmp_path_factory.getbasetemp() / "wall0" / "wall.js"


def random_hit(generator: np.random.Generator) -> dict[str, Any]:
    """Return rig, changes and encoder offset of a hit: any wall and rates of a page."""
    name = str(generator.choice(presets.names()))
    own, rates = presets.load(name), browser.RATES[generator.integers(len(browser.RATES))]
    stiffness, damping = 10.0 ** generator.uniform(-0.7, 0.5), generator.uniform(0.0, 2.0)
    depth = own.wall.side * abs(own.trial.start) * generator.uniform(0.0, 0.5)
    changes = browser.changes_of(own, rates, str(generator.choice(browser.ESTIMATORS)))
    changes["wall.stiffness"] = own.wall.stiffness * float(stiffness)
    changes["wall.damping"] = own.wall.damping * float(damping)
    changes["wall.position"] = own.wall.position + float(depth)
    return {"name": name, "changes": changes, "place": OFFSET_AT, "offset": float(generator.uniform())}


@pytest.mark.parametrize("group", first_by_default(range(GROUPS)))
def test_a_hit_in_a_page_is_that_of_rig_hit_in_every_row(group: int, data: Path, tmp_path: Path) -> None:
    generator = np.random.default_rng(group)
    hits = [random_hit(generator) for _ in range(HITS)]
    command = ["node", Path(__file__).with_name("browser_hits.mjs"), data, tmp_path]
    made = subprocess.run(command, input=json.dumps(hits), capture_output=True, text=True, check=True)
    for number, (hit, line) in enumerate(zip(hits, made.stdout.splitlines(), strict=True)):
        answer = json.loads(line)
        changes = {**hit["changes"], "rig.encoder.offset": hit["offset"]}
        if "refused" in answer:
            with pytest.raises(RigError):
                rig.hit(hit["name"], changes=changes, output=tmp_path)
            continue
        changes["trial.effort"] = answer["effort"]
        try:
            recorded = rig.hit(hit["name"], changes=changes, output=tmp_path).recorded
        except DeviceFaultError as error:
            assert answer["fault"]
            recorded = left_by(error)
        assert answer["kind"] == recorded.judgement.verdict.kind, hit
        rows, quantum = recorded.recording.rows, presets.load(hit["name"]).rig.amplifier.effort_quantum
        columns = np.fromfile(tmp_path / str(number)).reshape(len(COLUMNS), -1)
        # The host's own float64 law, whose phase a recording has, may end a tick after the device's.
        assert abs(len(rows) - columns.shape[1]) <= 1, hit
        for name, column in zip(COLUMNS, columns, strict=True):
            scale = quantum if name == "effort_applied" else 1.0
            ticks = min(len(rows), len(column))
            np.testing.assert_array_equal(column[:ticks] * scale, rows[name][:ticks], f"{name}: {hit}")
