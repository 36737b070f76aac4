"""The check-list for first power-on: every command in it exists, with every option that it uses."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

import firmware_protocol
import rig.cli
from tests.conformance.commands import resolve

BENCH = Path(firmware_protocol.__file__).with_name("firmware") / "BENCH.md"
TEXT = BENCH.read_text(encoding="utf-8")
BLOCKS = re.findall(r"```sh\n(.*?)```", TEXT, re.DOTALL)
MINE = re.findall(r"```toml\n(preset.*?)```", TEXT, re.DOTALL)[0]  # the file that the list begins with
COMMANDS = [line for block in BLOCKS for line in block.splitlines() if line.startswith("rig ")]


def test_the_list_has_commands() -> None:
    assert len(COMMANDS) >= 12


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_of_the_list_exists_with_its_options(line: Any) -> None:
    context, words = resolve(shlex.split(line)[1:])
    context.command.parse_args(context, list(words))  # raises for an option that is not there


@pytest.mark.parametrize("line", [line for line in COMMANDS if re.search(r"--set|--operator|-K", line)])
def test_keys_of_the_list_are_keys_of_an_experiment(
    line: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Each command of the list can be planned with the file shown there."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(MINE)
    _, words = resolve(shlex.split(line)[1:])
    words = [word for i, word in enumerate(words) if word not in ("URL", "--url", "--verified")]
    assert rig.cli.run(["experiment", "plan", *words]) == 0, capfd.readouterr().err
