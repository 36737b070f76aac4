"""The recipe for a lab's own repository works as it stands: the commands of its workflow, in a copy of it, offline."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import rig.testing

RECIPE = Path(rig.testing.__file__).parent / "recipe"
WORKFLOW = RECIPE / ".github" / "workflows" / "haptics.yml"
# What is installed is what the requirements ask for; nothing is fetched, and nothing installed.
OFFLINE = {"PIP_NO_INDEX": "1", "PIP_DRY_RUN": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
LOADED = "-p rig.testing.plugin -p no:cacheprovider"  # as its entry point does, where it is installed


def test_its_workflow_runs(pytester: pytest.Pytester) -> None:
    commands = re.findall(r"^      - run: (.+)$", WORKFLOW.read_text(), re.MULTILINE)
    assert commands == ["pip install -r requirements.txt", "pytest"]
    shutil.copytree(RECIPE, pytester.path, dirs_exist_ok=True)
    updated = pytester.runpytest_inprocess(*LOADED.split(), "--rig-golden=update", "-k", "what_it_was")
    updated.assert_outcomes(passed=1, deselected=4)  # once, by hand, and committed
    environment = {
        **os.environ,
        **OFFLINE,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTEST_ADDOPTS": LOADED,
        "PYTHONPATH": str(RECIPE.parents[2]),
    }
    for command in commands:
        shell = ["bash", "-euc", command]
        done = subprocess.run(shell, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"\b5 passed in ", done.stdout)
    assert not (pytester.path / "rig-recordings").exists(), "only failed tests leave some"
