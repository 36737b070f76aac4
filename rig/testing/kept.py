"""Keep or remove the recordings of a test: keep them if it failed, always, or never.

The plug-in uses it. It must not remove recordings of other tests.
"""

import re
import shutil
from contextlib import suppress
from pathlib import Path

DIRECTORY = "rig-recordings"  # below the root of the tests
LONGEST_NAME = 200  # file systems take 255 bytes


class Kept:
    """Directory of the recordings of one test.

    Recordings are written directly to their final directory, so the recordings of a killed test remain there, too.

    Parameters
    ----------
    root, test
        Directory of all tests, and the pytest node id of this test. Recordings of an earlier run are replaced.
    mode
        Which recordings are kept: ``failed``, ``all`` or ``none``.

    Attributes
    ----------
    place
        Directory of this test's recordings.
    """

    def __init__(self, root: Path, test: str, mode: str) -> None:
        self.place = root / DIRECTORY / re.sub(r"[^\w.=-]+", "_", test).strip("_")[-LONGEST_NAME:]
        self._mode = mode
        # Remains so if a person stops the test, because pytest then reports no end of it.
        self._wanted = mode != "none"
        shutil.rmtree(self.place, ignore_errors=True)

    def ended(self, *, failed: bool) -> bool:
        """Decide by the outcome of the test whether to keep its recordings; return True if there are any to keep."""
        self._wanted = self._mode == "all" or (self._mode == "failed" and failed)
        return self._wanted and self.place.is_dir()

    def close(self) -> None:
        """Remove the test's recordings unless they must be kept."""
        if not self._wanted:
            shutil.rmtree(self.place, ignore_errors=True)


def tidy(root: Path) -> None:
    """Remove the directory with the recordings of all tests if it is empty."""
    with suppress(OSError):
        (root / DIRECTORY).rmdir()
