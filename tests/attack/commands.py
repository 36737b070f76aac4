"""Run command lines in forks of one process that has imported everything, each in a directory and with a time limit.

A fork takes milliseconds, a new interpreter seconds. The forked process leads a process group, which is killed with it.
"""

import os
import re
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tests.attack.area import require
from tests.conformance.started import die_with_parent

ROOT = Path(__file__).parents[2]
GRACE_S = 20.0  # from Ctrl-C to the end
LOOK_S = 0.002
_CODES = re.compile(r"Exit codes: (.*?)\n\n", re.DOTALL)


def documented() -> frozenset[int]:
    """Return the exit codes that the documentation explains."""
    found = _CODES.search((ROOT / "rig" / "docs" / "reference" / "exit-codes.md").read_text())
    assert found is not None
    return frozenset(int(code) for code in re.findall(r"(?:^|;\s+)(\d+)\s", found[1]))


@dataclass(frozen=True)
class Ended:
    """The end of a command: its exit code (minus the number of the signal that killed it), and its output."""

    code: int
    out: str
    err: str
    interrupted: bool  # it took so long that it got Ctrl-C

    def check(self, allowed: frozenset[int]) -> None:
        """Require a documented exit code, and an output without a traceback."""
        require(self.code in allowed, "exit code", self.code, self.err[-1500:])
        for word in ("Traceback (most recent", "internal error", "Exception ignored in"):
            require(word not in self.err and word not in self.out, word, (self.out + self.err)[-1500:])


def main_of(arguments: Sequence[str]) -> int:
    """Run a command line as `rig` does and return its exit code."""
    from rig.__main__ import main  # noqa: PLC0415  (after the fork of the process that has imported it)

    sys.argv = ["rig", *arguments]
    try:
        main()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    return 0


def preload() -> None:
    """Import all modules that commands need, so that each fork inherits them."""
    import rig.cli  # noqa: F401, PLC0415
    from rig.cli.completion_table import made  # noqa: PLC0415

    made()  # it imports every command


def forked(work: Callable[[], int], directory: Path, environment: Mapping[str, str] | None = None) -> int:
    """Start `work` in a forked process with its own process group, in a directory; return its process number."""
    child = os.fork()
    if child:
        with suppress(OSError):
            os.setpgid(child, child)
        return child
    code = 70
    try:
        os.setpgid(0, 0)
        die_with_parent()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.chdir(directory)
        os.environ.update(environment or {})
        for name, number in (("in", 0), ("out", 1), ("err", 2)):
            flags = os.O_RDONLY if number == 0 else os.O_WRONLY | os.O_CREAT | os.O_TRUNC
            opened = os.open(
                os.devnull if number == 0 else directory.parent / f"{directory.name}.{name}", flags, 0o644
            )
            os.dup2(opened, number)
            os.close(opened)
        sys.stdin, sys.stdout = os.fdopen(0), os.fdopen(1, "w")
        sys.stderr = os.fdopen(2, "w", errors="backslashreplace")  # as an interpreter has it
        code = work()
    except BaseException:
        import traceback  # noqa: PLC0415

        traceback.print_exc()
    finally:
        with suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code & 0xFF)


def waited(child: int, directory: Path, patience_s: float) -> Ended:
    """Wait for the end of a forked process; after `patience_s` send Ctrl-C, then SIGKILL."""
    begun = time.monotonic()
    interrupted = 0.0
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        now = time.monotonic()
        if ended:
            break
        if not interrupted and now - begun > patience_s:
            interrupted = now
            os.kill(child, signal.SIGINT)
        if interrupted and now - interrupted > GRACE_S:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            require(False, "does not end, and ignores Ctrl-C", read_output(directory, "err")[-1500:])
        time.sleep(LOOK_S)
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(status)
    return Ended(code, read_output(directory, "out"), read_output(directory, "err"), bool(interrupted))


def read_output(directory: Path, name: str) -> str:
    """Return what a command has written to its standard output ("out") or standard error ("err")."""
    path = directory.parent / f"{directory.name}.{name}"
    return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""


def run(arguments: Sequence[str], directory: Path, patience_s: float = 60.0, **environment: str) -> Ended:
    """Run a command line in a fork and return how it ended."""
    child = forked(lambda: main_of(arguments), directory, environment)
    return waited(child, directory, patience_s)
