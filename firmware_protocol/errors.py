"""Errors of the protocol, by the side that caused them.

A wrong call of this package is a `LocalProtocolError`; wrong bytes from the other side are a `RemoteProtocolError`.
Host and device run the same checks.
"""

from __future__ import annotations


class ProtocolError(Exception):
    """Base class of the errors of this package; only `LocalProtocolError` and `RemoteProtocolError` are raised."""

    def __init__(self, message: str) -> None:
        if type(self) is ProtocolError:
            raise TypeError("ProtocolError is abstract: raise LocalProtocolError or RemoteProtocolError")
        super().__init__(message)


class LocalProtocolError(ProtocolError):
    """The caller requested something that the protocol forbids; nothing was sent and no state changed."""


class RemoteProtocolError(ProtocolError):
    """The other side sent bytes that the protocol does not allow."""


class IncompatibleMajorError(RemoteProtocolError):
    """The other side uses another major version of the protocol: `theirs` instead of `ours`."""

    def __init__(self, ours: int, theirs: int) -> None:
        super().__init__(f"the device uses major protocol version {theirs}, this package uses {ours}")
        self.ours = ours
        self.theirs = theirs
