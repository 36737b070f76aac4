"""The library behind the page's sockets, which comes with the extra ``console``."""

from rig.core.errors import ConfigError

try:
    from websockets.asyncio.server import ServerConnection, serve
    from websockets.datastructures import Headers
    from websockets.exceptions import ConnectionClosed
    from websockets.http11 import Request as HttpRequest
    from websockets.http11 import Response
except ImportError:
    raise ConfigError("websockets is not installed", remedy="pip install 'haptic-rig[console]'") from None

__all__ = ["ConnectionClosed", "Headers", "HttpRequest", "Response", "ServerConnection", "serve"]
