"""Help: an option means the same in every command, help is grouped, and -q keeps the exit code."""

import json
import re
from collections import defaultdict
from typing import Any

import click
import pytest

import rig.cli
from rig.cli.command import DEVICE, OWN, RESULT, GroupedCommand
from tests.conformance.commands import commands
from tests.conformance.guides import ROOT

DIFFERENT = {"--rate"}  # one rate, several, or T1/T2
WALLS = {"--stiffness", "--damping"}  # one wall, or several


def all_commands() -> list[tuple[str, click.Command]]:
    return [(" ".join(path), command) for path, command in commands()]


def test_every_command_is_ours_and_prints_json_and_can_be_quiet() -> None:
    for name, command in all_commands():
        options = {option for one in command.params for option in one.opts}
        assert isinstance(command, GroupedCommand), name
        assert "--json" in options, name
        assert not re.search(r"(,|\b(and|or|of|the))$", command.help.strip()), f"{name}: cut off"
        assert ("--quiet" in options) == (name not in ("console", "session run", "session resume")), name


def test_an_option_has_one_short_form_one_kind_of_value_and_one_group_everywhere() -> None:
    seen: dict[str, dict[Any, list[str]]] = defaultdict(lambda: defaultdict(list))
    for name, command in all_commands():
        for one in command.params:
            if isinstance(one, click.Option):
                long = next(option for option in one.opts if option.startswith("--"))
                kind = "walls" if long in WALLS else type(one.type).__name__
                group = getattr(one, "group", OWN)
                described = (tuple(one.opts), one.is_flag, kind, group if group in (DEVICE, RESULT) else OWN)
                seen[long][described].append(name)
    different = {
        option: dict(forms) for option, forms in seen.items() if len(forms) > 1 and option not in DIFFERENT
    }
    assert different == {}


def test_quiet_prints_nothing_but_json_and_keeps_the_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert rig.cli.run(["experiment", "preset", "-q"]) == 0
    assert capsys.readouterr() == ("", "")
    assert rig.cli.run(["experiment", "preset", "nothing", "--quiet"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.startswith("rig: ")) == ("", True)
    assert rig.cli.run(["experiment", "preset", "-q", "--json"]) == 0
    assert "koul-rigid" in json.loads(capsys.readouterr().out)


# In a text, in a script.
NAMED = re.compile(r"(?:(?:`|next: |run: )rig|/rig\"?) ([a-z][a-z-]*)((?: [a-z][a-z-]*)?)")


def test_there_are_at_most_twenty_commands_at_the_top_and_each_that_a_text_names_exists() -> None:
    top = rig.cli.rig.list_commands(click.Context(rig.cli.rig))
    assert len(top) <= 20
    known = {words[:2] for words, _ in commands()}
    groups = {words[0] for words in known if len(words) > 1}
    named = {
        (str(path.relative_to(ROOT)), first, second.strip())
        for place in ("README.md", ".ci", ".github", "rig", "firmware_protocol")
        for path in [ROOT / place, *(ROOT / place).rglob("*")]
        if path.suffix in (".md", ".py", ".toml", ".yml") or path.parent.name == ".ci"
        for first, second in NAMED.findall(path.read_text(encoding="utf-8"))
    }
    assert len(named) > 100

    def exists(first: str, second: str) -> bool:
        return (first, second) in known if first in groups and second else first in top

    assert [one for one in sorted(named) if not exists(*one[1:])] == []
