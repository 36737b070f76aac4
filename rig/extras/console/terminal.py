"""Ask a person at the rig, on the terminal that runs the console, to confirm what a page may not decide alone.

Through a tunnel every page looks local, and the person at the browser may be unable to see the handle.
"""

import asyncio
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

import click

from rig.core.errors import ConfigError

if sys.platform != "win32":
    import termios

WORD = "arm"
LINE_BYTES = 4096
LONGEST = 2000  # characters that a person can be expected to read


class Terminal:
    """The console's terminal, on which one question at a time can be asked; nothing can be asked without a terminal."""

    def __init__(self) -> None:
        # On Windows no question can be asked: a loop of asyncio does not watch a terminal there.
        self.there = sys.platform != "win32" and sys.stdin is not None and sys.stdin.isatty()
        self._asked: asyncio.Future[str] | None = None

    async def insist(self, url: str, lines: Sequence[str]) -> None:
        """Show `lines` on the terminal; raise `ConfigError` unless the person at the terminal types the word "arm"."""
        if not self.there:
            raise _refusal(
                url,
                "the console does not run in a terminal, where a person must confirm",
                "run `rig console` in a terminal beside the rig",
            )
        if self._asked is not None:
            raise _refusal(
                url,
                "the terminal is waiting for the answer to another question",
                "answer that question first",
            )
        if sum(len(line) for line in lines) > LONGEST:
            raise _refusal(
                url,
                f"the settings to confirm have more than {LONGEST} characters",
                "put the changes into an experiment file, and open that file",
            )
        if not await self._consents(lines):
            raise _refusal(
                url, f"{WORD} was not typed at the console's terminal", f"type {WORD} there when it asks"
            )

    async def _consents(self, lines: Sequence[str]) -> bool:
        loop, terminal = asyncio.get_running_loop(), sys.stdin.fileno()
        self._asked = loop.create_future()
        if sys.platform != "win32":
            # Keys that were pressed before the question appeared do not answer it.
            termios.tcflush(terminal, termios.TCIFLUSH)
        click.echo(
            f"\nrig: a page wants to arm {f'{chr(10)}rig:   '.join(_printable(line) for line in lines)}\n"
            f"rig: are all hands clear of the handle? type {WORD} to arm, or Enter to refuse: ",
            nl=False,
        )
        loop.add_reader(terminal, self._read)
        try:
            return (await self._asked).strip() == WORD
        finally:
            loop.remove_reader(terminal)
            self._asked = None

    def withdraw(self) -> None:
        """Withdraw the open question, because a STOP came or the page that sent the request is gone."""
        if self._asked is not None and not self._asked.done():
            self._asked.set_result("")
            click.echo("\nrig: the request was withdrawn; nothing is armed")

    def _read(self) -> None:
        line = b""
        with suppress(OSError):  # the terminal was closed
            line = os.read(sys.stdin.fileno(), LINE_BYTES)  # does not wait for the end of a line
        if self._asked is not None and not self._asked.done():
            self._asked.set_result(line.decode(errors="replace"))


def _refusal(url: str, why: str, remedy: str) -> ConfigError:
    return ConfigError(f"{url} is a real rig and was not armed: {why}", remedy=remedy)


def _printable(text: str) -> str:
    """Return a page's text with each character that controls a terminal (escape, new line, direction) replaced."""
    return "".join(one if one.isprintable() else "�" for one in text)
