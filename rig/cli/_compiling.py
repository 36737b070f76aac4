"""Show a notice on standard error while machine code is compiled for the running command."""

import math
import sys
import threading
import time

import click

from rig.realtime import compiling

# Interval of the notice on a terminal (s).
SIGN_OF_LIFE_S = 0.2
# Interval of the lines in a log (s).
LINE_S = 5.0
EXPECTED = {"hit": 120}  # kernels that a command compiles first; tests/benchmarks/test_startup.py counts them


class CompilingNotice:
    """A notice with the number of kernels (compiled functions) so far, and the remaining time if known.

    `expected` is the number of kernels that the command compiles with an empty cache; 0 if unknown.
    """

    def __init__(self, expected: int = 0) -> None:
        self._expected = expected
        self._busy = threading.Event()
        self._began = 0.0
        self._spent_s = 0.0
        self._thread = threading.Thread(target=self._show, daemon=True)

    def __call__(self, busy: bool) -> None:
        """Show the notice if `busy` is True (a compilation begins), hide it otherwise."""
        now = time.monotonic()
        if busy:
            self._began = now
            self._busy.set()
            if not self._thread.is_alive():
                self._thread.start()
        else:
            self._busy.clear()
            self._spent_s += now - self._began

    def _show(self) -> None:
        text = "compiling the code of this run (once per version and machine)"
        terminal = sys.stderr.isatty()
        if not terminal:
            click.echo(f"{text} …", err=True)
        while True:
            self._busy.wait()
            time.sleep(SIGN_OF_LIFE_S if terminal else LINE_S)
            spent_s = self._spent_s + (time.monotonic() - self._began if self._busy.is_set() else 0.0)
            if terminal:
                click.echo(f"\r{text}: {self._so_far(spent_s)} ", nl=not self._busy.is_set(), err=True)
            elif self._busy.is_set():
                click.echo(f"  still compiling: {self._so_far(spent_s)}", err=True)

    def _so_far(self, spent_s: float) -> str:
        done = compiling.kernels()
        left = self._expected - done
        rest = f", about {math.ceil(spent_s / done * left)} s left" if done and left > 0 else ""
        return f"{done} kernels in {spent_s:.0f} s{rest}".ljust(40)
