"""Open a console from a program or a command. Without the extra `console`, importing this raises `ConfigError`.

`rig console` uses it. The process must end on Ctrl-C, even if a thread waits for a missing disk (`end_on_signal`).
"""

import asyncio
import os
import signal
import sys
import threading
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from pathlib import Path

from rig.core.errors import ConfigError
from rig.extras.console.server import ConsoleSettings, run
from rig.extras.console.terminal import Terminal

if sys.platform == "win32":
    SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGBREAK)
else:
    SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
END_S = 4.0  # from a signal


def open_console(
    *,
    port: int = 0,
    hosts: Sequence[str] = (),
    verified: bool = False,
    own: bool = False,
    output: str | Path = "recordings",
    announce: Callable[[str], None] = print,
) -> None:
    """Serve the page for operating rigs on this computer until Ctrl-C; recordings are written to `output`.

    `port` 0 is any free port; `hosts` are further names NAME:PORT of this server; `verified`: the operator has checked
    the polarity of encoder and motor; `own`: show only runs of this console; `announce` receives the URL. Raises
    `ConfigError` if a host is not of the form NAME:PORT, or the port is in use.
    """
    for host in hosts:
        name, colon, number = host.rpartition(":")
        if not (name and colon and number.isdecimal()):
            raise ConfigError(
                f"host {host!r} is not of the form NAME:PORT",
                remedy="write it as in the browser's address bar, for example localhost:8000",
            )
    settings = ConsoleSettings(
        port=port, hosts=hosts, verified=verified, own=own, output=Path(output).resolve(), announce=announce
    )
    end_on_signal(lambda ended: run(settings, Terminal(), ended))


def end_on_signal(serve: Callable[[asyncio.Event], Coroutine[None, None, None]]) -> None:
    """Run `serve` with an event, and set the event on a signal such as Ctrl-C; exit at most `END_S` (s) later."""
    # A thread that waits for a missing disk would keep the process running for ever. When the timer ends it, every
    # control loop has received its request to stop, and each job's process completes its own recording.
    late = threading.Timer(END_S, _leave)
    late.daemon = True

    async def served() -> None:
        ended, loop = asyncio.Event(), asyncio.get_running_loop()

        def end(*_: object) -> None:
            with suppress(RuntimeError):  # a second signal: the timer runs already
                late.start()
            loop.call_soon_threadsafe(ended.set)

        before = {number: signal.signal(number, end) for number in SIGNALS}
        try:
            await serve(ended)
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    try:
        asyncio.run(served())
    finally:
        late.cancel()


def _leave() -> None:
    os.write(
        2, f"rig: the console did not end within {END_S:g} s of the signal; its process exits now\n".encode()
    )
    os._exit(1)
