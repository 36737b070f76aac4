"""Guides in Markdown: their examples, and the sections that a program writes, between two comments, from a table."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
_EXAMPLE = re.compile(r"```python\n(.*?)```", re.DOTALL)
_SECTION = re.compile(r"<!-- generated: (\w+) -->\n.*?<!-- end -->", re.DOTALL)


def examples(guide: Path) -> list[str]:
    """The examples of a guide in Python."""
    return _EXAMPLE.findall(guide.read_text(encoding="utf-8"))


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def render(text: str, sections: Mapping[str, Callable[[], str]]) -> str:
    """Return the guide with every section between markers made anew; raises KeyError for an unknown section."""
    return _SECTION.sub(
        lambda match: f"<!-- generated: {match[1]} -->\n{sections[match[1]]()}\n<!-- end -->", text
    )


def publish(guide: Path, sections: Mapping[str, Callable[[], str]], command: str, *, check: bool) -> int:
    """Write the guide anew, or with `check` only say if it is stale; returns the exit status."""
    old = guide.read_text(encoding="utf-8")
    new = render(old, sections)
    if not check:
        guide.write_text(new, encoding="utf-8")
        return 0
    if new != old:
        print(f"{guide.name} is stale: run {command} --guide", file=sys.stderr)
    return int(new != old)
