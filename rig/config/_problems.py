"""Describe problems of an experiment, and join them into one error with a line for each problem.

All checks of files report their problems by it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from rig.core.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Problem:
    """A problem of one key in a file: the key with its value, the requirement that it violates, and what to do."""

    key: str
    value: str  # as `rig.config._table.shown` writes it; empty when the key has no value
    must: str  # continues the sentence: "must be …", "is missing", "is not a known key"
    remedy: str

    def text(self, source: str) -> str:
        """Return the problem in one line: source (name of the file), key with value, and the violated requirement."""
        subject = f"{self.key} = {self.value}" if self.value else self.key
        return f"{source}: {subject}: {self.must}"


def config_error(problems: Sequence[Problem], source: str) -> ConfigError:
    """Return one `ConfigError` with a line for each problem: file, key, value, requirement and remedy."""
    if len(problems) == 1:
        return ConfigError(problems[0].text(source), remedy=problems[0].remedy)
    return ConfigError("\n".join(f"{p.text(source)}; {p.remedy}" for p in problems))


def did_you_mean(name: str, known: Iterable[str], otherwise: str) -> str:
    """Return the question "did you mean …?" with the known name closest to `name`; `otherwise` if no name is close."""
    close = get_close_matches(name, list(known), n=1, cutoff=0.6)
    return f"did you mean {close[0]}?" if close else otherwise
