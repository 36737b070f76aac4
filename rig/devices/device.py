"""Interface of a link: a stream of bytes to a device, for Python and for the compiled loop.

A backend is one function ``open_link(url, model) -> Link``, which `rig.devices` finds by the scheme of the URL. The
link carries only frames of `firmware_protocol`. So the same code runs above it for a board, a simulated device in
another process and the simulation in this process.

Backends inherit from its classes; the loop, `rig.doctor`, `rig.experiments`, `rig.firmware`, sessions and drives use
it. It must not import a backend.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol
from urllib.parse import quote, unquote

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages
from firmware_protocol.packing import encoded_bytes
from rig.core.errors import ConfigError
from rig.devices._failures import failure
from rig.devices.port import LoopPort
from rig.realtime.clock import Clock

__all__ = [
    "LINK_SHARE",
    "STATE_BYTES",
    "DeviceUrl",
    "Link",
    "RealLink",
    "failure",
]

STATE_BYTES = encoded_bytes(messages.State)  # the larger frame of the host's loop, encoded
LINK_SHARE = 0.7  # share of a link's capacity for the loop; replies and retries need the remainder


_SCHEME = re.compile(r"[a-z][a-z0-9+.-]*")
_NO_ESCAPE = re.compile(r"%(?![0-9A-Fa-f]{2})|%00")


@dataclass(frozen=True, slots=True)
class DeviceUrl:
    """URL of a device, ``scheme://place?key=value``, such as ``serial:///dev/ttyACM0?baud=921600``.

    The place is a port, device, path or preset; place and values may contain any bytes. In `text`, ``%XX`` is a byte,
    ``?`` begins the options, and ``&`` and ``=`` separate them; every other character means itself, ``#`` and ``+``
    too. `place` and `options` contain no ``%XX``.
    """

    scheme: str
    place: str
    options: Mapping[str, str]
    text: str

    @classmethod
    def of(cls, scheme: str, place: str, options: Mapping[str, str] | None = None) -> DeviceUrl:
        """Return the URL of a place (port, path, preset) and options, with escapes that `parse` converts back."""
        options = options or {}
        query = "&".join(f"{_encode(name)}={_encode(value)}" for name, value in options.items())
        return cls(scheme, place, options, f"{scheme}://{_encode(place)}{'?' if query else ''}{query}")

    @classmethod
    def parse(cls, text: str) -> DeviceUrl:
        """Split a device URL into scheme, place (port, path or preset) and options.

        Raise `ConfigError` for a missing scheme, a repeated option, or an invalid character.
        """
        scheme, separator, rest = text.partition("://")
        if not separator or not _SCHEME.fullmatch(scheme):
            raise ConfigError(
                f"device URL {text!r} has no scheme in small letters",
                remedy="write it like sim://koul-compliant or serial:///dev/ttyACM0",
            )
        if not text.isprintable():
            hidden = next(character for character in text if not character.isprintable())
            raise ConfigError(
                f"device URL {text!r} contains the invisible character {hidden!r}",
                remedy="leave it out, or write each of its bytes as % and two hexadecimal digits (%0A: line feed)",
            )
        if wrong := _NO_ESCAPE.search(rest):
            raise ConfigError(
                f"device URL {text!r} contains {rest[wrong.start() :][:3]!r}, which is not an escape for a byte",
                remedy="write %25 for the sign % itself, or % and two hexadecimal digits, not 00, for a byte",
            )
        # Not by `urllib`, which would drop what follows a #, and line ends.
        place, mark, query = rest.partition("?")
        options: dict[str, str] = {}
        for part in query.split("&") if mark else ():
            name, _, value = map(_decode, part.partition("="))
            if not name or name in options:
                fault = f"names the option {name!r} twice" if name else "has an option without a name"
                raise ConfigError(
                    f"device URL {text!r} {fault}",
                    remedy="give each option once, like ?seed=3&offset=0.25; write %3F for a ? in a name",
                )
            options[name] = value
        return cls(scheme, _decode(place), options, text)

    def allow(self, options: Iterable[str]) -> None:
        """Raise `ConfigError` if this device URL has an option that is not in `options`."""
        for name in self.options:
            if name not in options:
                raise ConfigError(
                    f"{self.text}: unknown option {name!r}",
                    remedy=f"known options: {', '.join(options) or 'none'}",
                )

    def choice(self, name: str, allowed: Sequence[str], default: str) -> str:
        """Return the value of a URL option, or `default`; raise `ConfigError` if the value is not in `allowed`."""
        value = self.options.get(name, default)
        if name in self.options and value not in allowed:
            raise ConfigError(
                f"{self.text}: the option {name} = {value!r} is not allowed",
                remedy=f"give one of: {', '.join(allowed)}; or leave {name} out",
            )
        return value


def _encode(part: str) -> str:
    # A path may have bytes that are not UTF-8.
    return quote(part, safe="/:@+,", errors="surrogateescape")


def _decode(part: str) -> str:
    return unquote(part, errors="surrogateescape")


class Link(Protocol):
    """Stream of bytes to and from one device.

    Every call is bounded in time. A lost link raises `rig.core.errors.LinkLostError`, never a bare OSError.
    """

    url: DeviceUrl
    clock: Clock
    bytes_per_second: float | None  # capacity each way, None when it is not a limit
    messages: Sequence[str]  # settings that could not be made, each with its remedy, for the user

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that the device has sent; wait at most `timeout_s` (s) for the first; may be empty."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of `data` to the device; raise `LinkLostError` if the device is gone or accepts no bytes."""
        ...

    def port(self) -> LoopPort:
        """Return the functions with which the loop reads, writes and waits; Python must not use the link meanwhile."""
        ...

    def failure(self) -> BaseException | None:
        """Return the exception that a simulated device raised while the loop ran; None without one."""
        ...

    def truth(self) -> NDArray[np.void] | None:
        """Return the simulation's exact positions, velocities and efforts (`rig.core.sample.TRUTH`), else None."""
        ...

    def close(self) -> None:
        """Release the device's port or interface; a second call does nothing."""
        ...


class RealLink:
    """Mixin for a `Link` to a device outside of this process, whose Python exceptions and exact signals are unknown."""

    def failure(self) -> BaseException | None:
        """Return None: a device outside of this process reports no Python exception."""
        return None

    def truth(self) -> NDArray[np.void] | None:
        """Return None: the exact positions and efforts of a device outside of this process are unknown."""
        return None
