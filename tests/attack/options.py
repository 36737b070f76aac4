"""Pass any value to any option of any command: documented exit code, no traceback, no file left elsewhere.

The commands come from click. Values are garbage, empty, huge, negative, not numbers, wrong files, or directories.
"""

import random
import resource
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import click

from tests.attack.area import Outcome, isolation, require
from tests.attack.commands import Ended, documented, preload, run
from tests.conformance.commands import commands

PATIENCE_S = 4.0  # a value may be right and the work long: then Ctrl-C has to end it
SERVED_S = 0.5  # of what ends by Ctrl-C alone: while it begins, or when it serves
SERVE = {("console",), *(("serve", what) for what in ("rig", "moteus", "odrive", "lsl"))}
FILE_BYTES = 1 << 28  # that a huge value may not fill the disk
MEMORY_BYTES = 1 << 33
# They find all loops of this user, so they need a process namespace.
OF_ALL_LOOPS = {("stop",), ("set",), ("serve", "lsl")}
BESIDE = {"home", "tmp", "model", "model.out", "model.err", "fonts", "here", "here.out", "here.err"}
WORDS = (
    "", " ", "x", "-1", "0", "1", "-0.0", "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "9" * 400,
    "1_0", "٣", "1,5", "0x10", "true", "None", "--", "-", "=", "k=v", "wall.stiffness=nan",
    "wall.stiffness=1e400", "rig.encoder=3", "a.b.c=1", "trial=[]", "[", "{}", "1:2", "2:1", "0:0:0", ":",
    "1:2:3:4", "a" * 5000, "\udcff\udcfe", "\u202e", "%s%n%d", "\n", "\t", "sim://", "sim://koul-rigid",
    "sim://nowhere", "sim://?seed=x", "sim://?clock_ppm=nan", "serial://", "serial://missing", "usb://",
    "usb://zz:zz", "http://x", "://", "tcp://", "uniform:0", "uniform:1k", "dual:1k", "dual:1k/0", "1k/3k",
    "20k/2k",
)  # fmt: skip
FILES = (
    "missing", "missing/below", "empty", "noise", "text", "directory", "directory/", "there.toml",
    "broken.toml", "nul.toml", "deep.toml", "fake.parquet", "cut.parquet", "fake.rigcap", "cut.rigcap",
    "good.parquet", "loop", "locked", "new.png", "new.csv", "new.toml", "\udcff.toml", "x" * 255, "x" * 256,
    "study.toml", "good.json", ".",
)  # fmt: skip


