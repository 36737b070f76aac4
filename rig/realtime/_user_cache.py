"""Find the directory of a user's caches; it imports only what Python loads at its start, so `rig stop` is fast.

Kernel cache and shared memories use it. It must not create the directory.
"""

import os
import sys


def user_cache() -> str:
    """Return the directory of this user's caches, which may not exist yet.

    ``%LOCALAPPDATA%`` on Windows, ``~/Library/Caches`` on macOS, else ``$XDG_CACHE_HOME`` or ``~/.cache``.
    """
    home = os.path.expanduser("~")
    if sys.platform == "win32":
        return os.environ.get("LOCALAPPDATA") or os.path.join(home, "AppData", "Local")
    elif sys.platform == "darwin":
        return os.path.join(home, "Library", "Caches")
    else:
        return os.environ.get("XDG_CACHE_HOME") or os.path.join(home, ".cache")
