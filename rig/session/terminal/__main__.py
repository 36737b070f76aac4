"""Run the console as a child process: ``python -m rig.session.terminal IN OUT``, with the descriptors of two pipes."""

import sys

from rig.core import program

program.begin()

if sys.platform != "win32":
    from rig.session.terminal._program import main

if __name__ == "__main__" and sys.platform != "win32":
    sys.exit(main(sys.argv[1:]))
