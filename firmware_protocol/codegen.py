"""Generate the tables of the protocol's pages, and the firmware's C tables, from the tables in Python.

``python -m firmware_protocol.codegen`` rewrites the sections between the markers of PROTOCOL.md, PORTING.md, FMEA.md
and HARDWARE.md, and the firmware's ``protocol.h`` and ``protocol.c``. With ``--check`` it changes nothing and exits
with 1 if a file is out of date. Developers run it after a change of these tables. It must not write outside of the
markers, where the text is written by hand.
"""

import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from firmware_protocol import messages as m
from firmware_protocol.connection import REPLIES, TRANSITIONS, UNASKED, State
from firmware_protocol.duties import PORTING, duties
from firmware_protocol.faults import Described, DescribedFlag, Fault, Input, LimitFlag, Status
from firmware_protocol.fmea import FMEA, single_faults
from firmware_protocol.framing import CRC_BYTES, HEADER_BYTES
from firmware_protocol.header import FILES, title
from firmware_protocol.packing import FAULT_ENTRY_BYTES, LAYOUTS, Header
from firmware_protocol.parameters import PARAMETERS
from firmware_protocol.wire import FORMATS, Wire, record_struct, wire_fields

PROTOCOL = Path(__file__).with_name("PROTOCOL.md")
HARDWARE = FMEA.with_name("HARDWARE.md")
PAGES = PROTOCOL, PORTING, FMEA, HARDWARE
WIRING = FMEA.parent / "boards" / "rp2040" / "wiring.toml"
_SECTION = re.compile(r"<!-- generated: (\w+) -->\n.*?<!-- end -->", re.DOTALL)


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table; `head` contains the column titles, each of `rows` the cells of a row."""
    lines = [
        "| " + " | ".join(str(cell) for cell in row) + " |" for row in (head, ["---"] * len(head), *rows)
    ]
    return "\n".join(lines)


def _first_line(thing: object) -> str:
    return (thing.__doc__ or "").strip().splitlines()[0]


def _field_table(wires: dict[str, Wire], start: int = 0) -> str:
    rows, at = [], start
    for name, wire in wires.items():
        rows.append((at, wire.ctype, f"`{name}`", wire.unit, wire.meaning))
        if wire.ctype in FORMATS:
            at += 2 ** ("8", "16", "32", "64").index(wire.ctype[1:])
    return table(("offset", "type", "field", "unit", "meaning"), rows)


def overview() -> str:
    """Return the Markdown table of all messages: type id, sender, delivery class and frame size (bytes)."""
    rows = []
    for type_id, cls in m.MESSAGES.items():
        layout = LAYOUTS[type_id]
        size = HEADER_BYTES + layout.size + CRC_BYTES
        length = f"{size} … {size + layout.data_limit}" if layout.tail else f"{size}"
        rows.append(
            (f"0x{type_id:02X}", f"`{title(cls)}`", layout.sender.name.lower(), layout.delivery.name, length)
        )
    return table(("type", "message", "sent by", "class", "bytes of the raw frame"), rows)


def messages() -> str:
    """Return the Markdown section of every message, with the table of its payload's fields."""
    parts = []
    for type_id, cls in m.MESSAGES.items():
        reply = REPLIES.get(cls)
        answer = f" Answered by `{title(reply)}`." if reply else ""
        heading = f"### 0x{type_id:02X} {title(cls)}"
        parts.append(
            f"{heading}\n\n{_first_line(cls)}{answer}\n\n{_field_table(wire_fields(cls), HEADER_BYTES)}"
        )
    return "\n\n".join(parts)


