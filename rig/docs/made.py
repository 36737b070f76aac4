"""The pages of the site that no one types: made from the tables that run, and taken from beside the code.

`make_pages` works on a copy of this directory. A page of it says ``<!-- from the tables: NAME -->`` where one of
`PARTS` belongs. Links in Markdown name files, so that they work in the tree as well; those to files that are pages here
become links to pages, and those to code lose their link.
"""

from __future__ import annotations

import dataclasses
import inspect
import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import click

import firmware_protocol
import rig
import rig.testing
from firmware_protocol.faults import Described, DescribedFlag, Fault, Input, LimitFlag, Status
from firmware_protocol.fmea import SingleFault, single_faults
from rig import cli
from rig.cli.command import RESULT, Option
from rig.cli.completion_table import command_rows
from rig.config import ConfigKey, parameters, parameters_of, presets, shown
from rig.control import estimators
from rig.core import errors
from rig.core.lazy import public_names
from rig.core.sample import COLUMNS, TRUTH_COLUMNS, UNITS, Phase, RowFlag
from rig.session.protocols import Protocol
from rig.views.site import SOURCES

RIG, PROTOCOL = Path(rig.__file__).parent, Path(firmware_protocol.__file__).parent
FIRMWARE = PROTOCOL / "firmware"
EXTRAS = RIG / "extras"
# Pages whose text stands beside the code that it is about.
TAKEN = {
    "reference/protocol.md": PROTOCOL / "PROTOCOL.md",
    "reference/estimators.md": RIG / "control" / "estimators" / "README.md",
    "reference/searches.md": RIG / "session" / "search" / "README.md",
    "how-to/power-on.md": FIRMWARE / "BENCH.md",
    "how-to/hardware.md": FIRMWARE / "HARDWARE.md",
    "how-to/board.md": FIRMWARE / "PORTING.md",
    "how-to/pico.md": FIRMWARE / "boards" / "rp2040" / "PICO.md",
    "how-to/sessions.md": RIG / "session" / "README.md",
    "how-to/first-participant.md": RIG / "session" / "FIRST-PARTICIPANT.md",
    "explanation/single-faults.md": FIRMWARE / "FMEA.md",
    "explanation/design.md": RIG / "DESIGN.md",
    **{f"how-to/{page.stem.lower()}.md": page for page in sorted(EXTRAS.glob("*/*.md"))},
}
_PART = re.compile(r"<!-- from the tables: (\w+) -->")
_LINK = re.compile(r"(!?)\[([^\]\n]*(?:\n[^\]\n]*)?)\]\(([^)\s]+)\)")
_COMMENT = re.compile(r"<!--.*?-->\n?", re.DOTALL)
_FENCE = re.compile(r"(^(?:```|~~~)[^\n]*\n.*?^(?:```|~~~)$)", re.DOTALL | re.MULTILINE)
_PICTURES = {".svg", ".png"}
_BELOW = "\n```{toctree}\n:hidden:\n:glob:\n\n*\n```\n"  # of an index that reads well in the tree as it is

Rows = Iterable[Sequence[object]]


