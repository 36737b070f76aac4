"""The command line as a whole: help, options, invalid words, messages and exit codes."""

import ast
import importlib
import inspect
import json
import re
import subprocess
import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import pytest

import rig.cli
import rig.cli.doctor
from rig.cli import output
from rig.cli.command import DEVICE, OWN, RESULT, GroupedCommand
from rig.core.errors import ConfigError, RigError
from rig.experiments.sweep._executors import executor_for
from rig.experiments.trials import live
from rig.realtime.source_files import source_files
from tests.conformance.commands import commands
from tests.conformance.guides import ROOT

EXIT_CODES = Path(rig.__file__).parent / "docs" / "reference" / "exit-codes.md"


@pytest.mark.parametrize(
    ("raised", "code", "words"),
    [
        (KeyboardInterrupt(), 130, "rig: stopped by SIGINT\n"),
        (KeyboardInterrupt("SIGTERM"), 130, "rig: stopped by SIGTERM\n"),
        (EOFError("a pipe"), 70, "internal error: EOFError: a pipe"),
    ],
)
def test_a_stop_names_its_signal_and_a_broken_pipe_is_an_internal_error(
    raised: BaseException, code: int, words: str, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """Click turns all three cases into the same exception."""

    def end() -> None:
        raise raised

    monkeypatch.setattr(rig.cli.doctor.doctor, "callback", end)
    monkeypatch.setattr(rig.cli.doctor.doctor, "params", [])
    assert rig.cli.run(["doctor"]) == code
    assert words in capsys.readouterr().err


def test_an_empty_value_of_any_option_is_an_error_that_names_it(capsys: Any) -> None:
    tried: set[str] = set()
    for path, command in commands():
        for parameter in command.params:
            if getattr(parameter, "is_flag", False) or str(parameter.opts) in tried:
                continue
            tried.add(str(parameter.opts))
            if isinstance(parameter, click.Argument):
                cases = [([*path, ""], path[-1])]
            else:
                long = max(parameter.opts, key=len)
                cases = [([*path, name, ""], name) for name in parameter.opts]
                cases += [([*path, f"{long}="], long)] if long.startswith("--") else []
            for words, named in cases:
                assert rig.cli.run(words) == 2, words
                assert f" {named};" in capsys.readouterr().err, words
    assert len(tried) > 100
    assert rig.cli.run(["experiment", "plan", "--json", "--set", ""]) == 2
    assert json.loads(capsys.readouterr().out)["error"]["kind"] == "ConfigError"


OPTIONAL = "distributed|mcap|moteus|odrive|pandas|pylsl|sphinx|statsmodels|unicorn|websockets|xarray"


def test_no_file_needs_an_optional_library_to_be_imported() -> None:
    needed = re.compile(rf"^(?:import|from) (?:{OPTIONAL})\b", re.MULTILINE)
    needing = {module for module, path in source_files().items() if needed.search(path.read_text())}
    assert needing == {"rig.docs.conf", "rig.session.examples.from_tables"}  # which no command imports


MISSING = {
    "console": lambda: importlib.import_module("rig.extras.console.sockets"),
    "lsl": lambda: rig.cli.rig(["serve", "lsl", "--once"], standalone_mode=False),
    "cluster": lambda: executor_for("tcp://127.0.0.1:1", None),
}


@pytest.mark.parametrize("extra", MISSING)
def test_a_missing_library_is_named_with_its_extra(extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "rig.extras.console.sockets", raising=False)
    loaded = [name for name in sys.modules if re.match(rf"(?:{OPTIONAL})\b", name)]
    for name in [*OPTIONAL.split("|"), *loaded]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ConfigError) as refused:
        MISSING[extra]()
    assert refused.value.remedy.endswith(f"pip install 'haptic-rig[{extra}]'")


def own_codes(kind: type[RigError]) -> list[int]:
    """Return the exit codes that an error type and its subtypes define themselves."""
    own = [kind.exit_code] if "exit_code" in vars(kind) else []
    return own + [code for below in kind.__subclasses__() for code in own_codes(below)]


