"""Import of the library `websockets`, which is installed with the extra ``console``."""

import logging

from rig.core.errors import ConfigError

try:
    from websockets.asyncio.server import ServerConnection, serve
    from websockets.datastructures import Headers
    from websockets.exceptions import ConnectionClosed
    from websockets.http11 import Request as HttpRequest
    from websockets.http11 import Response
    from websockets.typing import Subprotocol
except ImportError:
    raise ConfigError("websockets is not installed", remedy="pip install 'haptic-rig[console]'") from None

# Up to version 15 the library prints a traceback for each connection that is no page's, as often as one comes.
LOGGER = logging.getLogger(__name__)
LOGGER.addFilter(lambda record: record.msg != "opening handshake failed")

__all__ = [
    "LOGGER",
    "ConnectionClosed",
    "Headers",
    "HttpRequest",
    "Response",
    "ServerConnection",
    "Subprotocol",
    "serve",
]
