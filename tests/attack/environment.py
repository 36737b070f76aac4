"""Run commands where the machine lacks something they expect: rights, descriptors, disk, home, output or time.

Each case is one command in its own process in one environment. It must succeed, or end with a documented exit code and
a message; recordings that it wrote before must be undamaged.
"""

import os
import random
import resource
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from rig.realtime._cache import cache_root
from rig.realtime.kernel import CACHE_DIRECTORY
from tests.attack.area import Outcome, isolation, mounted, require
from tests.attack.commands import ROOT, documented
from tests.conformance.started import die_with_parent

UNPRIVILEGED = 65534
CASE_S = 120.0
BRIEF = ("--duration", "0.3", "--set", "verdict.tail_s=0.1", "--set", "trial.release_s=0.02")
COMMANDS = {
    "hit": ("hit", "--no-plot", *BRIEF),
    "hit with a picture": ("hit", *BRIEF),
    "plan": ("experiment", "plan"),
    "show": ("show", "good.parquet"),
    "export": ("recording", "export", "good.parquet", "new.csv"),
    "replay": ("recording", "replay", "good.parquet"),
    "recover": ("recording", "recover", "."),
    "zwidth": (
        "zwidth", "--no-plot", "--search", "bisection", "--ratio", "4", "--scheme", "uniform:10k", "-B", "0.1",
        "--offsets", "0.1", "--workers", "1",
    ),
    "theory": ("theory", "walls"),
    "doctor": ("doctor",),
    "devices": ("device", "list"),
    "session": ("session", "new", "study.toml"),
}  # fmt: skip
# A wall clock that jumps by hours, back and forth, each time it is looked at.
JUMPS = """
import random, sys, time
chance, true = random.Random({seed}), time.time
time.time = lambda: true() + chance.choice((-7200.0, 0.0, 7200.0, -1e8))
sys.argv[0] = "rig"
from rig.__main__ import main
main()
"""


@dataclass
class Start:
    """The process settings of a command: variables, limits, streams, user and closed descriptors."""

    environment: dict[str, str] = field(default_factory=dict)
    without: tuple[str, ...] = ()  # variables
    limits: dict[int, int] = field(default_factory=dict)
    unprivileged: bool = False
    streams: dict[str, Any] = field(default_factory=dict)
    closed: tuple[int, ...] = ()  # descriptors
    program: tuple[str, ...] = ("-m", "rig")

    def begin(self) -> None:
        """Apply the settings in the child process, before the program starts."""
        for descriptor in self.closed:
            os.close(descriptor)
        if self.unprivileged:
            os.setgroups([])
            os.setgid(UNPRIVILEGED)
            os.setuid(UNPRIVILEGED)
        for limit, value in self.limits.items():
            resource.setrlimit(limit, (value, value))
        die_with_parent()  # after the change of user, which undoes it


class Skip(Exception):  # noqa: N818  (it is no error)
    """Raised where this machine does not permit an environment."""


