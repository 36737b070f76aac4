"""The child of the USB tests: runs a check for each line of input, and writes its outcome as a line of JSON."""

import json
import os
import sys
import traceback

from rig.core import program


def main() -> None:
    """Run the check of each input line: path of the bus, pipes, transfer mode, name of the check, arguments."""
    program.begin()
    from tests.system.usb import checks  # noqa: PLC0415

    outcomes = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    for line in sys.stdin:
        os.environ["UMOCKDEV_DIR"], orders, answers, transfers, name, *arguments = line.split()
        with open(orders, "w", buffering=1) as to_bridge, open(answers) as from_bridge:
            cable = checks.Cable(to_bridge, from_bridge, transfers)
            try:
                answer = {"found": getattr(checks, name)(cable, *arguments)}
            except BaseException:
                answer = {"failure": traceback.format_exc()}
            cable.tidy()
        outcomes.write(json.dumps(answer) + "\n")
    outcomes.close()


if __name__ == "__main__":
    main()
