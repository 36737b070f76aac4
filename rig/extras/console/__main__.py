"""Start a process of a console: ``python -P -m rig.extras.console job`` runs a job, ``… errands`` runs errands.

A job is a run, a session or a map; an errand reads, draws or computes something for a page.
"""

import sys

from rig.core import program

program.begin()

from rig.extras.console import errand_worker, worker  # noqa: E402  (only then)

PROCESSES = {"job": worker.main, "errands": errand_worker.main}

if __name__ == "__main__":
    sys.exit(PROCESSES[sys.argv[1]]())