def make_pages(place: Path) -> None:
    """Write every page that is made, and finish those that are not, in a copy of this directory.

    Raises ValueError for a link that leads to no file, and KeyError for a part that does not exist.
    """
    origins = {page.relative_to(SOURCES): page for page in sorted(SOURCES.rglob("*.md"))}
    origins |= {Path(page): source for page, source in TAKEN.items()}
    texts = {page: origin.read_text(encoding="utf-8") for page, origin in origins.items()}
    pages = {origin.resolve(): page for page, origin in origins.items()}
    for page, text in texts.items():
        whole = text + _BELOW if page.name == "index.md" and "{toctree}" not in text else text
        linked = _linked(whole, page, origins[page], pages, place)
        _write(place / page, _COMMENT.sub("", _PART.sub(lambda match: PARTS[match[1]](), linked)))
    for page, text in {**commands(), **faults()}.items():
        _write(place / page, text)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def _linked(text: str, page: Path, origin: Path, pages: Mapping[Path, Path], place: Path) -> str:
    """A page's text with the links of the tree turned into those of the site, outside of what is code."""

    def link(match: re.Match[str]) -> str:
        image, words, target = match.groups()
        name, hash_, anchor = target.partition("#")
        # Links to other sites, within this page and to a generated page have no file here.
        if "://" in target or not name or name.endswith(".rst"):
            return match[0]
        file = (origin.parent / name).resolve()
        if file in pages:
            if words.strip("`").endswith(".md"):
                raise ValueError(f"{origin}: the link to {target} is called {words}; name it after its topic")
            return f"[{words}]({os.path.relpath(pages[file], page.parent)}{hash_}{anchor})"
        if not file.exists() and file.is_relative_to(EXTRAS):  # the page of an extra that is not installed
            return words
        if not file.exists():
            raise ValueError(f"{origin}: the target {target} of a link does not exist")
        if image and file.suffix in _PICTURES:
            shutil.copyfile(file, place / "images" / file.name)
            return f"![{words}]({os.path.relpath(Path('images') / file.name, page.parent)})"
        return words

    prose = [
        part if part.startswith(("```", "~~~")) else _LINK.sub(link, part) for part in _FENCE.split(text)
    ]
    return "".join(prose).replace("```mermaid", "```text")


def table(head: Sequence[str], rows: Rows) -> str:
    """Return a table in Markdown: a head and rows of texts."""
    cells = [[str(cell).replace("|", "\\|").replace("\n", " ") for cell in row] for row in (head, *rows)]
    lines = [f"| {' | '.join(row)} |" for row in cells]
    return "\n".join([lines[0], "|" + " --- |" * len(head), *lines[1:]])


# ------------------------------------------------------------------ commands


def commands() -> dict[Path, str]:
    """A page for each command of ``rig``, and for each group with all that is in it."""
    context = click.Context(cli.rig, info_name="rig")
    made = {}
    for name in cli.rig.list_commands(context):
        command = cli.rig.get_command(context, name)
        assert command is not None
        made[Path("reference", "commands", f"{name}.md")] = (
            "\n\n".join(_command(command, name, context, 1)) + "\n"
        )
    return made


def _command(command: click.Command, name: str, above: click.Context, level: int) -> Iterator[str]:
    context = click.Context(command, parent=above, info_name=name)
    yield f"{'#' * level} {context.command_path}"
    yield _prose(command.help or "")
    if isinstance(command, click.Group):
        for each in command.list_commands(context):
            one = command.get_command(context, each)
            assert one is not None
            yield from _command(one, each, context, level + 1)
        return
    yield f"```text\n{context.command_path} {' '.join(command.collect_usage_pieces(context))}\n```"
    groups: dict[str, list[tuple[str, str]]] = {}
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context) if isinstance(parameter, click.Option) else None
        if record is not None:
            group = parameter.group if isinstance(parameter, Option) else RESULT
            groups.setdefault(group, []).append((f"`{record[0]}`", _prose(record[1])))
    for group, records in groups.items():
        yield table((group, ""), records)


def _prose(text: str) -> str:
    """Help as Markdown: what looks like markup there is meant as text."""
    lines = inspect.cleandoc(text).replace("\b\n", "").replace("<", "&lt;")
    return re.sub(r"(?<!`)([*_])(?!`)", r"\\\1", lines)


def command_list() -> str:
    """Return a list of all commands with their one-line help."""
    known = {name: row for name, row in command_rows() if "options" in row}
    rows = (
        (f"[`rig {name}`](commands/{name.split()[0]}.md)", _prose(row["help"])) for name, row in known.items()
    )
    return table(("command", "purpose"), rows)


# ------------------------------------------------------------------ experiments and protocols


def _keys(root: Mapping[str, ConfigKey]) -> str:
    """Tables of keys, a heading for each table of the file."""
    tables: dict[str, list[tuple[str, ...]]] = {}
    for key, parameter in root.items():
        above, _, name = key.rpartition(".")
        row = (
            f"`{name}`",
            _prose(parameter.expected(None)),
            _default(parameter, name),
            _prose(parameter.meaning),
        )
        tables.setdefault(above, []).append(row)
    head = ("key", "value", "if left out", "meaning")
    return "\n\n".join(
        (f"## `[{above}]`\n\n" if above else "## At the top\n\n") + table(head, rows)
        for above, rows in tables.items()
    )


