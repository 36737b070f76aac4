"""Guides in Markdown: their examples, and the sections between two comments that a program writes from a table."""

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
_EXAMPLE = re.compile(r"```python\n(.*?)```", re.DOTALL)
_BLOCK = re.compile(r"(?:<!-- (not run|file|command): (.*?) -->\n)?```(sh|python|toml)\n(.*?)```", re.DOTALL)
_PAGE = re.compile(r"<!-- none is run: (.*?) -->")
_SECTION = re.compile(r"<!-- generated: (\w+) -->\n.*?<!-- end -->", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Block:
    """A code block of a page; a comment before it can name the reason why it is not run, or its file."""

    language: str
    text: str
    reason: str = ""  # why it is not run
    file: str = ""

    def commands(self) -> list[str]:
        return [line for line in self.text.splitlines() if line.strip()] if self.language == "sh" else []


def blocks(page: Path) -> list[Block]:
    """Return the blocks of a page in order; ``<!-- none is run: … -->`` gives the reason for all of its commands."""
    text = page.read_text(encoding="utf-8")
    for_all = _PAGE.search(text)
    found = []
    for mark, note, language, code in _BLOCK.findall(text):
        reason = {"not run": note, "command": f".ci/run runs it: {note}"}.get(mark, "")
        if language == "sh" and for_all is not None:
            reason = for_all[1]
        found.append(Block(language, code, reason, note if mark == "file" else ""))
    return found


def examples(guide: Path) -> list[str]:
    return _EXAMPLE.findall(guide.read_text(encoding="utf-8"))


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def render(text: str, sections: Mapping[str, Callable[[], str]]) -> str:
    """Return the guide with every generated section renewed; raise KeyError for an unknown section."""
    return _SECTION.sub(
        lambda match: f"<!-- generated: {match[1]} -->\n{sections[match[1]]()}\n<!-- end -->", text
    )


def publish(guide: Path, sections: Mapping[str, Callable[[], str]], command: str, *, check: bool) -> int:
    """Write the guide anew, or with `check` only report if it is outdated; return the exit status."""
    old = guide.read_text(encoding="utf-8")
    new = render(old, sections)
    if not check:
        guide.write_text(new, encoding="utf-8")
        return 0
    if new != old:
        print(f"{guide.name} is stale: run {command} --guide", file=sys.stderr)
    return int(new != old)
