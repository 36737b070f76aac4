"""What a command shows while machine code is being made for it."""

from __future__ import annotations

import sys
import threading
import time

import click

SIGN_OF_LIFE_S = 0.2  # on a terminal
LINE_S = 5.0  # in a log


class CompilingNotice:
    """Says that kernels are being compiled, and how long it has taken so far, while they are."""

    def __init__(self) -> None:
        self._busy = threading.Event()
        self._began = 0.0
        self._spent_s = 0.0
        self._thread = threading.Thread(target=self._show, daemon=True)

    def __call__(self, busy: bool) -> None:
        """Be told by `rig.realtime.compiling`."""
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
        text = "compiling what this run needs, once for this version and machine"
        terminal = sys.stderr.isatty()
        if not terminal:
            click.echo(f"{text} …", err=True)
        while True:
            self._busy.wait()
            time.sleep(SIGN_OF_LIFE_S if terminal else LINE_S)
            spent_s = self._spent_s + (time.monotonic() - self._began if self._busy.is_set() else 0.0)
            if terminal:
                click.echo(f"\r{text}: {spent_s:.0f} s ", nl=not self._busy.is_set(), err=True)
            elif self._busy.is_set():
                click.echo(f"  still compiling, {spent_s:.0f} s", err=True)
