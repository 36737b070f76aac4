"""Read the single faults of a rig (`firmware/fmea.toml`): cause, detection, reaction, remaining hazard, tests.

`firmware_protocol.codegen` and the manual's pages print it. The faults must not be repeated here: edit the TOML file.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FMEA = Path(__file__).with_name("firmware") / "FMEA.md"


@dataclass(frozen=True, slots=True, kw_only=True)
class SingleFault:
    """A failure of one part of a rig, its detection and the reaction; the head of `fmea.toml` explains the fields."""

    part: str
    fault: str
    found: str
    reaction: str
    remains: str
    tests: tuple[str, ...]
    codes: tuple[str, ...] = ()
    bench: tuple[int, ...] = ()

    def shown_by(self) -> str:
        """Return the tests and the steps of BENCH.md that demonstrate the reaction to this fault, as Markdown."""
        functions = [f"`{test.partition('::')[2]}`" for test in self.tests]
        steps = [f"step {number}" for number in self.bench]
        return ", ".join([*(functions or ["**no test**"]), *steps])


def single_faults() -> list[SingleFault]:
    """Return the single faults of a rig, in the order of `firmware/fmea.toml`."""
    content = tomllib.loads(FMEA.with_name("fmea.toml").read_text(encoding="utf-8"))
    return [_row(**row) for row in content["row"]]


def _row(**row: Any) -> SingleFault:
    fields: dict[str, Any] = {key: tuple(one) if isinstance(one, list) else one for key, one in row.items()}
    return SingleFault(**fields)
