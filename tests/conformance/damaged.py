"""A file in which one byte after another is changed."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path


def each_damaged(path: Path, places: Iterable[int], flips: Iterable[int]) -> Iterator[int]:
    """Change the bits `flips` of the byte at each place in turn, yield the place, and restore the byte."""
    whole = path.read_bytes()
    with path.open("r+b", buffering=0) as file:  # to truncate and write it each time takes some ms
        for place, flip in zip(places, flips, strict=False):
            os.pwrite(file.fileno(), bytes([whole[place] ^ flip]), place)
            yield place
            os.pwrite(file.fileno(), whole[place : place + 1], place)