def _default(parameter: ConfigKey, name: str) -> str:
    known = {field.name: field for field in dataclasses.fields(parameter.section)}
    field = known.get(name.removesuffix("[]"))
    if field is None or field.default_factory is not dataclasses.MISSING:
        return "empty"
    if field.default is dataclasses.MISSING:
        return "must be given"
    return "–" if field.default is None else f"`{shown(field.default)}`"


def limit_keys() -> str:
    """Return a table of the limits of a run: the keys of ``[rig.limits]``."""
    return _keys({key: one for key, one in parameters().items() if key.startswith("rig.limits.")})


def configuration() -> str:
    """Every key of an experiment file."""
    return _keys(parameters())


def protocol_keys() -> str:
    """Every key of a study's protocol that is not one of an experiment."""
    return _keys(parameters_of(Protocol))


def preset_list() -> str:
    """The built-in rigs, each with its file."""
    loaded = {name: presets.load(name) for name in presets.names()}
    return "\n\n".join(
        f"## {name}\n\n{_prose(experiment.rig.description)}\n\n```toml\n{presets.text(name)}```"
        for name, experiment in loaded.items()
    )


def estimator_settings() -> str:
    """Return a section for each velocity estimator with its settings."""
    parts = []
    for name in estimators.BUILT_IN:
        one = estimators.get(name)
        rows = [_setting(setting) for setting in one.settings]
        head = ("setting", "value", "default", "meaning")
        body = table(head, rows) if rows else "No settings."
        parts.append(f"## {name}\n\n{_prose(one.summary)} Source: {_prose(str(one.source))}\n\n{body}")
    return "\n\n".join(parts)


def _setting(setting: Any) -> tuple[str, str, str, str]:
    if hasattr(setting, "choices"):
        return f"`{setting.name}`", ", ".join(setting.choices), setting.default, _prose(setting.meaning)
    unit = "" if setting.unit == "1" else f" {setting.unit}"
    default = "must be given" if setting.default is None else f"{setting.default:g}"
    return (
        f"`{setting.name}`",
        f"{setting.minimum:g} to {setting.maximum:g}{unit}",
        default,
        _prose(setting.meaning),
    )


def requirements() -> str:
    """Return a table of the required packages with their bounds, from the metadata of the installed package."""
    needed = [text for text in metadata.requires("haptic-rig") or () if "extra ==" not in text]
    return table(("package", "versions"), (re.split("(?=[<>])", text, maxsplit=1) for text in needed))


# ------------------------------------------------------------------ recordings


def columns() -> str:
    """Every column of a recorded row, and those of the truth."""
    head = ("column", "type", "unit", "meaning")
    rows = (
        (f"`{c.name}`", c.dtype.lstrip("<"), c.unit, _prose(c.description))
        for c in (*COLUMNS, *TRUTH_COLUMNS)
    )
    return table(head, rows)


def units() -> str:
    """Return a table of the meaning of each quantity on a rotary and on a linear rig."""
    return table(("quantity", "rotary", "linear"), ((name, *by.values()) for name, by in UNITS.items()))


def row_flags() -> str:
    """Bits of ``flags``; their meaning stands beside them in the source."""
    return table(("bit", "name", "meaning"), _commented(RowFlag))


def phases() -> str:
    """Return a table of the values of ``phase``."""
    return table(("value", "name"), ((int(phase), f"`{phase.name}`") for phase in Phase))


def _commented(flags: type[RowFlag]) -> Rows:
    meanings = dict(re.findall(r"^    (\w+) = \d+  # (.+)$", inspect.getsource(flags), re.MULTILINE))
    return ((int(flag), f"`{flag.name}`", _prose(meanings[str(flag.name)])) for flag in flags)


# ------------------------------------------------------------------ faults


def faults() -> dict[Path, str]:
    """A page for each fault of a device: what it says, what to do, and what in a rig makes it."""
    rows = single_faults()
    return {_page_of(fault): _fault(fault, rows) for fault in Fault if fault is not Fault.NONE}


