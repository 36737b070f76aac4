"""What a far end must offer: a link of bytes that Python and the compiled loop can both use.

A backend is one function ``open(url, model, options) -> Link``; `rig.devices` finds it by the scheme of the
URL. The link carries the frames of `firmware_protocol` and nothing else, so that everything above it is the
shipped code, whether a board, a process behind a pseudo-terminal or the simulation in this process answers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol
from urllib.parse import parse_qsl, urlsplit

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages
from firmware_protocol.packing import encoded_bytes
from rig.core.errors import ConfigError
from rig.devices.port import LoopPort
from rig.realtime.clock import Clock

STATE_BYTES = encoded_bytes(messages.State)  # of the host loop's larger frame, on the wire
LINK_SHARE = 0.7  # of a link's capacity that a loop may use; the rest is for answers and retries


@dataclass(frozen=True, slots=True)
class DeviceUrl:
    """``scheme://place?key=value``: for example ``sim://koul-compliant?seed=3`` or ``serial:///dev/ttyACM0?baud=921600``."""

    scheme: str
    place: str
    options: Mapping[str, str]
    text: str

    @classmethod
    def parse(cls, text: str) -> DeviceUrl:
        """Split a URL; raises `ConfigError` when it has no scheme or an option twice."""
        try:
            parts = urlsplit(text)
        except ValueError as error:
            raise ConfigError(
                f"device URL {text!r}: {error}", remedy="write it like sim://koul-compliant"
            ) from None
        if "://" not in text or not parts.scheme:
            raise ConfigError(
                f"device URL {text!r} has no scheme",
                remedy="write it like sim://koul-compliant or serial:///dev/ttyACM0",
            )
        pairs = parse_qsl(parts.query, keep_blank_values=True)
        options = dict(pairs)
        if len(options) != len(pairs):
            raise ConfigError(f"device URL {text!r} names an option twice", remedy="keep one of them")
        return cls(parts.scheme, parts.netloc + parts.path, options, text)

    def allow(self, options: Iterable[str]) -> None:
        """Raise `ConfigError` when the URL has an option that is not among these."""
        for name in self.options:
            if name not in options:
                raise ConfigError(
                    f"{self.text}: unknown option {name!r}",
                    remedy=f"known options: {', '.join(options) or 'none'}",
                )

    def choice(self, name: str, allowed: Sequence[str], default: str) -> str:
        """Return an option that is one of a few words; raises `ConfigError` when it is another."""
        value = self.options.get(name, default)
        if name in self.options and value not in allowed:
            raise ConfigError(
                f"{self.text}: {name} = {value!r} is not allowed",
                remedy=f"give one of: {', '.join(allowed)}; or leave {name} out",
            )
        return value


class Link(Protocol):
    """Bytes to and from one far end.

    Every call is bounded in time. A link that is gone raises `rig.core.errors.LinkLostError`, never a bare
    OSError.
    """

    url: DeviceUrl
    clock: Clock
    bytes_per_second: float | None  # capacity each way, None when it is not a limit
    messages: Sequence[str]  # what could not be obtained, each with its remedy: for the user to read

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived, waiting at most `timeout_s` for the first byte; empty at the time-out."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of `data`."""
        ...

    def port(self) -> LoopPort:
        """Return the plug functions for the loop; Python must not read or write while the loop runs."""
        ...

    def failure(self) -> BaseException | None:
        """Return what went wrong inside the far end while the loop ran (simulation), or None."""
        ...

    def truth(self) -> NDArray[np.void] | None:
        """Return the simulation's truth by sample index (`rig.core.sample.TRUTH`), or None on a real device."""
        ...

    def close(self) -> None:
        """Release the port; may be called twice."""
        ...


class RealLink:
    """What all links to hardware have in common (mixin of a `Link`)."""

    def failure(self) -> BaseException | None:
        """Return None: a real far end reports no exception."""
        return None

    def truth(self) -> NDArray[np.void] | None:
        """Return None: nobody knows the true state of a real rig."""
        return None
