"""A console ends after a signal, whatever it is waiting for."""

import signal
import subprocess
import sys

import pytest

from tests.conformance.started import WAIT_S
from tests.conformance.tiers import first_by_default

HANGS = {
    "in a thread": "await asyncio.to_thread(threading.Event().wait)",
    # The event loop itself is blocked.
    "in its loop": "threading.Event().wait()",
    # A worker thread outlives the server.
    "at its end": "asyncio.create_task(asyncio.to_thread(threading.Event().wait)); await ended.wait()",
}
PROGRAM = """
import asyncio, sys, threading, types
# Loading the server, which is not run here, takes most of a second.
sys.modules["rig.extras.console.server"] = types.SimpleNamespace(ConsoleSettings=None, run=None)
from rig.extras.console import open
open.END_S = 0.2

async def serve(ended):
    print("serves", flush=True)
    {hang}

open.end_on_signal(serve)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no signal is sent to another process there")
@pytest.mark.parametrize(
    ("number", "hang"),
    first_by_default(zip((signal.SIGTERM, signal.SIGINT, signal.SIGHUP), HANGS, strict=True)),
)
def test_a_console_that_waits_for_ever_ends_after_a_signal(hang: str, number: signal.Signals) -> None:
    program = [sys.executable, "-P", "-c", PROGRAM.format(hang=HANGS[hang])]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as console:
        try:
            assert console.stdout is not None
            assert console.stdout.readline() == "serves\n"
            console.send_signal(number)
            _, complaint = console.communicate(timeout=WAIT_S)
        finally:
            console.kill()
    assert console.returncode == 1  # ended by the timer; an orderly end gives 0
    assert "did not end within" in complaint