def _page_of(fault: Fault) -> Path:
    return Path("reference", "faults", f"{fault.name.lower().replace('_', '-')}.md")


def _fault(fault: Fault, rows: Sequence[SingleFault]) -> str:
    parts = [
        f"# {fault.name}",
        f"**Fault {int(fault)}: {_prose(fault.text)}.**",
        f"## What to do\n\n{_sentence(fault.remedy)}",
        "## Causes",
    ]
    causes = [row for row in rows if fault.name in row.codes]
    parts += [
        f"{_sentence(row.part + ': ' + row.fault)}\n"
        f": Found by {_prose(row.found)}. Reaction: {_prose(row.reaction)}. What remains: {_prose(row.remains)}."
        for row in causes
    ]
    if not causes:
        parts.append(
            "No single fault of a rig causes it: the device reports its own state, or a value that it has received."
        )
    parts.append(
        "Effort is zero and the fault is latched on the device; a recording contains it in column `fault`. The first "
        "fault is stored. `rig device show URL` shows the latched one. The next `rig hit` reads it, reports it and "
        "clears it; if the cause is still present, the fault is latched again before anything moves. All faults with "
        "their detection and tests: [single faults](../../explanation/single-faults.md)."
    )
    return "\n\n".join(parts) + "\n"


def _sentence(text: str) -> str:
    return _prose(text[:1].upper() + text[1:]) + "."


def fault_list() -> str:
    """Return a list of all faults, with links to their pages."""
    rows = ((int(f), f"[`{f.name}`](faults/{_page_of(f).name})", _prose(f.text)) for f in Fault if f)
    return table(("code", "name", "meaning"), rows)


def _codes(codes: Iterable[Described | DescribedFlag]) -> str:
    rows = ((int(c), f"`{c.name}`", _prose(c.text), _prose(c.remedy) or "–") for c in codes)
    return table(("code", "name", "meaning", "remedy"), rows)


# ------------------------------------------------------------------ Python


def python_names() -> str:
    """Every public name of `rig`, from its stub, with its docstring."""
    return _names("rig", rig) + _members("rig.theory", rig.theory.__all__, rig.theory)


def testing_names() -> str:
    """Return the directives of every public name of `rig.testing`."""
    return _names(rig.testing.__name__, rig.testing)


def _names(package: str, module: Any) -> str:
    hidden = ("__version__", "errors", "theory")
    return _members(package, [name for name in public_names(module.__file__) if name not in hidden], module)


def _members(package: str, names: Iterable[str], module: Any) -> str:
    lines = [f".. py:currentmodule:: {package}", ""]
    for name in names:
        kind = "class" if inspect.isclass(getattr(module, name)) else "function"
        called = kind == "class" and module is rig.testing and "__call__" in vars(getattr(module, name))
        lines += [f".. auto{kind}:: {package}.{name}", "   :members:" if kind == "class" else ""]
        lines += ["   :special-members: __call__", ""] if called else [""]
    return "\n".join(["```{eval-rst}", *lines, "```"]) + "\n\n"


def error_kinds() -> str:
    """Return a table of the errors in `rig.errors`, with the exit code of a command."""
    kinds = [
        one for one in vars(errors).values() if inspect.isclass(one) and issubclass(one, errors.RigError)
    ]
    return table(
        ("error", "exit code", "when"),
        ((f"`{one.__name__}`", one.exit_code, _prose((one.__doc__ or "").split("\n\n")[0])) for one in kinds),
    )


PARTS: Mapping[str, Callable[[], str]] = {
    "requirements": requirements,
    "commands": command_list,
    "configuration": configuration,
    "protocol_keys": protocol_keys,
    "presets": preset_list,
    "estimator_settings": estimator_settings,
    "columns": columns,
    "units": units,
    "row_flags": row_flags,
    "phases": phases,
    "faults": fault_list,
    "limit_keys": limit_keys,
    "limits": lambda: _codes(LimitFlag),
    "statuses": lambda: _codes(Status),
    "inputs": lambda: _codes(Input),
    "python": python_names,
    "testing": testing_names,
    "errors": error_kinds,
}
