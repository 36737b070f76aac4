"""The commands of ``rig`` as click defines them: all of them, or the one that a command line calls."""

from collections.abc import Iterator, Sequence

import click

import rig.cli

Words = tuple[str, ...]


def commands(group: click.Command = rig.cli.rig, above: Words = ()) -> Iterator[tuple[Words, click.Command]]:
    """Yield each command with the words that call it."""
    if not isinstance(group, click.Group):
        yield above, group
        return
    context = click.Context(group)
    for name in group.list_commands(context):
        one = group.get_command(context, name)
        assert one is not None
        yield from commands(one, (*above, name))


def resolve(words: Sequence[str]) -> tuple[click.Context, Words]:
    """Return the context of the command that a line without ``rig`` calls, and the words after its name."""
    context = click.Context(rig.cli.rig, info_name="rig")
    while words and isinstance(context.command, click.Group) and not words[0].startswith("-"):
        name, *words = words
        found = context.command.get_command(context, name)
        assert found is not None, f"no command {name!r} in {context.command_path}"
        context = click.Context(found, info_name=name, parent=context)
    return context, tuple(words)


def parse_line(words: Sequence[str]) -> None:
    """Parse a line; raise for an unknown command or option. Values are not converted."""
    context, rest = resolve(words)
    context.command.make_parser(context).parse_args(list(rest))
