"""Settings of all tests: hypothesis without deadlines (the first call of a kernel may compile), repeatable in CI."""

import gc
import os

from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: as the command line does
gc.set_threshold(
    20_000, 20, 20
)  # compilers leave a million objects behind: by default 6 % of the time goes into them

settings.register_profile("default", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")
