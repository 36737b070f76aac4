"""A TCP connection that a test can interrupt like a pulled cable: both ends stay open and receive nothing."""

import socket
import threading
from contextlib import suppress
from typing import Self

CHUNK = 1 << 16
GIVE_UP_S = 5.0


class Cable:
    """A relay from its own port to another port of this computer.

    Attributes
    ----------
    name
        Of the near end, NAME:PORT.
    """

    def __init__(self) -> None:
        self._near = socket.create_server(("127.0.0.1", 0))
        self.name = f"127.0.0.1:{self._near.getsockname()[1]}"
        self._whole = threading.Event()
        self._ends: list[socket.socket] = [self._near]

    def __enter__(self) -> Self:
        return self

    def lead_to(self, port: int) -> None:
        """Relay all further connections to a port."""
        self._whole.set()
        threading.Thread(target=self._accept, args=(port,), daemon=True).start()

    def cut(self) -> None:
        """Stop relaying, and close no connection."""
        self._whole.clear()

    def _accept(self, port: int) -> None:
        with suppress(OSError):  # the near end was closed
            while True:
                here, _ = self._near.accept()
                there = socket.create_connection(("127.0.0.1", port), GIVE_UP_S)
                there.settimeout(None)
                self._ends += [here, there]
                for way in ((here, there), (there, here)):
                    threading.Thread(target=self._pass_on, args=way, daemon=True).start()

    def _pass_on(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):  # either has gone
            while data := source.recv(CHUNK):
                if self._whole.is_set():
                    target.sendall(data)
            if self._whole.is_set():
                target.shutdown(socket.SHUT_WR)

    def __exit__(self, *_: object) -> None:
        for end in self._ends:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)  # wakes who waits for it
            end.close()
