"""Short form of a result: a few lines at a prompt, tables in a notebook.

Commands and pages show all that a result offers (`rig.core.present`); this is its short form.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from rig.core.check import Check
from rig.core.present import Item, Row, Table

LINES, WIDTH = 10, 200  # at a prompt


class Shown:
    """A result with a short form; a dataclass that is one has ``repr=False``, which would come before this one."""

    __slots__ = ()

    def brief(self) -> Sequence[Item]:
        """Return the most important results in `LINES` lines: a heading and rows."""
        raise NotImplementedError

    def detailed(self) -> Sequence[Item]:
        """Return the items that a notebook shows; the same as `brief` unless overridden."""
        return self.brief()

    def __repr__(self) -> str:
        items = self.brief()
        width = max((len(item.label) for item in items if isinstance(item, Row)), default=0)
        lines = [
            f"  {item.label:<{width}}  {item.text}" if isinstance(item, Row) else str(item) for item in items
        ]
        kept = lines if len(lines) <= LINES else [*lines[: LINES - 1], "  …"]
        return "\n".join(line if len(line) <= WIDTH else f"{line[: WIDTH - 1]}…" for line in kept)

    def _repr_html_(self) -> str:
        return "".join(_html(self.detailed()))


def _html(items: Sequence[Item]) -> list[str]:
    parts, rows = [], []
    for item in [*items, ""]:
        if isinstance(item, Row):
            rows.append(f"<tr><th>{escape(item.label)}</th><td>{escape(item.text)}</td></tr>")
            continue
        if rows:
            parts.append(f"<table>{''.join(rows)}</table>")
            rows = []
        if isinstance(item, Table):
            parts.append(_table(item))
        elif isinstance(item, Check):
            parts.append(f"<p>{escape(f'{item.outcome.value}: {item.name}: {item.text}')}</p>")
        elif item:
            parts.append(f"<p><b>{escape(item)}</b></p>")
    return parts


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in table.head)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in line)}</tr>" for line in table.cells)
    caption = f"<caption>{escape(table.caption)}</caption>" if table.caption else ""
    return f"<table>{caption}<tr>{head}</tr>{body}</table>"