def test_every_exit_code_is_in_the_readme_and_of_one_kind_of_error() -> None:
    for module, path in source_files(["rig"]).items():
        if "RigError)" in path.read_text() or "Error):" in path.read_text():
            importlib.import_module(module)
    returned = {
        node.value.value
        for function in (rig.cli.run, rig.cli._run, rig.cli._incomplete, rig.cli._defect)
        for node in ast.walk(ast.parse(inspect.getsource(function)))
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Constant)
    }
    paragraph = re.search(r"^Exit codes: (.*?)\n\n", EXIT_CODES.read_text(), re.DOTALL | re.MULTILINE)
    assert paragraph
    written = [int(entry.split()[0]) for entry in paragraph[1].split(";")]
    codes = own_codes(RigError)
    assert len(codes) == len(set(codes))
    assert written == sorted({*codes, *returned, click.UsageError.exit_code})


def test_a_change_for_a_run_that_ends_before_it_is_active_has_its_own_exit_code(
    monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    done = live.LiveChange(7, 3, {"wall.stiffness": 1.0}, {}, active=False, ended=True)
    monkeypatch.setattr(live, "change_wall", lambda *_, **__: done)
    assert rig.cli.run(["set", "stiffness=1"]) == 16
    assert "the loop ended before" in capsys.readouterr().err
    assert rig.cli.run(["set", "stiffness=1", "--json"]) == 16
    assert json.loads(capsys.readouterr().out)["ended"]
    monkeypatch.setattr(live, "change_wall", lambda *_, **__: replace(done, ended=False))
    assert rig.cli.run(["set", "stiffness=1"]) == 0
    assert "not active yet" in capsys.readouterr().out


def test_invisible_characters_of_a_message_are_escaped_in_a_terminal() -> None:
    assert output.for_terminal("a\u00a0b\u200b\0\x1b[2J\n\t−µ°") == "a\\xa0b\\u200b\\x00\\x1b[2J\n\t−µ°"


def test_an_argument_that_an_error_names_is_an_option_of_a_command() -> None:
    """A command prints `name` of a message as --name."""
    words = {name for _, command in commands() for one in command.params for name in one.opts}
    options = {word[2:].replace("-", "_") for word in words if word.startswith("--")}
    named = {
        (module, found)
        for module, path in source_files(["rig"]).items()
        if "Error(" in (source := path.read_text(encoding="utf-8"))
        for call in ast.walk(ast.parse(source))
        if isinstance(call, ast.Call) and ast.unparse(call.func).endswith("Error")
        for part in ast.walk(call)
        if isinstance(part, ast.Constant) and isinstance(part.value, str)
        for found in output._ARGUMENT.findall(part.value)
    }
    assert len(named) > 5
    assert [one for one in sorted(named) if one[1] not in options] == []


def test_a_command_shows_an_argument_as_its_option(capsys: Any) -> None:
    text = "this wall must not be armed; or accept the risk: `arm_anyway`; see `rig doctor`"
    assert output.for_terminal(text).endswith("the risk: --arm-anyway; see `rig doctor`")
    assert rig.cli.run(["session", "check", "/nowhere.toml", "--threshold", "x=1"]) == 2
    assert "`" not in capsys.readouterr().err


INTERRUPTED = """
import sys

class Interrupted:
    def find_spec(self, name, *_):
        if name == "click":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupted())
sys.argv = ["rig", "hit"]
from rig.__main__ import main
main()
"""


def test_an_interrupt_while_a_command_is_loaded_is_a_stop() -> None:
    """Ctrl-C before the commands are loaded ends the program as Ctrl-C in a running command does."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", INTERRUPTED], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (130, "\nrig: stopped\n")


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


def test_quiet_prints_nothing_but_json_and_keeps_the_exit_code(capsys: Any) -> None:
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
