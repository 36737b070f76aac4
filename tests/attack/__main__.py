"""Attack the commands with arbitrary options and files, and a host with devices that report wrong data, from a seed.

    python -m tests.attack                                   a minute of each area
    python -m tests.attack --minutes 480 --seed 7            a night
    python -m tests.attack --only liars --seed 7 --case 31   one failure again

An area runs in its own process and mount namespaces if this user may create them. The exit code is 1 after a failure
that is not a known finding. Ctrl-C stops the attack and prints the report.
"""

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from select import select
from typing import Any

from tests.attack.area import AreaReport, isolation
from tests.attack.worker import AREAS
from tests.conformance.started import started

CASE_S = 300.0  # a case that takes longer hangs
READY_S = 600.0  # kernels and the core may have to be compiled
FAILURES_MOST = 50  # of an area
MINUTE_S = 60.0
ROOT = Path(__file__).parents[2]


class Worker:
    """The process that runs the cases of one area; a worker that died is replaced, and the next case follows."""

    def __init__(self, area: str, seed: int) -> None:
        self._place = tempfile.TemporaryDirectory(prefix=f"attack-{area}-", ignore_cleanup_errors=True)
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115  (as long as the process)
        program = (sys.executable, "-m", "tests.attack.worker", area, seed, self._place.name)
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": self._stderr}
        self._context = started(*isolation(), *program, text=True, bufsize=1, cwd=ROOT, **pipes)
        self._process = self._context.__enter__()
        self._read(READY_S)

    def run(self, case: int) -> dict[str, Any]:
        """Run a case and return its result; report a process that dies or hangs as a failure of this case."""
        try:
            print(case, file=self._process.stdin, flush=True)
            return self._read(CASE_S)
        except (OSError, EOFError, TimeoutError) as error:
            return {"case": case, "failure": f"{error}; {self._last_words()}", "gone": True}

    def _read(self, patience_s: float) -> dict[str, Any]:
        if not select([self._process.stdout], [], [], patience_s)[0]:
            raise TimeoutError(f"no answer within {patience_s:g} s")
        line = self._process.stdout.readline()  # type: ignore[union-attr]
        if not line:
            raise EOFError(f"the process ended: {self._process.wait()}")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        self._context.__exit__(None, None, None)
        self._stderr.close()
        self._place.cleanup()


def attack(area: str, seed: int, report: AreaReport, cases: range, seconds: float) -> None:
    """Run cases of an area until the time is over or no case remains."""
    worker, begun = Worker(area, seed), time.monotonic()
    try:
        for case in cases:
            answer = worker.run(case)
            report.add(answer)
            report.seconds = time.monotonic() - begun
            if answer.get("gone"):
                worker.close()
                worker = Worker(area, seed)
            if report.seconds >= seconds or len(report.failures) >= FAILURES_MOST:
                break
    finally:
        worker.close()


def main() -> int:
    """Parse the command line, run the attack, print the report and return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.attack", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--minutes", type=float, help="in total; areas share them alike [one for each area]")
    parser.add_argument("--seed", type=int, help="[drawn, and printed]")
    parser.add_argument("--only", action="append", choices=list(AREAS), metavar="AREA", help=", ".join(AREAS))
    parser.add_argument("--case", type=int, help="this one alone")
    chosen = parser.parse_args()
    seed = random.SystemRandom().getrandbits(32) if chosen.seed is None else chosen.seed
    names = chosen.only or list(AREAS)
    minutes = len(names) if chosen.minutes is None else chosen.minutes
    seconds = minutes * MINUTE_S / len(names)
    cases = range(1 << 62) if chosen.case is None else range(chosen.case, chosen.case + 1)
    reports = {name: AreaReport() for name in names}
    print(f"seed {seed}; isolated by {' '.join(isolation()) or 'nothing'}", file=sys.stderr)
    try:
        for name in names:
            attack(name, seed, reports[name], cases, seconds)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
    print("\n".join(line for name, one in reports.items() for line in one.lines(name, seed)))
    return int(any(one.failures for one in reports.values()))


if __name__ == "__main__":
    sys.exit(main())
