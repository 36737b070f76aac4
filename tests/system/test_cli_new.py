"""`rig experiment new` by options and at a terminal, and the commands from a new experiment to a map."""

import io
import json
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import rig
import rig.cli
from rig.cli._listing import commands
from rig.cli._next_step import NEXT
from tests.conformance.commands import parse_line

OPTIONS = shlex.split(
    "--mechanism lever --torque-constant 38.5mNm/A --rotor-inertia 110gcm2 --nominal-current 2.5A --encoder-lines 2048 "
    "--transmission 12 --handle-length 8cm --handle-mass 60g"
)
ANSWERS = ["linear-motor", "20", "1.5", "", "", "", "1 µm", "400 g", "", "", "", "", "", "none"]


class Terminal(io.StringIO):
    """A terminal on which a person types the given lines; reading beyond the last one raises `ends`."""

    def __init__(self, *lines: str, ends: type[BaseException] = EOFError) -> None:
        super().__init__("".join(f"{line}\n" for line in lines))
        self._ends = ends

    def isatty(self) -> bool:
        return True

    def readline(self, size: int | None = -1, /) -> str:
        line = super().readline(-1 if size is None else size)
        if not line:
            raise self._ends
        return line


@pytest.fixture
def type_lines(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    return lambda *lines, **more: monkeypatch.setattr(sys, "stdin", Terminal(*lines, **more))


def test_options_make_the_file_of_the_function(run: Any) -> None:
    code, out, err = run("experiment", "new", "mine.toml", *OPTIONS)
    assert code == 0
    assert "assumed  rig.mechanics" in out
    assert err == "next: rig experiment plan mine.toml\n"
    made = rig.new_rig(
        mechanism="lever", torque_constant=0.0385, rotor_inertia=1.1e-5, nominal_current=2.5, encoder_lines=2048,
        transmission=12.0, handle_length=0.08, handle_mass=0.06,
    )  # fmt: skip
    assert Path("mine.toml").read_text(encoding="utf-8") == made.text
    code, out, err = run("experiment", "new", "other.toml", *OPTIONS, "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["experiment"]["rig"]["name"] == "other"


def test_an_existing_file_is_replaced_only_on_agreement(run: Any, type_lines: Any) -> None:
    Path("mine.toml").write_text("# mine\n")
    code, _, err = run("experiment", "new", *OPTIONS)
    assert code == 2
    assert "--overwrite" in err
    type_lines("n", *ANSWERS)
    assert run("experiment", "new")[0] == 2
    assert Path("mine.toml").read_text() == "# mine\n"
    type_lines("y", *ANSWERS)
    assert run("experiment", "new")[0] == 0
    assert rig.load("mine.toml").rig.motion == "linear"
    assert run("experiment", "new", *OPTIONS, "--overwrite")[0] == 0
    assert rig.load("mine.toml").rig.motion == "rotary"


def test_after_a_wrong_answer_the_question_names_the_allowed_values(run: Any, type_lines: Any) -> None:
    type_lines("belt", *ANSWERS[:1], "20 N·m/A", *ANSWERS[1:7], *ANSWERS[8:])
    code, out, err = run("experiment", "new", "slide.toml", "--carriage-mass", "0.4")  # not asked for
    assert code == 0, out + err
    assert "one of lever, carriage, linear-motor" in out + err
    assert "a number from 0.01 to 10000 N/A" in out + err
    made = rig.load("slide.toml")
    assert made.rig.encoder.quantum == 1e-6
    assert made.rig.mechanics.motor_inertia == 0.4
    assert made.controller.position_rate == 1000


@pytest.mark.parametrize("answered", [0, 1, 5, len(ANSWERS) - 1])
def test_ctrl_c_leaves_no_file(run: Any, type_lines: Any, answered: int) -> None:
    type_lines(*ANSWERS[:answered], ends=KeyboardInterrupt)
    assert run("experiment", "new")[0] == 130
    assert not list(Path().iterdir())


# ------------------------------------------------------------------ the way


@pytest.mark.parametrize("name", NEXT)
def test_a_next_command_exists_with_its_options(name: str) -> None:
    words = shlex.split(NEXT[name].format(rig=" mine.toml", device=" --url sim://"))
    assert words[0] == "rig"
    parse_line(words[1:])


def test_the_next_command_has_the_rig_and_the_device_of_this_one(run: Any) -> None:
    assert run("experiment", "plan", "--rig", "koul-rigid")[2] == "next: rig hit --rig koul-rigid\n"
    assert run("experiment", "plan")[2] == "next: rig hit\n"
    assert (
        run("experiment", "plan", "--url", "sim://hapkit")[2]
        == "next: rig hit --rig hapkit --url sim://hapkit\n"
    )
    assert run("experiment", "plan", "--json")[2] == ""
    assert run("experiment", "plan", "-q")[1:] == ("", "")
    code, _, err = run("experiment", "plan", "-K", "0")
    assert code == 2
    assert "next:" not in err


def test_a_command_that_moves_the_motor_prints_a_warning_first(run: Any) -> None:
    assert run("experiment", "plan")[1].startswith("checked, nothing moves: ")
    known = commands()
    assert "nothing moves" in known["experiment plan"]["help"]
    assert known["device check"]["help"].startswith("MOVE THE MOTOR")
    assert run("device", "check", "--rig", "koul-rigid")[2].startswith(
        "this moves the motor: hands off the handle"
    )
