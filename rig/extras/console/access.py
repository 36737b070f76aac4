"""Check that a request may open the page, and limit what a browser may load with the page.

The server calls `Access` for every request. A participant's screen has a token of its own, which opens only that
screen.
"""

import hmac
import secrets
from collections.abc import Iterable
from urllib.parse import parse_qs

from rig.extras.console.sockets import Headers, HttpRequest

SOCKETS = ("/live", "/hold", "/participant")
SUBPROTOCOL = "rig"
SHOWN = "token."  # prefix of the subprotocol that contains the token
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
    """Checks of host name, origin and token for the page that is served on `port`.

    `hosts` are further names, NAME:PORT, under which a browser may reach the page, such as the local end of a tunnel.
    `url` contains the page's token, `participants` is the token of participants' screens.
    """

    def __init__(self, port: int, hosts: Iterable[str] = ()) -> None:
        # On loopback too: any page of any site can open a socket to it, and any user of this computer.
        self._token, self.participants = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        self._hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost")} | set(hosts)
        # In the fragment, which no browser sends to a server or in a Referer.
        self.url = f"http://127.0.0.1:{port}/#{self._token}"

    def host_allowed(self, headers: Headers) -> bool:
        """Return True if the request has exactly one Host header, and its value is an allowed name of this server."""
        # The Host as well as the Origin: a foreign DNS name that points at this computer (DNS rebinding) makes the two
        # agree.
        return _only(headers, "Host") in self._hosts

    def origin_allowed(self, headers: Headers) -> bool:
        """Return True if the Origin header names this server, so that its page opened the socket; else False."""
        origin = _only(headers, "Origin")
        return origin.removeprefix("http://") in self._hosts and origin.startswith("http://")

    def token_right(self, token: object) -> bool:
        """Return True if `token` is the page's token."""
        return _same(token, self._token)

    def participants_right(self, token: object) -> bool:
        """Return True if `token` is the token of participants' screens."""
        return _same(token, self.participants)

    def bearer_right(self, headers: Headers) -> bool:
        """Return True if the Authorization header of a download contains the page's token."""
        kind, _, token = _only(headers, "Authorization").partition(" ")
        return kind == "Bearer" and self.token_right(token)

    def guest(self, request: HttpRequest) -> str | None:
        """Return the name that a page chose for itself in its socket request; None if token or name are not valid."""
        path, _, query = request.path.partition("?")
        # The second subprotocol: the only header that a page can add to the opening of a socket.
        token = _only(request.headers, "Sec-WebSocket-Protocol").partition(SHOWN)[2]
        pages, participants = self.token_right(token), self.participants_right(token)
        right = {"/live": pages, "/participant": participants, "/hold": pages or participants}[path]
        name = parse_qs(query).get("client", [""])[0]
        return name if right and 8 <= len(name) <= 64 else None


def _only(headers: Headers, name: str) -> str:
    values = headers.get_all(name)
    return values[0] if len(values) == 1 else ""


def _same(presented: object, token: str) -> bool:
    # In constant time, so that the duration does not reveal how many characters are right.
    return isinstance(presented, str) and hmac.compare_digest(
        presented.encode(errors="replace"), token.encode()
    )
