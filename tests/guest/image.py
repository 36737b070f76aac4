"""A disk for the guest: files of this machine at their own paths, in a file system that the guest's kernel supports."""

import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path

TOOL = "/sbin/mke2fs"
BLOCK_BYTES = 4096
SPARE = 1.1  # of what the file system keeps for itself
LARGE_BYTES = 8e6  # is read in large pieces, for which 9p does as well


def make(image: Path, files: Iterable[Path]) -> None:
    """Write an ext4 file system with these files and their times, without the large ones."""
    blocks = 0
    with tempfile.TemporaryDirectory(prefix="disk-") as place:
        for file in files:
            if file.stat().st_size > LARGE_BYTES:
                continue
            copy = Path(place, file.relative_to("/"))
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(file, copy)
            blocks += copy.stat().st_size // BLOCK_BYTES + 2
        options = ("-t", "ext4", "-O", "^has_journal", "-b", str(BLOCK_BYTES), "-d", place)
        command = [TOOL, *options, str(image), str(int(blocks * SPARE))]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
