"""Open a console, from a program or a command. Without its extra this raises `ConfigError` when it is imported."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Callable, Coroutine, Sequence
from pathlib import Path

from rig.console.server import Settings, run
from rig.console.terminal import Terminal
from rig.core.errors import ConfigError


def open_console(
    *,
    port: int = 0,
    hosts: Sequence[str] = (),
    verified: bool = False,
    own: bool = False,
    output: str | Path = "recordings",
    announce: Callable[[str], None] = print,
) -> None:
    """Serve the page on loopback until Ctrl-C; arguments as `rig.console.server.Settings`.

    Raises
    ------
    ConfigError
        A host is no NAME:PORT, or the port is taken.
    """
    for host in hosts:
        name, colon, number = host.rpartition(":")
        if not (name and colon and number.isdecimal()):
            raise ConfigError(
                f"{host!r} is no NAME:PORT", remedy="write it as the browser's address bar has it"
            )
    settings = Settings(
        port=port, hosts=hosts, verified=verified, own=own, output=Path(output).resolve(), announce=announce
    )
    asyncio.run(_until_told(lambda ended: run(settings, Terminal(), ended)))


async def _until_told(serve: Callable[[asyncio.Event], Coroutine[None, None, None]]) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    if sys.platform == "win32":  # whose loops take no handlers
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGBREAK):
            signal.signal(number, lambda *_: loop.call_soon_threadsafe(ended.set))
    else:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            loop.add_signal_handler(number, ended.set)
    await serve(ended)
