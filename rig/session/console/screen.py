"""The console as a picture of the terminal's size: a rich renderable of the conversation and of the running loop."""

from __future__ import annotations

from rich.layout import Layout
from rich.panel import Panel
from rich.style import Style
from rich.table import Table
from rich.text import Text

from rig.session.console import words
from rig.session.console.conversation import Conversation
from rig.session.console.live import Snapshot
from rig.session.desk import View

NARROW, LOW = 60, 18  # below these the picture leaves out what is not needed to continue
BAR = 12
COLOURS = {"stable": "green", "buzz": "yellow", "unstable": "red", "unsure": "magenta"}


def picture(
    talk: Conversation, live: Snapshot | None, now_s: float, *, width: int, height: int, blocks: bool = True
) -> Layout:
    """All of it, for a terminal of this size; without `blocks` in ASCII alone."""
    parts = [Layout(_title(talk, width), size=1)]
    if talk.help:
        parts.append(Layout(Panel(_help(talk), title="keys")))
        return _stacked(parts)
    parts.append(
        Layout(Panel(Text(talk.view.say, style="bold"), title="say"), size=4 if height >= LOW else 3)
    )
    if height >= LOW:
        parts.append(_middle(talk.view, live, width, blocks))
        parts.append(Layout(Panel(_log(talk.view, height), title="log"), minimum_size=3))
    bottom = _bottom(talk, now_s)
    lines = sum(1 + max(0, len(line) - 1) // max(1, width) for line in bottom.plain.split("\n"))
    parts.append(Layout(bottom, size=min(lines, height // 2)))
    return _stacked(parts)


def _stacked(parts: list[Layout]) -> Layout:
    whole = Layout()
    whole.split_column(*parts)
    return whole


def _title(talk: Conversation, width: int) -> Text:
    left, state = words.place(talk.view), words.state(talk)
    gap = max(1, width - len(left) - len(state) - 2)
    text = Text(f" {left}{' ' * gap}{state} ", style=Style(reverse=True), no_wrap=True, overflow="ellipsis")
    if talk.moving and talk.view.state != "starting":
        text.stylize("bold")
    return text


def _middle(view: View, live: Snapshot | None, width: int, blocks: bool) -> Layout:
    middle = Layout(size=9)
    now = Panel(_pairs(words.facts(view)), title="now")
    if width < NARROW:
        return Layout(now, size=9)
    middle.split_row(Layout(now, ratio=3), Layout(Panel(_live(view, live, blocks), title="live"), ratio=4))
    return middle


def _pairs(pairs: list[tuple[str, str]]) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True, style="dim", min_width=max(len(name) for name, _ in pairs))
    table.add_column(no_wrap=True, overflow="ellipsis")
    for name, value in pairs:
        table.add_row(name, Text(value, style=COLOURS.get(value.split(",")[0], "")))
    return table


def _live(view: View, live: Snapshot | None, blocks: bool) -> Table:
    table = Table.grid(padding=(0, 1))
    table.add_column(no_wrap=True, style="dim")
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True, overflow="ellipsis")
    for row in words.gauges(view, live):
        table.add_row(row.name, "" if row.share is None else _bar(row.share, blocks), row.text)
    return table


def _bar(share: float, blocks: bool) -> Text:
    """A bar from nothing to all; what is above all is red."""
    full, empty = ("█", "░") if blocks else ("#", ".")
    cells = round(BAR * min(1.0, max(0.0, share)))
    colour = "red" if share >= words.NEAR else "yellow" if share >= words.HALF else "green"
    return Text(full * cells, style=colour).append(empty * (BAR - cells), style="dim")


def _log(view: View, height: int) -> Text:
    lines = view.lines[-max(1, height - 20) :]
    return Text("\n".join(lines), no_wrap=True, overflow="ellipsis")


def _bottom(talk: Conversation, now_s: float) -> Text:
    text = Text(words.question(talk, now_s), style="bold")
    text.append("\n")
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


def _help(talk: Conversation) -> Table:
    return _pairs(words.help_pairs(talk.keymap))
