"""``rig``, and ``python -m rig``: `rig stop` sends the stop request before anything else is imported.

It must not import `rig.cli` before that: the import takes many times as long.
"""

import os
import sys

from rig.core import program
from rig.realtime import memories


def main() -> None:
    """Run the command line of ``rig``, or print completions for the shell that completes such a command line."""
    if "_RIG_COMPLETE" in os.environ:
        from rig.cli import complete  # noqa: PLC0415

        sys.exit(complete.answer(os.environ["_RIG_COMPLETE"]))
    asked = asked_to_stop(sys.argv[1:])
    program.begin()
    try:
        from rig import cli  # noqa: PLC0415  (it takes many times as long)
    except KeyboardInterrupt:  # a command that runs answers it itself
        sys.stderr.write("\nrig: stopped\n")
        sys.exit(130)
    cli.main(asked)


def asked_to_stop(arguments: list[str]) -> list[memories.LoopMemory] | None:
    """Request running loops to stop at once if the command is ``rig stop``, and return them; else return None."""
    if arguments[:1] != ["stop"]:
        return None
    process = [word for word in arguments[1:] if word not in ("--json", "-q", "--quiet")]
    if process and (len(process) > 1 or not process[0].isdecimal()):
        return None
    return memories.ask_to_stop(int(process[0]) if process else None)


if __name__ == "__main__":
    main()
