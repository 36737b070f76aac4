"""Read `firmware/duties.toml`: the functions that a board's firmware must provide to the portable core, with tests.

`firmware_protocol.codegen` and `rig firmware check-port` use this list. The list must not be repeated in Python: edit
the TOML file.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path

PORTING = Path(__file__).with_name("firmware") / "PORTING.md"


@dataclass(frozen=True, slots=True, kw_only=True)
class Duty:
    """A function that a board's firmware must provide to the portable core: its call, requirement, test and remedy."""

    name: str
    call: str
    duty: str
    seen: str
    broken: str
    remedy: str


def duties() -> tuple[Duty, ...]:
    """Return the functions that a board's firmware must provide, in the order of `firmware/duties.toml`."""
    content = tomllib.loads(PORTING.with_name("duties.toml").read_text(encoding="utf-8"))
    return tuple(Duty(**row) for row in content["duty"])
