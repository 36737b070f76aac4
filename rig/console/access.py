"""Who may open the page, and what a browser may load with it.

A token is required on loopback too: any page of any site can open a socket to it, and any user of this computer. It
stands in the fragment of the URL, which browsers send to nobody, and comes back as the first message of a socket, or as
the bearer token of a download. The Host is checked beside the Origin: a name that somebody else's DNS points at this
computer makes the two agree. A participant's screen has a token of its own, which opens nothing but that screen.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Iterable, Mapping

HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob:; style-src 'self'; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'; object-src 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class Access:
    """The door.

    Parameters
    ----------
    port
        On which the page is served.
    hosts
        Further names, NAME:PORT, under which a browser may reach it: the local end of a tunnel.

    Attributes
    ----------
    url
        Of the page, with its token.
    participants
        Token of participants' screens.
    """

    def __init__(self, port: int, hosts: Iterable[str] = ()) -> None:
        self._token, self.participants = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        self._hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost")} | set(hosts)
        self.url = f"http://127.0.0.1:{port}/#{self._token}"

    def host_allowed(self, headers: Mapping[str, str]) -> bool:
        """Whether a request was meant for this page."""
        return headers.get("Host", "") in self._hosts

    def origin_allowed(self, headers: Mapping[str, str]) -> bool:
        """Whether a socket is opened by this page: a browser always says its origin, what is none may not."""
        origin = headers.get("Origin", "")
        return origin.removeprefix("http://") in self._hosts and origin.startswith("http://")

    def token_right(self, token: object) -> bool:
        """Whether this is the token, in a time that says nothing of how much of it is right."""
        return _same(token, self._token)

    def participants_right(self, token: object) -> bool:
        """Whether this is the token of a participant's screen, likewise."""
        return _same(token, self.participants)

    def bearer_right(self, headers: Mapping[str, str]) -> bool:
        """Whether a download shows the token."""
        kind, _, token = headers.get("Authorization", "").partition(" ")
        return kind == "Bearer" and self.token_right(token)


def _same(said: object, token: str) -> bool:
    return isinstance(said, str) and hmac.compare_digest(said.encode(errors="replace"), token.encode())
