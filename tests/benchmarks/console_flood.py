"""Measure how long STOP takes through a console while a process without a token floods it with connections.

    python -m tests.benchmarks.console_flood [--seconds 5] [--rate 3000]

There are three processes: the console, a page that sends STOP twenty times a second, and a program that opens
connections at the given rate, each with one of the loads below, for the given time. The last line is JSON: connections
per second that were tried and that the server accepted, and the times from STOP to its reply (ms). On a busy computer
run it by `chrt -f 5`, and compare with the load "nothing".
"""

import argparse
import asyncio
import json
import multiprocessing
import os
import socket
import statistics
import struct
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

EVERY_S = 0.05
KEPT = 60  # sockets that the flood keeps open
MASKED = b"\x81\x00\x00\x00\x00\x41"  # one byte
HEAD = (
    "GET /live?client=someone-else HTTP/1.1\r\nHost: {0}\r\nOrigin: http://{0}\r\nConnection: Upgrade\r\n"
    "Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
    "Sec-WebSocket-Protocol: rig, token.wrong\r\n\r\n"
)
LOADS = {  # what a connection sends at once, and what it sends ever after
    "nothing": None,
    "connections": (False, b"", b""),
    "long heads": (False, b"X: y\r\n" * 2500, b""),
    "handshakes": (True, b"", b""),
    "continuations": (True, b"\x01" + MASKED, b"\x00" + MASKED),
    "pings": (True, b"", b"\x89" + MASKED),
    "messages": (True, b"", b"\x81" + MASKED),
}


def serve(line: Any, place: str) -> None:
    """Serve a console until the pipe requests its end, with the garbage collector set as `rig console` does."""
    from rig.core import program  # noqa: PLC0415
    from tests.conformance.console import served  # noqa: PLC0415

    program.begin()

    async def whole() -> None:
        async with served(Path(place)) as console:
            program.stay()
            line.send((console.address, console.token))
            while not line.poll():
                await asyncio.sleep(0.1)
            line.recv()
            status = Path("/proc/self/status").read_text(encoding="utf-8")
            line.send(int(status.partition("VmHWM:")[2].split()[0]) / 1024)

    asyncio.run(whole())


def flood(address: str, load: tuple[bool, bytes, bytes], rate: float, seconds: float, line: Any) -> None:
    """Open connections at a rate and normal priority, and send the load on each; reset the oldest of `KEPT`."""
    os.nice(-os.nice(0))
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    upgrades, first, ever = load
    request = (HEAD.format(address).encode() if upgrades else b"") + first
    more = ever * (65536 // len(ever)) if ever else b""
    host, _, port = address.partition(":")
    kept: deque[socket.socket] = deque()
    began, tried, opened = time.monotonic(), 0, 0
    while (now := time.monotonic() - began) < seconds:
        if tried < now * rate:
            one = socket.socket()
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            one.setblocking(False)
            # Over loopback it is there at once, or the server takes no more now.
            one.connect_ex((host, int(port)))
            tried += 1
            with suppress(OSError):
                one.send(request or b"G")
                opened += 1
            kept.append(one)
            if len(kept) > KEPT:
                kept.popleft().close()
        elif not more:
            time.sleep(0.0005)
        if more:
            with suppress(OSError):
                kept[-1 - tried % len(kept)].send(more)
    for one in kept:
        one.close()
    line.send((tried / seconds, opened / seconds))


async def measure_stops(address: str, token: str, seconds: float, begin: Callable[[], None]) -> list[float]:
    """Return the times from STOP to its reply (ms), for a page that was connected before the flood."""
    from tests.conformance.console import Served  # noqa: PLC0415

    took = []
    async with Served(f"http://{address}/#{token}").hold() as hold:
        begin()
        await asyncio.sleep(0.5)
        began = time.monotonic()
        while time.monotonic() - began < seconds:
            sent = time.perf_counter()
            await hold.send('{"stop":true}')
            await hold.recv()
            took.append(1e3 * (time.perf_counter() - sent))
            await asyncio.sleep(EVERY_S)
    return took


def measure_load(load: Any, options: argparse.Namespace, place: str) -> dict[str, float]:
    """Measure STOP under one load, with a new console."""
    ours, theirs = multiprocessing.Pipe()
    console = multiprocessing.Process(target=serve, args=(theirs, place), daemon=True)
    console.start()
    address, token = ours.recv()
    results, sender = multiprocessing.Pipe()
    arguments = (address, load, options.rate, options.seconds + 1.0, sender)
    attacker = multiprocessing.Process(target=flood, args=arguments, daemon=True)
    begin = attacker.start if load is not None else lambda: None
    took = sorted(asyncio.run(measure_stops(address, token, options.seconds, begin)))
    tried, opened = (0.0, 0.0) if load is None else results.recv()
    ours.send("end")
    memory = ours.recv()
    console.join()
    times = {"median": statistics.median(took), "p99": took[int(0.99 * len(took))], "longest": took[-1]}
    return {
        "tried_a_second": round(tried), "opened_a_second": round(opened), "stops": len(took),
        **{f"{name}_ms": round(ms, 1) for name, ms in times.items()}, "memory_mb": round(memory),
    }  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=5.0, help="of each load")
    parser.add_argument("--rate", type=float, default=3000.0, help="connections a second")
    parser.add_argument("--load", choices=list(LOADS), action="append")
    options = parser.parse_args()
    found = {}
    with tempfile.TemporaryDirectory() as place:
        for name in options.load or LOADS:
            found[name] = measure_load(LOADS[name], options, place)
            print(name, found[name], flush=True)
    print(json.dumps({"load": os.getloadavg()[0], **found}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
