"""Settings of all tests, and what holds for every run of them.

Hypothesis has no deadlines (the first call of a kernel may compile) and is repeatable in CI. Ctrl-C is heard, also
from a shell that ignores it (`nohup … &`), here and in whatever the tests start.
"""

import gc
import os
import signal

from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: as the command line does
gc.set_threshold(
    20_000, 20, 20
)  # compilers leave a million objects behind: by default 6 % of the time goes into them

settings.register_profile("default", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")

signal.signal(signal.SIGINT, signal.default_int_handler)
