"""Normalise names when they are read, so that other code can compare strings; and derive directory names.

Names are read from protocols (`rig.session.planning._load`), from command lines, and from logs of earlier versions. Do
not change the rules: directories of existing studies are found by these names.
"""

import hashlib
import unicodedata
from collections.abc import Callable, Iterable
from itertools import groupby

from rig.core.errors import ConfigError

# Bytes in UTF-8; file systems allow 255.
LONGEST_DIRECTORY = 200
_HASH_DIGITS = 8


def normalise(name: str) -> str:
    """Return a name in Unicode's composed form (NFC), without outer white space, and with single spaces inside."""
    return " ".join(unicodedata.normalize("NFC", name).split())


def directory_name(title: str) -> str:
    """Return the directory name for a study's title: letters, digits and marks of any script, hyphens for the rest.

    If a non-ASCII character or the end of a long title is omitted, a hash of the title is added, so that different
    titles get different directories. Titles in ASCII get no hash and may share a directory.
    """
    title = normalise(title)
    lower = unicodedata.normalize("NFC", title.lower())
    name = "-".join("".join(run) for kept, run in groupby(lower, _is_kept) if kept)
    is_short = len(name.encode()) <= LONGEST_DIRECTORY
    if is_short and all(one.isascii() or _is_kept(one) for one in lower):
        return name or "study"
    digest = hashlib.sha256(title.encode(errors="surrogatepass")).hexdigest()[:_HASH_DIGITS]
    short = name.encode()[: LONGEST_DIRECTORY - _HASH_DIGITS - 1].decode(errors="ignore").strip("-")
    return f"{short or 'study'}-{digest}"


def distinct_names(codes: Iterable[str], name_of: Callable[[str], str], allowed: str) -> dict[str, str]:
    """Return the file or directory name (`name_of`) of each code; raise `ConfigError` if two names are equal."""
    names = {code: name_of(code) for code in codes}
    sharing: dict[str, list[str]] = {}
    for code in sorted(names):
        sharing.setdefault(names[code].casefold(), []).append(code)
    if shared := [", ".join(alike) for alike in sharing.values() if len(alike) > 1]:
        raise ConfigError(
            f"these codes of participants get the same name in the export, which ignores case: {'; '.join(shared)}",
            remedy=f"{allowed}; export these participants one by one",
        )
    return names


def _is_kept(character: str) -> bool:
    return unicodedata.category(character)[0] in "LMN"
