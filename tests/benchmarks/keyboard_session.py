"""Run a whole session in real time with a script that presses the keys, and count its invalid trials.

    python -m tests.benchmarks.keyboard_session                          template first-steps, 20 trials
    python -m tests.benchmarks.keyboard_session --scheme uniform:500     on a machine that cannot run at 1 kHz
    python -m tests.benchmarks.keyboard_session --reaction 0.8           a person with a slow reaction
    python -m tests.benchmarks.keyboard_session --template compare-estimators --trials 40

The script is operator and participant of ``rig session run --hand keyboard`` in a pseudo-terminal. It reads the lines:
at *ready?* it presses the go key, at *go* it waits for its reaction time and presses *end*, which moves the hand into
the wall; it repeats the program's own verdict, and continues after every other question. The last line is one JSON
object; the exit code is 0 when at most one trial in twenty was invalid, as on a quiet machine. Machine and load are
printed with the result; gaps and late ticks of a busy machine are counted separately, not as errors of the session.
"""

import argparse
import json
import os
import re
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from rig.session.engine._log import read
from rig.session.planning._template_files import template_text
from tests.conformance.terminal import Terminal
from tests.conformance.tree import ROOT

ALLOWED = 1 / 20
INTO_THE_WALL = "\x1b[F"
LOOK_S = 0.02  # between two reads of the lines
STUCK_S = 120.0  # without a new line
RELEASED_S = 1.3  # more than that of `rig.session.terminal._held`
KEYS = {"stable": "1", "limit cycle": "2", "unstable": "3"}
ANSWERS = {"item, then enter:": "4\r", "[g] go": "g"}  # what is printed, and the keys that answer it


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--template", default="first-steps")
    parser.add_argument("--scheme", help="of all conditions, in place of the template's")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--reaction", type=float, default=0.3, help="seconds from the cue to the key")
    parser.add_argument("--output", type=Path, help="directory of the session, which is kept then")
    return parser.parse_args()


def protocol(options: argparse.Namespace, directory: Path) -> Path:
    """Write the template with the requested number of trials and no practice; return its path."""
    text = template_text(options.template).replace("[stop]\n", f"[stop]\ntrials = {options.trials}\n")
    text = re.sub(r"\[practice\]\nstiffness = \[.*?\]", "[practice]\nstiffness = []", text)
    if options.scheme is not None:
        text = re.sub(r'(?m)^scheme = ".*?"', f'scheme = "{options.scheme}"', text)
    path = directory / "study.toml"
    path.write_text(re.sub(r"\nrepeats = \d+", f"\nrepeats = {options.trials}", text))
    return path


class Participant:
    """A scripted operator and participant who reads the printed lines and presses keys."""

    def __init__(self, terminal: Any, log: Path, reaction_s: float) -> None:
        self.terminal, self.log, self.reaction_s = terminal, log, reaction_s
        self.seen, self.since = "", time.monotonic()
        self.pressed_s: dict[str, float] = {}

    def respond(self) -> None:
        """Press the key that the program requests; raise `TimeoutError` if it prints nothing new for long."""
        printed = self.terminal.fresh
        if printed != self.seen:
            self.seen, self.since = printed, time.monotonic()
        elif time.monotonic() - self.since > STUCK_S:
            raise TimeoutError(printed)
        if "state: go\n" in printed:
            time.sleep(self.reaction_s)
            self.terminal.type(INTO_THE_WALL)
            return
        asked = next((text for text in ("[1] stable", *ANSWERS) if text in printed), None)
        if asked is None:
            return
        keys = ANSWERS.get(asked) or KEYS[self.trials[-1]["automatic"]]
        # As a person releases it.
        time.sleep(max(0.0, self.pressed_s.get(keys, 0.0) + RELEASED_S - time.monotonic()))
        self.terminal.type(keys)
        self.pressed_s[keys] = time.monotonic()

    @property
    def trials(self) -> list[Any]:
        return [event.content for event in read(self.log) if event.kind == "trial"]


def session(options: argparse.Namespace, directory: Path) -> tuple[int, str, list[Any]]:
    """Run the session; return its exit code, its standard error and its trials."""
    command = ["-m", "rig", "session", "run", str(protocol(options, directory)), "P01", "--hand", "keyboard"]
    with Terminal() as terminal:
        participant = Participant(terminal, directory / "study" / "P01" / "session.log", options.reaction)
        more = ["--study", str(directory / "study"), "--lossy-anyway"]
        program = terminal.run(sys.executable, *command, *more, cwd=ROOT)
        try:
            while Path(f"/proc/{program.pid}/exe").exists():
                participant.respond()
                time.sleep(LOOK_S)
            return (*program.wait(), participant.trials)
        finally:
            program.end()


def main() -> int:
    """Run the session, print every invalid trial with its reasons; exit code 0 if they are few enough."""
    options = arguments()
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        directory = options.output or Path(name)
        directory.mkdir(parents=True, exist_ok=True)
        code, output, trials = session(options, directory)
    invalid = [one for one in trials if one["automatic"] == "invalid"]
    for one in invalid:
        cause = "the machine" if one["by_machine"] else "the hit"
        print(f"trial {one['trial']}, {cause}: {'; '.join(one['reasons'])}")
    share = len(invalid) / max(1, len(trials))
    machine = {"load_before": before, "load_after": os.getloadavg()[0], "processors": os.cpu_count()}
    if code:
        print(output, file=sys.stderr)
    print(f"{len(invalid)} of {len(trials)} trials invalid ({share:.0%}); allowed: {ALLOWED:.0%}")
    verdicts = Counter(one["automatic"] for one in trials)
    by_machine = sum(one["by_machine"] for one in invalid)
    print(json.dumps({"verdicts": verdicts, "by_machine": by_machine, "exit_code": code, **machine}))
    return 0 if code == 0 and trials and share <= ALLOWED else 1


if __name__ == "__main__":
    sys.exit(main())
