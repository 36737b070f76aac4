"""The child of the USB tests: does checks, one a line with its arguments, and tells their outcome in a line of JSON."""

from __future__ import annotations

import json
import os
import sys
import traceback

from tests.system.usb import checks


def main() -> None:
    """Read names until the end of the input."""
    said = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    cable = checks.Cable(sys.argv[1])
    for line in sys.stdin:
        try:
            name, *arguments = line.split()
            answer = {"found": getattr(checks, name)(cable, *arguments)}
        except BaseException:
            answer = {"failure": traceback.format_exc()}
        cable.tidy()
        said.write(json.dumps(answer) + "\n")
    cable.close()
    said.close()


if __name__ == "__main__":
    main()
