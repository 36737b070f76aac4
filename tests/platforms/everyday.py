"""What people do off Linux, in one process on an emulated system: ``python -m tests.platforms.everyday win32``.

Runs in an empty directory, prints one line of JSON per command: its words, its exit code, and seconds of processor.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

from tests.platforms.emulated import emulate

SHORT = ["--set", "trial.duration_s=0.6"]
MAP = ["--scheme", "dual:20k/2k", "--search", "bisection", "--ratio", "2", "-B", "0.3", "--offsets", "0.1"]


def preload() -> None:
    """Third parties look at the system when they are imported, and theirs is Linux."""
    import ctypes.util  # noqa: F401, PLC0415
    import multiprocessing.spawn  # noqa: F401, PLC0415

    import click.testing  # noqa: F401, PLC0415
    import numba.np.linalg  # noqa: F401, PLC0415
    import serial  # noqa: F401, PLC0415


def main(platform: str) -> None:
    """Emulate a system, and do it all there."""
    preload()
    emulate(platform)
    if platform == "win32":
        os.environ["PATH"] = ""  # no C compiler
    from rig import cli  # noqa: PLC0415

    def run(*words: str, code: int = 0) -> None:
        begun = time.process_time()
        got = cli.run(list(words), None)
        line = {"words": words, "code": got, "seconds": round(time.process_time() - begun, 2)}
        print(f"\n{json.dumps(line)}", flush=True)
        assert got == code, words

    run("hit", *SHORT)
    (recording,) = map(str, Path("recordings").glob("*.parquet"))
    run("show", recording)
    run("replay", recording, "--estimator", "fdm")
    run("export", recording, "hit.csv")
    run("recover", "recordings")
    run("zwidth", *MAP, "--no-plot")
    run("theory", "--no-plot")
    run("session", "new", "study.toml")
    study = Path("study.toml").read_text().replace("hits = 30", "hits = 3")
    Path("study.toml").write_text(study)
    run("session", "run", "study.toml", "P01", "--rehearse")
    run("session", "analyse", "rehearsals/first-steps")
    run("hit", *SHORT, "--realtime", code=2)
    run("sim", "serve", code=2)
    run("devices")
    run("doctor")
    run("stop")
    run("set", "wall.stiffness=300", code=2)


if __name__ == "__main__":
    main(sys.argv[1])
