"""Pseudo-terminals that replace serial lines."""

import os
import pty
import tty
from collections.abc import Iterator

import pytest


class Line:
    """A pseudo-terminal: the device's end is a descriptor, the host's end a path."""

    def __init__(self) -> None:
        self.device, slave = pty.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        os.close(slave)

    def unplug(self) -> None:
        device, self.device = self.device, -1
        if device >= 0:
            os.close(device)


@pytest.fixture
def line() -> Iterator[Line]:
    made = Line()
    yield made
    made.unplug()
