"""One spelling of a name, made where it enters, so that everything behind compares plain strings; and its directory.

Names enter with a protocol (`rig.session.planning._load`), on a command line, and from logs of earlier versions.
"""

from __future__ import annotations

import hashlib
import unicodedata
from collections.abc import Callable, Iterable
from itertools import groupby

from rig.core.errors import ConfigError

LONGEST_DIRECTORY = 200  # bytes in UTF-8; file systems take 255
_HASH_DIGITS = 8


def normalise(name: str) -> str:
    """Return a name in Unicode's composed form (NFC), white space at its ends removed and elsewhere one space."""
    return " ".join(unicodedata.normalize("NFC", name).split())


def directory_name(title: str) -> str:
    """Return the directory of a study's title: letters, digits and marks of any script, all else a hyphen.

    A hash of the title is added where a character outside ASCII was left out, or the end of a long title, so that other
    titles have other directories. A title in ASCII never had one: such titles may share a directory.
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
    """Return the name of each code's file or directory; `ConfigError` for codes that share one but for capitals."""
    names = {code: name_of(code) for code in codes}
    sharing: dict[str, list[str]] = {}
    for code in sorted(names):
        sharing.setdefault(names[code].casefold(), []).append(code)
    if shared := [", ".join(alike) for alike in sharing.values() if len(alike) > 1]:
        raise ConfigError(
            f"these codes get the same name in the export, where case does not matter: {'; '.join(shared)}",
            remedy=f"{allowed}; export these participants one by one",
        )
    return names


def _is_kept(character: str) -> bool:
    return unicodedata.category(character)[0] in "LMN"
