"""Run one attack area in its own process: read the number of a case, run it, reply with one line of JSON.

    python -m tests.attack.worker AREA SEED DIRECTORY

A crash, a hang or a leak ends only this process and identifies its case; child processes die with it.
"""

import importlib
import json
import os
import signal
import sys
import traceback
from pathlib import Path

from tests.attack.area import Area, chance_of
from tests.conformance.started import die_with_parent

# Area → its class. An area alone imports what it needs.
AREAS = {
    "options": "tests.attack.options:Options",
    "liars": "tests.attack.liars:Liars",
}


def area_of(name: str, place: Path) -> Area:
    """Return a new area that works in a directory."""
    module, _, attribute = AREAS[name].partition(":")
    made: Area = getattr(importlib.import_module(module), attribute)(place)
    return made


def answer(area: Area, name: str, seed: int, case: int) -> dict[str, object]:
    """Run a case and return its result as plain data."""
    try:
        outcome = area.attack(case, chance_of(seed, name, case))
    except Exception as error:
        shown = traceback.format_exc() if os.environ.get("ATTACK_DEBUG") else ""
        return {"case": case, "failure": f"{type(error).__name__}: {error}\n{shown}".strip()}
    return {"case": case, **{kind: dict(getattr(outcome, kind)) for kind in ("figures", "known")}}


def main() -> None:
    """Run the cases whose numbers arrive on standard input."""
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C is for the one that reports
    name, seed = sys.argv[1], int(sys.argv[2])
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what the attacked code prints is no answer
    area = area_of(name, Path(sys.argv[3]))
    print(json.dumps({"ready": True}), file=answers)
    for line in sys.stdin:
        print(json.dumps(answer(area, name, seed, int(line))), file=answers)


if __name__ == "__main__":
    main()
