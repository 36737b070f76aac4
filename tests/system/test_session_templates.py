"""Every session template, shortened, from a new file to a report, rehearsed in virtual time."""

import json
import re
from pathlib import Path

import pytest

from rig.cli import run as rig
from rig.session.planning._load import load_protocol
from rig.session.planning._template_files import template_names
from tests.conformance.tiers import first_by_default

TRIALS = 3


@pytest.mark.exhaustive("tests/rig/session/test_session_check.py::test_every_template_passes_on_its_preset")
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", first_by_default(sorted(template_names(), reverse=True)))
def test_a_template_is_rehearsed_and_reported(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "study.toml", tmp_path / "out"
    assert rig(["session", "new", str(path), "--template", name]) == 0
    assert rig(["session", "check", str(path)]) == 0
    planned = capsys.readouterr().out
    for condition in load_protocol(path).condition:
        assert f"{condition.name}: fit {condition.fit}" in planned or not condition.fit
    text = path.read_text().replace("[stop]\n", f"[stop]\ntrials = {TRIALS}\n")
    path.write_text(re.sub(r"\[practice\]\nstiffness = \[.*?\]", "[practice]\nstiffness = []", text))
    study = str(tmp_path / "study")
    assert rig(["session", "run", str(path), "P01", "--rehearse", "--study", study, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["ended"], result["counted"]) == (f"{TRIALS} trials", TRIALS)
    assert result["invalid"] == 0
    assert rig(["session", "analyse", study, "--output", str(out)]) == 0
    report = (out / "report.html").read_text()
    for condition in load_protocol(path).condition:
        assert condition.name in report
        assert condition.fit in report