class Options:
    """The area "options": each case is one command line."""

    def __init__(self, place: Path) -> None:
        preload()
        self._place = place
        self._codes = documented()
        self._commands = [one for one in commands() if isolation() or one[0] not in OF_ALL_LOOPS]
        self._home = place / "home"
        self._elsewhere = place / "tmp"
        self._model = place / "model"
        self._fonts = place / "fonts"
        for directory in (self._home, self._elsewhere, self._model, self._fonts):
            directory.mkdir()
        _write_files(self._model)

    def attack(self, case: int, chance: random.Random) -> Outcome:
        """Run one command with some of its options, most of them with a wrong value."""
        directory = self._place / "here"
        shutil.copytree(self._model, directory, symlinks=True)
        (directory / "locked").chmod(0)
        words, command = self._commands[case % len(self._commands)]
        line = [*words, *self._arguments(command, chance)]
        ended = self._run(line, directory, SERVED_S if words in SERVE else PATIENCE_S)
        try:
            ended.check(self._codes)
            for elsewhere in (self._home, self._elsewhere):
                left = [path for path in elsewhere.rglob("*") if path.is_file()]
                require(not left, "left elsewhere:", left)
            extra = {path.name for path in self._place.iterdir()} - BESIDE
            require(not extra, "left beside its directory:", extra)
        except AssertionError as error:
            raise AssertionError(f"rig {line}: {error}") from None
        finally:
            for path in (directory, self._home, self._elsewhere):
                shutil.rmtree(path, ignore_errors=True)
            self._home.mkdir()
            self._elsewhere.mkdir()
        figures = Counter({"runs": 1, "interrupted": int(ended.interrupted), f"code {ended.code}": 1})
        return Outcome(figures)

    def _run(self, line: list[str], directory: Path, patience_s: float) -> Ended:
        limits = {resource.RLIMIT_FSIZE: FILE_BYTES, resource.RLIMIT_AS: MEMORY_BYTES}
        before = {limit: resource.getrlimit(limit) for limit in limits}
        for limit, value in limits.items():
            resource.setrlimit(limit, (value, before[limit][1]))
        try:
            places = {"HOME": self._home, "TMPDIR": self._elsewhere, "MPLCONFIGDIR": self._fonts}
            return run(line, directory, patience_s, **{name: str(place) for name, place in places.items()})
        finally:
            for limit, value in before.items():
                resource.setrlimit(limit, value)

    def _arguments(self, command: click.Command, chance: random.Random) -> list[str]:
        words: list[str] = []
        context = click.Context(command)
        options = [one for one in command.get_params(context) if isinstance(one, click.Option)]
        chosen = chance.sample(options, min(len(options), chance.choice((0, 1, 1, 2, 3))))
        for option in [*(one for one in options if one.required and one not in chosen), *chosen]:
            words.append(chance.choice(option.opts + option.secondary_opts))
            if not option.is_flag and not option.count:
                words += [_value(option, chance) for _ in range(max(1, option.nargs))]
        for argument in command.params:
            if isinstance(argument, click.Argument) and (argument.required or chance.random() < 0.5):
                count = chance.randrange(1, 4) if argument.nargs == -1 else argument.nargs
                words += [_value(argument, chance) for _ in range(count)]
        if chance.random() < 0.05:
            words += [chance.choice(WORDS)]
        return words


def _value(parameter: click.Parameter, chance: random.Random) -> str:
    """Draw a value that may be accepted (a number for a number, a file for a file), or any other."""
    kind: Any = parameter.type
    if isinstance(kind, click.Choice) and chance.random() < 0.5:
        return str(chance.choice(list(kind.choices)))
    if isinstance(kind, click.Path) and chance.random() < 0.8:
        return chance.choice(FILES)
    if isinstance(kind, click.types.IntParamType | click.types.FloatParamType) and chance.random() < 0.4:
        return chance.choice(("0", "1", "2", "-1", "0.5", "1e9", "100"))
    return chance.choice(WORDS if chance.random() < 0.8 else FILES)


def _write_files(place: Path) -> None:
    """Write the files that options name: valid, damaged and mislabelled ones."""
    made = run(["hit", "--no-plot", "--duration", "0.5", "-o", "made"], place, 600.0)
    require(made.code == 0, "no recording to begin with:", made.err)
    (recording,) = (place / "made").glob("*.parquet")
    whole = recording.read_bytes()
    protocol = run(["session", "new", "study.toml"], place, 600.0)
    require(protocol.code == 0, "no protocol to begin with:", protocol.err)
    preset = run(["experiment", "preset", "koul-compliant"], place, 600.0).out
    for name, content in {
        "empty": b"",
        "noise": random.Random(0).randbytes(5000),
        "text": b"once upon a time\n",
        "there.toml": preset.encode(),
        "broken.toml": preset.encode()[: len(preset) // 2] + b"= = =",
        "nul.toml": b"a = 1\0\n",
        "deep.toml": b"a = " + b"[" * 3000 + b"]" * 3000,
        "fake.parquet": b"PAR1" + bytes(100) + b"PAR1",
        "cut.parquet": whole[: len(whole) // 2],
        "good.parquet": whole,
        "fake.rigcap": b"RIGCAP" + bytes(1000),
        "cut.rigcap": whole[:1000],
        "good.json": b"{}",
        "locked": b"",
    }.items():
        (place / name).write_bytes(content)
    shutil.rmtree(place / "made")
    (place / "directory").mkdir()
    (place / "loop").symlink_to("loop")
