"""``python -m rig.session.terminal IN OUT``: the child; the numbers are descriptors of its two pipes."""

import sys

from rig.core import program

program.begin()

if sys.platform != "win32":
    from rig.session.terminal._program import main

if __name__ == "__main__" and sys.platform != "win32":
    sys.exit(main(sys.argv[1:]))
