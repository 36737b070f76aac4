"""The parent's side of the USB tests: buses with a bridge and a device behind it, and a child in which libusb sees one.

The child runs under umockdev's preload library, so that its libusb, which is the real one, finds the emulated bus.
It runs named checks (`checks`), each on a given bus, and orders faults from the bridge itself.
"""

import json
import os
import shutil
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from sim_backend.ends.usb import UsbShape, serve
from tests.conformance.rigs import rotary_rig

ROOT = Path(__file__).parents[3]
PRELOAD = "libumockdev-preload.so.0"
WAIT_S = 60.0


def build(directory: Path) -> Path:
    """Compile the bridge; skip the test, with the package's name, if a tool is missing."""
    for tool, package in (("gcc", "gcc"), ("pkg-config", "pkg-config"), ("umockdev-run", "umockdev")):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed (package {package})")
    asked = ["pkg-config", "--cflags", "--libs", "umockdev-1.0"]
    flags = subprocess.run(asked, capture_output=True, text=True, check=False)
    if flags.returncode:
        pytest.skip("umockdev's headers are not installed (package libumockdev-dev)")
    program, source = directory / "bridge", Path(__file__).with_name("bridge.c")
    warnings = ("-O1", "-Wall", "-Wextra", "-Werror")
    subprocess.run(["gcc", *warnings, "-o", program, source, *flags.stdout.split(), "-lpthread"], check=True)
    return program


class Bus:
    """An emulated bus: a bridge process with a simulated rig behind it. The owner must close it."""

    def __init__(
        self, program: Path, shape: UsbShape | None = None, model: Any = None, **options: Any
    ) -> None:
        shape = shape or UsbShape()
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        strings = [(shape.string(index) or b"").hex() for index in range(5)]
        self.bridge = subprocess.Popen(
            [program, str(theirs.fileno()), (shape.device() + shape.configuration()).hex(), *strings],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            pass_fds=[theirs.fileno()],
            env=os.environ | {"LD_PRELOAD": PRELOAD},
        )
        theirs.close()
        assert self.bridge.stdout is not None
        self.root = self.bridge.stdout.readline().split()[1]
        self._stop = threading.Event()
        self._end = ours
        self._device = threading.Thread(
            target=serve,
            args=(model or rotary_rig(), ours),
            kwargs={"stop_event": self._stop, "packet": shape.packet, **options},
            daemon=True,
        )
        self._device.start()

    def place(self) -> list[str]:
        """Return where a child process finds the bus: its directory, and the pipes to and from the bridge."""
        assert self.bridge.stdin is not None
        assert self.bridge.stdout is not None
        pipes = (self.bridge.stdin, self.bridge.stdout)
        return [self.root, *(f"/proc/{os.getpid()}/fd/{pipe.fileno()}" for pipe in pipes)]

    def close(self) -> None:
        self._stop.set()
        self._device.join(WAIT_S)
        assert self.bridge.stdin is not None
        self.bridge.stdin.close()
        try:
            self.bridge.wait(WAIT_S)
        finally:
            self.bridge.kill()
            self.bridge.wait()
            assert self.bridge.stdout is not None
            self.bridge.stdout.close()
            self._end.close()
            shutil.rmtree(self.root, ignore_errors=True)


class Child:
    """A process with umockdev's preload library that runs checks by name."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-W", "error", "-m", "tests.system.usb.child"],
            env=os.environ | {"LD_PRELOAD": PRELOAD},
            cwd=ROOT,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )

    def check(self, bus: Bus, transfers: str, *words: str) -> Any:
        """Run one check in the child and return its result; a failed check raises here."""
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(" ".join([*bus.place(), transfers, *words]) + "\n")
        process.stdin.flush()
        line = process.stdout.readline()
        assert line, f"the child ended with {process.wait(WAIT_S)}"
        answer = json.loads(line)
        if "failure" in answer:
            pytest.fail(answer["failure"], pytrace=False)
        return answer["found"]

    def close(self) -> int:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            return self._process.wait(WAIT_S)
        finally:
            self._process.kill()
            self._process.wait()
            self._process.stdout.close()
