"""The person at the rig: what a page may not decide is asked on the terminal that runs the console.

Through a tunnel every page looks local, and whoever drives a browser need not see the handle.
"""

from __future__ import annotations

import asyncio
import sys

import click

WORD = "arm"


class Terminal:
    """Asks on standard input, where that is a terminal."""

    def __init__(self) -> None:
        self.there = sys.stdin is not None and sys.stdin.isatty()
        self._asked: asyncio.Future[str] | None = None

    async def consents(self, text: str) -> bool:
        """Whether the person at the terminal lets a real rig be armed; False where there is nobody to ask."""
        if not self.there or self._asked is not None:
            return False
        loop = asyncio.get_running_loop()
        self._asked = loop.create_future()
        click.echo(
            f"\nrig: a page wants to arm {text}\nrig: is everybody clear of the handle? type {WORD}, or Enter: ",
            nl=False,
        )
        loop.add_reader(sys.stdin.fileno(), self._read)
        try:
            return (await self._asked).strip() == WORD
        finally:
            loop.remove_reader(sys.stdin.fileno())
            self._asked = None

    def _read(self) -> None:
        if self._asked is not None and not self._asked.done():
            self._asked.set_result(sys.stdin.readline())
