"""Run the usual commands in one process: ``python -m tests.platforms.everyday win32 [URL]`` in an empty directory.

On an emulated system, or with ``here`` on this one; with the URL of a board that runs the law, hits in real time
instead, one with a person. Prints a line of JSON for each command and ends with 1 after an unexpected result.
"""

import json
import os
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

from tests.platforms.emulated import emulate

SHORT = ("--set", "trial.duration_s=0.6", "--no-plot")
SLOW = ("--rate", "4k/1k")  # the readable device, which runs where no compiler is, needs 0.1 ms for a tick
MAP = "--scheme dual:20k/2k --search bisection --ratio 2 -B0.3 --offsets 0.1 --no-plot"
ON_THE_BOARD = ("--rig", "koul-rigid", "--loop", "device", "--rate", "5k/500", "-K60", "-B0.05", *SHORT)
IN_TIME = ("--set", "controller.supervise_lifetime_s=0.1", "--verified")
A_PERSON = (
    *("--operator", "normal", "--set", "operator.press=2", "--set", "rig.limits.human=true"),
    *("--set", "rig.limits.effort=0.28", "--set", "verdict.tail_s=0.1"),
    "--arm-anyway",  # the link depends on the load of this machine
)
LINUX_ALONE = "needs Linux to run in real time"


def main(platform: str, url: str = "") -> int:
    """Run the commands. The emulated Windows has no C compiler and runs all others; macOS runs those that differ."""
    preload()
    if platform == "here":
        platform = sys.platform
    else:
        emulate(platform)
        if platform == "win32":
            os.environ["PATH"] = ""
    from rig import cli  # noqa: PLC0415

    wrong = 0

    def run(*words: str, refused: str = "") -> None:
        nonlocal wrong
        out, err = StringIO(), StringIO()
        with redirect_stdout(out), redirect_stderr(err):
            code = cli.run(list(words))
        result = {"words": words, "code": code, "out": out.getvalue(), "err": err.getvalue()}
        print(json.dumps(result), flush=True)
        right = code == (2 if refused else 0) and refused in err.getvalue()
        wrong += not right or "Traceback" in err.getvalue()

    if url:
        run("hit", *ON_THE_BOARD, *IN_TIME, "--arm-anyway", "--url", url)
        run("hit", *ON_THE_BOARD, *IN_TIME, *A_PERSON, "--url", url)
        run("hit", *SHORT, "--rig", "koul-rigid", "--url", url, "--verified", refused=LINUX_ALONE)
        run("device", "check", "--rig", "koul-rigid", "--url", url, "--verified", refused=LINUX_ALONE)
        return 1 if wrong else 0
    run("hit", *SHORT, *SLOW)
    if platform != "darwin":
        run("zwidth", *MAP.split())
    run("session", "new", "study.toml")
    study = Path("study.toml")
    study.write_text(study.read_text().replace("hits = 30", "hits = 3"))
    run("session", "run", "study.toml", "P01", "--rehearse", "--json")
    run("hit", *ON_THE_BOARD, refused="" if _has_compiler() else "there is no C compiler")
    if platform != "linux":
        run("hit", *SHORT, *SLOW, "--realtime", refused=LINUX_ALONE)
    if platform != "darwin":
        (recording,) = map(str, Path("recordings").glob("koul-compliant*.parquet"))
        run("show", recording, "--json")
        run("recording", "replay", recording, "--estimator", "fdm", "--json")
        run("recording", "export", recording, "hit.csv")
        run("recording", "recover", "recordings")
        run("session", "analyse", "rehearsals/first-steps", "--format", "png")
        run("device", "list")
        run("doctor")
        run("stop")
    if platform == "win32":
        run("session", "run", "study.toml", "P02", refused=LINUX_ALONE)
        run("serve", "rig", refused=LINUX_ALONE)
    return 1 if wrong else 0


def _has_compiler() -> bool:
    from rig.core.errors import ConfigError  # noqa: PLC0415
    from sim_backend.board.firmware_library import FIRMWARE  # noqa: PLC0415

    try:
        return bool(FIRMWARE.compiler())
    except ConfigError:
        return False


def preload() -> None:
    """Import third-party modules that check the system, because they must see the true one."""
    import ctypes.util  # noqa: F401, PLC0415
    import multiprocessing.spawn  # noqa: F401, PLC0415

    import click.testing  # noqa: F401, PLC0415
    import numba.np.linalg  # noqa: F401, PLC0415
    import serial.tools.list_ports  # noqa: F401, PLC0415


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