class Environment:
    """The area "environment": each case is one command in one environment."""

    def __init__(self, place: Path) -> None:
        self._place = place
        self._codes = documented()
        self._cache: Path | None = None
        self._model = place / "model"
        self._model.mkdir()
        made = self._run(Start(), self._model, ("hit", "--no-plot", "--duration", "0.5", "-o", "made"))
        require(made.returncode == 0, "no recording to begin with:", made.stderr)
        (recording,) = (self._model / "made").glob("*.parquet")
        recording.rename(self._model / "good.parquet")
        shutil.rmtree(self._model / "made")
        os.chmod(place, 0o755)

    def attack(self, case: int, chance: random.Random) -> Outcome:
        """Run one drawn command in the environment of this case and check its end and its recordings."""
        name = list(KINDS)[case % len(KINDS)]
        command = chance.choice(list(COMMANDS))
        here = self._place / "here"
        shutil.copytree(self._model, here)
        figures = Counter(runs=1)
        try:
            with KINDS[name](self, here, chance) as start:
                ended = self._run(start, here, COMMANDS[command])
                self._check(ended, f"{command}, {name}, {start}")
                self._check_recordings(here)
        except Skip as skip:
            return Outcome(skipped=Counter({f"{name}: {skip}": 1}))
        finally:
            shutil.rmtree(here, ignore_errors=True)
        figures[f"code {ended.returncode}"] = 1
        return Outcome(figures)

    def _run(self, start: Start, here: Path, command: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
        environment = {"PYTHONPATH": str(ROOT), **os.environ, **start.environment}
        for name in start.without:
            environment.pop(name, None)
        pipes: dict[str, Any] = {
            "stdin": subprocess.DEVNULL,
            "stdout": subprocess.PIPE,
            "stderr": subprocess.PIPE,
        }
        options = {"cwd": here, "env": environment, "preexec_fn": start.begin, **pipes, **start.streams}
        with subprocess.Popen([sys.executable, *start.program, *command], **options) as process:
            try:
                out, err = process.communicate(timeout=CASE_S)
            finally:
                process.kill()
        return subprocess.CompletedProcess(
            command,
            process.returncode,
            *(None if text is None else text.decode("utf-8", "replace") for text in (out, err)),
        )

    def _check(self, ended: subprocess.CompletedProcess[str], what: str) -> None:
        output = (ended.stderr or "") + (ended.stdout or "")
        require(ended.returncode in self._codes, what, "ends with", ended.returncode, output[-1500:])
        for word in ("Traceback (most recent", "internal error", "Exception ignored in"):
            require(word not in output, what, "prints", output[-1500:])

    def _check_recordings(self, here: Path) -> None:
        """Require that every sealed recording is readable."""
        from rig.recording.reader import open_recording  # noqa: PLC0415

        for path in here.rglob("*.parquet"):
            if path.parent.name == "recordings":
                require(len(open_recording(path)) > 0, path, "is empty")

    def cache_of_another_user(self) -> str:
        """Return a cache of compiled kernels that belongs to another user, so that nothing must be compiled."""
        if os.getuid() != 0 or "--user" in isolation():
            raise Skip("needs root")
        if not _runs_without_privileges():
            raise Skip("a user without privileges may not run this interpreter")
        if self._cache is None:
            self._cache = self._place / "cache"
            shutil.copytree(cache_root(), self._cache, ignore=_other_versions)
            subprocess.run(["chown", "-R", f"{UNPRIVILEGED}:{UNPRIVILEGED}", str(self._cache)], check=True)
        return str(self._cache)


@cache
def _runs_without_privileges() -> bool:
    try:
        done = subprocess.run(
            [sys.executable, "-c", "import rig"], cwd=ROOT, user=UNPRIVILEGED, group=UNPRIVILEGED, extra_groups=[],
            capture_output=True, check=False,
        )  # fmt: skip
    except OSError:
        return False
    return done.returncode == 0


def _other_versions(place: str, names: list[str]) -> list[str]:
    """Return the names of cache directories that belong to other versions of the sources."""
    return [name for name in names if Path(place) == cache_root() and name != CACHE_DIRECTORY.name]


Kind = Callable[[Environment, Path, random.Random], Any]
KINDS: dict[str, Kind] = {}


def kind(name: str) -> Callable[[Callable[..., Iterator[Start]]], None]:
    """Register an environment in `KINDS` under a name."""

    def enter(make: Callable[..., Iterator[Start]]) -> None:
        KINDS[name] = contextmanager(make)

    return enter


@kind("read-only directory of another user")
def _read_only(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    environment = {
        "HAPTIC_RIG_CACHE": area.cache_of_another_user(),
        "HOME": chance.choice(("/nonexistent", str(here))),
    }
    os.chmod(here, 0o555)
    yield Start(environment, unprivileged=True)
    os.chmod(here, 0o755)


@kind("directory that was removed")
def _removed(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    yield Start(
        program=("-c", "import os, shutil; shutil.rmtree(os.getcwd()); from rig.__main__ import main; main()")
    )
    here.mkdir(exist_ok=True)


@kind("clock that jumps")
def _clock(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    yield Start(program=("-c", JUMPS.format(seed=chance.getrandbits(32))))


@kind("faketime")
def _faketime(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    libraries = [
        path
        for place in ("/usr/lib", "/usr/lib64")
        for path in Path(place).glob("*/faketime/libfaketime.so.1")
    ]
    if not libraries:
        raise Skip("not installed")
    yield Start(
        {
            "LD_PRELOAD": str(libraries[0]),
            "FAKETIME": chance.choice(("1970-01-02 00:00:00", "2100-01-01 00:00:00")),
        }
    )


@kind("time zone")
def _zone(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    yield Start(
        {
            "TZ": chance.choice(
                ("Asia/Kathmandu", "Pacific/Kiritimati", "nowhere/at-all", "", ":", "XXX-25:99:99")
            )
        }
    )


@kind("locale")
def _locale(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    more = chance.choice(({}, {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}, {"PYTHONIOENCODING": "ascii"}))
    yield Start({"LC_ALL": chance.choice(("C", "POSIX", "tr_TR.UTF-8", "no_such")), "LANG": "C", **more})


@kind("terminal")
def _terminal(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    yield Start(
        {
            "TERM": chance.choice(("dumb", "", "xterm")),
            "COLUMNS": chance.choice(("1", "0", "-5", "x", "100000")),
        }
    )


@kind("no memory to share")
def _no_shared_memory(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    if not isolation():
        raise Skip("needs mounts of its own")
    with mounted(Path("/dev/shm"), chance.choice(("ro,size=4k", "size=4k"))) as done:
        if not done:
            raise Skip("mount is refused")
        yield Start()


@kind("full disk")
def _full(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    with mounted(here / "recordings", f"size={chance.choice((4, 16, 64, 256))}k") as done:
        if not done:
            raise Skip("mount is refused")
        yield Start({"TMPDIR": str(here / "recordings")} if chance.random() < 0.3 else {})


@kind("short files")
def _short(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    yield Start(limits={resource.RLIMIT_FSIZE: chance.choice((0, 1, 100, 5_000, 50_000, 200_000))})


@kind("few descriptors")
def _few(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    yield Start(limits={resource.RLIMIT_NOFILE: chance.randrange(6, 40)})


@kind("no rights")
def _no_rights(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    limits = {
        resource.RLIMIT_RTPRIO: 0,
        resource.RLIMIT_MEMLOCK: 0,
        resource.RLIMIT_NICE: 0,
        resource.RLIMIT_CORE: 0,
    }
    os.chmod(here, 0o777)
    if chance.random() < 0.5:
        yield Start({"HAPTIC_RIG_CACHE": area.cache_of_another_user()}, limits=limits, unprivileged=True)
    else:
        yield Start(limits=limits)


@kind("no home")
def _no_home(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    yield Start(
        {"HOME": chance.choice(("", "/nonexistent", "/dev/null"))},
        without=chance.choice(((), ("HOME", "USER", "LOGNAME"))),
    )


@kind("no path")
def _no_path(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    yield Start({"PATH": chance.choice(("", "/nonexistent"))})


@kind("closed streams")
def _closed(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    yield Start(closed=chance.choice(((1,), (2,), (0,), (0, 1), (1, 2), (0, 1, 2))))


@kind("full output")
def _full_output(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    with open("/dev/full", "wb") as full:
        yield Start(
            streams=dict.fromkeys(chance.choice((("stdout",), ("stderr",), ("stdout", "stderr"))), full)
        )


@kind("reader that has gone")
def _gone(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    reader, writer = os.pipe()
    os.close(reader)
    yield Start(streams={"stdout": writer})
    os.close(writer)


@kind("little memory")
def _little(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    yield Start(limits={resource.RLIMIT_AS: chance.choice((2, 3, 4)) << 30})


@kind("strange directory")
def _strange(area: Environment, here: Path, chance: random.Random) -> Iterator[Start]:
    odd = here / chance.choice(("a b", "ü", "-o", "\udcff", "x" * 200, "'\"$(x)", "new\nline"))
    odd.mkdir()
    yield Start(
        program=("-c", f"import os; os.chdir({os.fsencode(odd)!r}); from rig.__main__ import main; main()")
    )
