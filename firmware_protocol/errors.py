"""Whose fault it is.

A wrong call of ours is a `LocalProtocolError`, wrong bytes from the other side a `RemoteProtocolError`.
Both roles run the same checks; the blame follows from the entry through which the fault came.
"""

from __future__ import annotations


class ProtocolError(Exception):
    """Root of the errors of this package; only its two branches are raised."""

    def __init__(self, message: str) -> None:
        if type(self) is ProtocolError:
            raise TypeError("ProtocolError is abstract: raise LocalProtocolError or RemoteProtocolError")
        super().__init__(message)


class LocalProtocolError(ProtocolError):
    """The caller requested something that the protocol forbids; nothing was sent and no state changed."""


class RemoteProtocolError(ProtocolError):
    """The other side sent something that cannot be meant."""


class IncompatibleMajorError(RemoteProtocolError):
    """The other side speaks another major version; `ours` and `theirs` say which."""

    def __init__(self, ours: int, theirs: int) -> None:
        super().__init__(f"the device uses major protocol version {theirs}, this package uses {ours}")
        self.ours = ours
        self.theirs = theirs