def batch_layouts() -> str:
    """Return the Markdown table of the layouts of a sample in a BATCH message: C type of each value, size (bytes)."""
    columns = ("count difference", "commanded current", "measured current")
    rows = []
    for key, ctypes in m.BATCH_LAYOUTS.items():
        cells = [ctypes[i] if i < len(ctypes) else "–" for i in range(len(columns))]
        rows.append((key, *cells, sum(int(ctype[1:]) // 8 for ctype in ctypes)))
    return table(("layout", *columns, "bytes a sample"), rows)


def fault_entry() -> str:
    """Return the Markdown table of the fields of a FAULT_ENTRY (a tick in the fault log), and its size (bytes)."""
    return f"{_field_table(wire_fields(m.FaultEntry))}\n\n{FAULT_ENTRY_BYTES} bytes an entry."


def parameters() -> str:
    """Return the Markdown table of the device's parameters: id, C type, unit, range, default and meaning."""
    rows = [
        (p.id, f"`{p.name}`", p.ctype, p.unit, p.minimum, p.maximum, p.default, p.meaning) for p in PARAMETERS
    ]
    return table(("id", "name", "type", "unit", "minimum", "maximum", "default", "meaning"), rows)


def _code_table(codes: Iterable[Described | DescribedFlag]) -> str:
    return table(
        ("code", "name", "meaning", "remedy"), [(int(c), f"`{c.name}`", c.text, c.remedy) for c in codes]
    )


def picture() -> str:
    """Return the diagram of the device's states as a Mermaid block, with every transition that changes the state."""
    lines = ["```mermaid", "stateDiagram-v2", "    [*] --> BOOT: reset"]
    for state, row in TRANSITIONS.items():
        for cls, after in row.items():
            if after is not state:
                flag = " with CLEAR_FAULT" if state is State.FAULT else ""
                lines.append(f"    {state.name} --> {after.name}: {title(cls)}{flag}")
        if state is not State.FAULT:
            lines.append(f"    {state.name} --> FAULT: fault of the device")
    return "\n".join([*lines, "```"])


def states() -> str:
    """Return the Markdown table of the state after each message in each state; last row: messages without a request."""
    requests = [cls for type_id, cls in m.MESSAGES.items() if m.sender_of(type_id) is m.Role.HOST]
    rows: list[Sequence[object]] = [
        (f"`{title(cls)}`", *(row[cls].name if cls in row else "–" for row in TRANSITIONS.values()))
        for cls in requests
    ]
    sent = [", ".join(sorted(f"`{title(cls)}`" for cls in UNASKED[state])) or "–" for state in State]
    rows.append(("sent by the device without a request", *sent))
    return table(("message from the host", *(f"in {state.name}" for state in State)), rows)


def header() -> str:
    """Return the Markdown table of the header's fields; every frame begins with the header."""
    return _field_table(wire_fields(Header))


def faults_of_a_rig() -> str:
    """Return the Markdown table of a rig's single faults, each with detection, reaction, remaining hazard and test."""
    rows = [
        (
            one.part,
            one.fault,
            one.found + (f": {', '.join(f'`{code}`' for code in one.codes)}" if one.codes else ""),
            one.reaction,
            one.remains,
            one.shown_by(),
        )
        for one in single_faults()
    ]
    return table(("part", "fault", "detected by", "reaction", "remaining hazard", "test"), rows)


def duties_of_a_port() -> str:
    """Return the Markdown table of the functions that a board's firmware must provide, and how each is tested."""
    rows = (
        (f"`{one.call}`" if one.call.isidentifier() else one.call, one.duty, one.seen) for one in duties()
    )
    return table(("call", "duty", "how the check sees it"), rows)


def parts_list() -> str:
    """Return the Markdown table of the parts of the reference rig, with the source of each part's data."""
    parts = tomllib.loads(WIRING.read_text(encoding="utf-8"))["part"]
    return table(("", "part", "source"), ((one["name"], _describe_part(one), one["source"]) for one in parts))


def _describe_part(row: dict[str, Any]) -> str:
    only = ", ".join(f'`{name} = "{value}"`' for name, value in row.get("where", {}).items())
    return f"{row['what']} (with {only})" if only else str(row["what"])


def version() -> str:
    """Return the sentence with the protocol's version and the encoded sizes (bytes) of messages COMMAND and STATE."""
    command, state = (HEADER_BYTES + record_struct(cls).size + CRC_BYTES + 2 for cls in (m.Command, m.State))
    sizes = f"a `COMMAND` takes {command} bytes and a `STATE` {state}"
    return f"Version {m.MAJOR}.{m.MINOR}. On the wire, stuffing and delimiter included, {sizes}."


SECTIONS: dict[str, Callable[[], str]] = {
    "version": version,
    "header": header,
    "overview": overview,
    "messages": messages,
    "batch_layouts": batch_layouts,
    "fault_entry": fault_entry,
    "parameters": parameters,
    "faults": lambda: _code_table(Fault),
    "limits": lambda: _code_table(LimitFlag),
    "statuses": lambda: _code_table(Status),
    "inputs": lambda: _code_table(Input),
    "picture": picture,
    "states": states,
    "duties": duties_of_a_port,
    "single_faults": faults_of_a_rig,
    "parts_list": parts_list,
}


def render(text: str) -> str:
    """Generate the sections ``<!-- generated: NAME -->`` of a page again; raise KeyError for an unknown NAME."""
    return _SECTION.sub(
        lambda match: f"<!-- generated: {match[1]} -->\n{SECTIONS[match[1]]()}\n<!-- end -->", text
    )


def fresh() -> dict[Path, str]:
    """Return the up-to-date text of every generated file by path."""
    made = {page: render(page.read_text(encoding="utf-8")) for page in PAGES}
    return made | {path: text() for path, text in FILES.items()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Rewrite generated files that are out of date; with ``--check``, only report them and return 1 if any exist."""
    check = "--check" in (sys.argv[1:] if arguments is None else arguments)
    stale = {path: text for path, text in fresh().items() if _read_text(path) != text}
    for path, text in stale.items():
        if check:
            print(f"{path.name} is stale: run python -m firmware_protocol.codegen", file=sys.stderr)
        else:
            path.write_text(text, encoding="utf-8")
    return int(check and bool(stale))


def _read_text(path: Path) -> str:
    return path.read_text(encoding="utf-8") if path.exists() else ""


if __name__ == "__main__":
    raise SystemExit(main())
