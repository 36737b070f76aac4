"""Exceptions of the protocol, divided by the end of the link that caused the error.

A call that the protocol forbids raises `LocalProtocolError`; wrong bytes from the other end raise
`RemoteProtocolError`. Host and device run the same checks. `rig.devices.framed` converts them to errors with a remedy,
which this package must not name.
"""


class ProtocolError(Exception):
    """Base class of this package's exceptions; only `LocalProtocolError` and `RemoteProtocolError` can be raised."""

    def __init__(self, message: str) -> None:
        if type(self) is ProtocolError:
            raise TypeError("ProtocolError is abstract: raise LocalProtocolError or RemoteProtocolError")
        super().__init__(message)


class LocalProtocolError(ProtocolError):
    """The caller requested something that the protocol forbids; no byte was sent and no state changed."""


class RemoteProtocolError(ProtocolError):
    """The other end of the link sent bytes that the protocol does not allow."""


class IncompatibleMajorError(RemoteProtocolError):
    """The device uses another major version of the protocol (`theirs`) than this package (`ours`)."""

    def __init__(self, ours: int, theirs: int) -> None:
        super().__init__(
            f"the device uses major protocol version {theirs}, this package {ours}; flash firmware of the same version"
        )
        self.ours = ours
        self.theirs = theirs
