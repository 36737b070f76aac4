"""Run all property tests with new seeds for a chosen time.

    python -m tests.explore                                  ten minutes
    python -m tests.explore --minutes 60 tests/rig/control   an hour, these tests only
    python -m tests.explore --seed 7 --minutes 0             one round with this seed

The test command draws the same inputs every time; this one searches for new ones, a seed a round. A failing test prints
its example and a blob that replays it with `@reproduce_failure`. The exit code is 1 when a round failed. Ctrl-C ends
it with the summary.
"""

import argparse
import secrets
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]


def explore(minutes: float, seed: int | None, arguments: Sequence[str]) -> Iterator[tuple[int, int]]:
    """Yield the seed and pytest's exit code of each round until the time is up, at least one."""
    end = time.monotonic() + 60.0 * minutes
    command = [sys.executable, "-m", "pytest", "-m", "hypothesis", "--hypothesis-profile=explore"]
    while True:
        drawn = secrets.randbelow(2**31) if seed is None else seed
        print(f"seed {drawn}", flush=True)
        yield (
            drawn,
            subprocess.run(
                [*command, f"--hypothesis-seed={drawn}", *arguments], cwd=ROOT, check=False
            ).returncode,
        )
        seed = None
        if time.monotonic() >= end:
            return


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0, help="a round that has begun is finished [10]")
    parser.add_argument("--seed", type=int, help="seed of the first round")
    known, pytest_arguments = parser.parse_known_args()
    failed = []
    try:
        for seed, code in explore(known.minutes, known.seed, pytest_arguments):
            if code:
                failed.append(seed)
    except KeyboardInterrupt:
        pass
    print(f"rounds that failed, by seed: {failed or 'none'}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
