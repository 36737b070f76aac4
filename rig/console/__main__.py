"""The processes that a console starts, ``python -P -m rig.console job`` for a job and ``… errands`` for errands."""

import sys

from rig.core import program

program.begin()

from rig.console import errand_worker, worker  # noqa: E402  (only then)

PROCESSES = {"job": worker.main, "errands": errand_worker.main}

if __name__ == "__main__":
    sys.exit(PROCESSES[sys.argv[1]]())
