"""The console as a picture of the terminal's size: a rich renderable of the conversation and of the running loop."""

from __future__ import annotations

from functools import lru_cache
from io import StringIO

from rich.cells import cell_len
from rich.console import Console, RenderableType
from rich.layout import Layout
from rich.panel import Panel
from rich.style import Style
from rich.table import Table
from rich.text import Text

from rig.session.console import words
from rig.session.console.conversation import Conversation
from rig.session.console.live import Snapshot
from rig.session.desk import View

NARROW = 60  # below it facts have no live numbers beside them
BAR = 12
NAMES = 10  # columns of the names of facts and live numbers
FRAME = 4  # columns of a panel's edges; two lines
_RULER = Console(file=StringIO())  # measures: nothing is printed there


def picture(
    talk: Conversation, live: Snapshot | None, now_s: float, *, width: int, height: int, blocks: bool = True
) -> Layout:
    """All of it, for a terminal of this size; without `blocks` in ASCII alone.

    Nothing is cut off at an edge: what is too long for a line continues in the next one. What a low terminal has no
    room for is left out whole: the log first, then facts and live numbers, what to say, what the last trial came to.
    """
    title, keys, view = _title(talk, width), _keys(talk), talk.view
    top, ends = _sized(title, width), [_sized(keys, width)]
    room = height - (top.size or 0)
    if talk.help:
        return _stacked([top, Layout(_help(talk, width, room))])
    room -= ends[0].size or 0
    asked = Text(words.question(talk, now_s), style="bold")
    if (rows := min(_rows(asked.plain, width), room)) > 0:
        ends.insert(0, Layout(asked, size=rows))
        room -= rows
    last, say = Text(view.last, style=_style(view.last)), Text(view.say, style="bold")
    kept: dict[str, Layout] = {}
    for name, forms in (
        ("last", _framed(last, "last trial", width)),
        ("say", _framed(say, "say", width)),
        ("middle", [_middle(view, live, width, blocks)]),
    ):
        fitting = next((one for one in forms if (one.size or 0) <= room), None)
        if fitting is not None:
            kept[name] = fitting
            room -= fitting.size or 0
    parts = [kept[name] for name in ("say", "middle", "last") if name in kept]
    log = [Layout(_log(view, width, room))] if room > 0 else []
    return _stacked([top, *parts, *log, *ends])


@lru_cache(maxsize=256)
def _rows(text: str, width: int) -> int:
    """How many lines a text takes when nothing of it is cut off."""
    width = max(1, width)
    return sum(
        1 if cell_len(line) <= width else len(Text(line).wrap(_RULER, width)) for line in text.split("\n")
    )


def _sized(text: Text, width: int) -> Layout:
    return Layout(text, size=_rows(text.plain, width))


def _framed(text: Text, title: str, width: int) -> list[Layout]:
    """A text in a frame, and without one for where that has no room; nothing of no text."""
    if not text.plain:
        return []
    return [Layout(Panel(text, title=title), size=2 + _rows(text.plain, width - FRAME)), _sized(text, width)]


def _stacked(parts: list[Layout]) -> Layout:
    whole = Layout()
    whole.split_column(*parts)
    return whole


def _title(talk: Conversation, width: int) -> Text:
    left, state = words.place(talk.view), words.state(talk)
    gap = width - len(left) - len(state) - 2
    between = " " * gap if gap > 0 else "\n "
    text = Text(f" {left}{between}{state} ", style=Style(reverse=True))
    if talk.moving and talk.view.state != "starting":
        text.stylize("bold")
    return text


def _style(last: str) -> str:
    return "yellow" if ": invalid" in last else ""


def _middle(view: View, live: Snapshot | None, width: int, blocks: bool) -> Layout:
    facts, gauges = words.facts(view), words.gauges(view, live)
    left, bar = width if width < NARROW else 3 * width // 7, min(BAR, width // 8)
    values, texts = [value for _, value in facts], [gauge.text for gauge in gauges]
    rows = _column_rows(values, left - FRAME - NAMES - 2)
    now = Panel(_pairs(facts), title="now")
    if width < NARROW:
        return Layout(now, size=2 + rows)
    rows = max(rows, _column_rows(texts, width - left - FRAME - NAMES - bar - 2))
    middle = Layout(size=2 + rows)
    middle.split_row(
        Layout(now, size=left), Layout(Panel(_live(gauges, bar, blocks), title="live"), size=width - left)
    )
    return middle


def _column_rows(values: list[str], width: int) -> int:
    return sum(_rows(value, width) for value in values)


def _pairs(pairs: list[tuple[str, str]]) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True, style="dim", min_width=NAMES)
    table.add_column(overflow="fold")
    for name, value in pairs:
        table.add_row(name, Text(value))
    return table


def _live(gauges: list[words.Gauge], bar: int, blocks: bool) -> Table:
    table = Table.grid(padding=(0, 1))
    table.add_column(no_wrap=True, style="dim", min_width=NAMES)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for row in gauges:
        table.add_row(row.name, "" if row.share is None else _bar(row.share, bar, blocks), row.text)
    return table


def _bar(share: float, length: int, blocks: bool) -> Text:
    """A bar from nothing to all; what is above all is red."""
    full, empty = ("█", "░") if blocks else ("#", ".")
    cells = round(length * min(1.0, max(0.0, share)))
    colour = "red" if share >= words.NEAR else "yellow" if share >= words.HALF else "green"
    return Text(full * cells, style=colour).append(empty * (length - cells), style="dim")


def _log(view: View, width: int, height: int) -> RenderableType:
    """The newest lines, as many as there is room for."""
    shown: list[str] = []
    for line in reversed([one for one in view.lines if one != view.last]):  # that one stands above
        if _rows("\n".join([line, *shown]), width - FRAME) > height - 2:
            break
        shown.insert(0, line)
    return Panel(Text("\n".join(shown)), title="log") if shown else Text(" ")


def _keys(talk: Conversation) -> Text:
    """What may be pressed, and what the last key came to."""
    text = Text()
    line = words.entry(talk)
    if line:
        text.append(line, style="bold cyan")
    else:
        text.append(words.choices(talk))
    text.append("\n")
    text.append(talk.notice, style="red" if talk.notice == "STOP" else "yellow")
    text.append("\n")
    text.append(words.always(talk), style="dim")
    return text


def _help(talk: Conversation, width: int, height: int) -> Panel:
    """All keys, each in a line of its own where the terminal is high enough."""
    pairs = words.help_pairs(talk)
    names = max(NAMES, *(len(key) for key, _ in pairs))
    if _column_rows([meaning for _, meaning in pairs], width - FRAME - names - 2) + 2 <= height:
        return Panel(_pairs(pairs), title="keys")
    return Panel(Text("; ".join(f"{key} {meaning}" for key, meaning in pairs)), title="keys")
