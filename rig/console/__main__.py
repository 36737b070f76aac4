"""``python -m rig.console`` is the process that a job runs in (`rig.console.worker`)."""

import sys

from rig.console.worker import main

if __name__ == "__main__":
    sys.exit(main())
