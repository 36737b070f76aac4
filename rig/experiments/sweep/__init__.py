"""Run many independent function calls (tasks) on all cores or on a cluster; finished results survive any crash.

    results = sweep.run([sweep.Task("a", function_of_a_module, {"x": 1})], journal=Path("journal"))

Maps, designs, papers and the console run their tasks with this package. It must not import an experiment or a result: a
task is any function of a module.
"""

from rig.experiments.sweep._coordinator import Progress, Task
from rig.experiments.sweep._executors import Failure
from rig.experiments.sweep._journal import read_on
from rig.experiments.sweep._tasks import Results, SweepStoppedError, TaskError, run, run_here
from rig.realtime.source_files import code_version

__all__ = [
    "Failure",
    "Progress",
    "Results",
    "SweepStoppedError",
    "Task",
    "TaskError",
    "code_version",
    "read_on",
    "run",
    "run_here",
]
