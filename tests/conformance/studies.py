"""Studies with known truth: logs of simulated people as a session writes them, without a rig or recordings."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from rig.config import as_mapping, presets
from rig.recording.lines import LineFile
from rig.session.engine._log import SessionLog
from rig.session.engine._state import DoAsk, DoBlock, DoEnd, DoJudge, DoRest, DoTrial, SessionState
from rig.session.planning._load import as_mapping as protocol_as_mapping
from rig.session.planning._load import protocol_from_mapping
from rig.session.planning._trial import HitOutcome, Presented, event_of
from rig.session.search._observer import Observer

PRESET = "koul-compliant"
VERSIONS = {
    "haptic-rig": "0.1.0",
    **dict.fromkeys(("sources", "python", "numpy", "numba", "platform"), "test"),
}


@dataclass(frozen=True, kw_only=True)
class Person:
    """A simulated person with known limits: K50 by condition and damping, and the automatic verdicts on these walls.

    `drift` is added to K50 for each trial of the session. `invalid` is the share of invalid hits; `unsure` that of
    trials with the verdict "unsure". `automatic` shifts the automatic verdict's limit against the person's.
    """

    threshold: Callable[[str, float], float]
    spread: float = 15.0
    lapse_rate: float = 0.0
    drift: float = 0.0
    invalid: float = 0.0
    unsure: float = 0.0
    automatic: float = 0.0


def protocol(**sections: Any) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "study": {"title": "A study", "preset": PRESET, "participants": 4, "seed": 7},
        "search": {"rule": "staircase", "lowest": 100.0, "highest": 900.0, "step": 25.0},
        "order": {"kind": "latin-square", "repeats": 3},
        "condition": [{"name": "uniform", "scheme": "uniform:2k"}, {"name": "dual", "scheme": "dual:20k/2k"}],
    }
    for name, values in sections.items():
        plain[name] = {**plain.get(name, {}), **values} if isinstance(values, Mapping) else values
    return protocol_as_mapping(protocol_from_mapping(plain, "the test's protocol"))


def hit_outcome(automatic: str = "stable", **changes: Any) -> HitOutcome:
    """Return the outcome of a finished hit without a recording; `changes` replace fields."""
    passes = {"stable": True, "invalid": None}.get(automatic, False)
    texts: dict[str, Any] = dict.fromkeys(("recording", "sha256", "rows_sha256", "aborted"), "")
    plain = {
        "ended": "finished", "automatic": automatic, "reasons": (), "outside": (), "by_machine": False,
        "passes": dict.fromkeys(("felt", "heard", "any"), passes), "numbers": {}, "baseline": None, "heat": 0.1,
    }  # fmt: skip
    return HitOutcome(**{**texts, **plain, **changes})


@contextmanager
def without_sync() -> Iterator[None]:
    """Write logs without waiting for the disk, because only their content is tested."""
    with patch.object(LineFile, "sync"):
        yield


@dataclass
class Sitting:
    """A simulated session; `step` does the next action, as the engine would."""

    directory: Path
    log: SessionLog
    state: SessionState
    person: Person
    now: list[float]
    drawn: np.random.Generator
    by: str = "person"
    recorded: bool | Path = False
    asked: list[int] = field(default_factory=list)

    def record(self, kind: str, /, **content: Any) -> int:
        event = self.log.append(kind, **content)
        self.state.apply(event)
        return event.number

    def step(self) -> bool:
        """Do the next action; return False at the end of the session."""
        match self.state.next():
            case DoEnd(reason):
                if self.state.ended is None:
                    self.record("ended", reason=reason)
                return False
            case DoTrial(presented):
                self.hit(presented)
            case DoJudge(trial):
                self.now[0] += 2.0
                self.record(
                    "judged",
                    trial=trial.trial,
                    verdict=self.verdict(trial),
                    judged_by=self.by,
                    response_time_s=round(float(self.drawn.uniform(0.5, 1.5)), 3),
                )
            case DoBlock(block):
                self.record("block", block=block.number)
            case DoRest(seconds, reason):
                self.now[0] += seconds
                self.record("rested", seconds=seconds, reason=reason)
            case DoAsk(item, block):
                self.record(
                    "answered",
                    item=item.name,
                    answer=item.lowest if item.kind == "scale" else str(item.lowest),
                    block=block,
                )
            case other:
                self.record("retried", run=other.run.number)
        return True

    def run(self, trials: int = 10_000) -> None:
        """Continue until the end, or until `trials` more trials are judged."""
        most = len(self.state.trials) + trials
        while not (len(self.state.trials) >= most and not isinstance(self.state.next(), DoJudge)):
            if not self.step():
                return

    def observer(self, condition: str, damping: float, trial: int, shift: float = 0.0) -> Observer:
        return Observer(
            threshold=self.person.threshold(condition, damping) + self.person.drift * trial + shift,
            spread=self.person.spread,
            lapse_rate=self.person.lapse_rate,
        )

    def hit(self, wall: Presented) -> None:
        self.now[0] += 8.0
        invalid = self.drawn.random() < self.person.invalid
        observer = self.observer(wall.condition, wall.damping, wall.trial, self.person.automatic)
        stable = observer.judge(wall.stiffness, self.drawn)
        kind = "stable" if stable else "limit cycle" if wall.stiffness < 700.0 else "unstable"
        recording = digest = ""
        if self.recorded:
            recording = f"trials/t{wall.trial:04d}.parquet"
            made_up = f"{self.state.code} {wall.trial}".encode()
            data = self.recorded.read_bytes() if isinstance(self.recorded, Path) else made_up
            (self.directory / recording).write_bytes(data)
            digest = sha256(data).hexdigest()
        hit = hit_outcome(
            "invalid" if invalid else kind,
            recording=recording,
            sha256=digest,
            rows_sha256=digest,
            numbers={"felt": None, "heard": 0.01, "moved": 0.0, "peak_effort": 0.5},
        )
        self.record("trial", **event_of(wall, hit))

    def verdict(self, trial: Any) -> str:
        if self.state.protocol.study.judge == "automatic":
            return "stable" if trial.passes["any"] else "buzz"
        if self.drawn.random() < self.person.unsure:
            return "unsure"
        if self.observer(trial.condition, trial.damping, trial.trial).judge(trial.stiffness, self.drawn):
            return "stable"
        return "unstable" if trial.automatic == "unstable" else "buzz"


@contextmanager
def sitting(
    directory: Path,
    mapping: Mapping[str, Any],
    person: Person,
    *,
    code: str = "P01",
    row: int = 0,
    seed: int = 1,
    recorded: bool | Path = False,
    rehearsal: Mapping[str, Any] | None = None,
    versions: Mapping[str, Any] = VERSIONS,
) -> Iterator[Sitting]:
    """Begin a session in its directory; recordings are made up, or copies of a file. The test continues it."""
    (directory / "trials").mkdir(parents=True)
    now = [1e9]
    judge = mapping["study"]["judge"]
    with SessionLog(directory / "session.log", clock=lambda: now[0]) as log:
        log.append(
            "began",
            protocol=dict(mapping),
            protocol_sha256="",
            experiment=as_mapping(presets.load(mapping["study"]["preset"])),
            code=code,
            row=row,
            seed=mapping["study"]["seed"],
            versions=dict(versions),
            rehearsal=None if rehearsal is None else dict(rehearsal),
        )
        yield Sitting(
            directory=directory,
            log=log,
            state=SessionState.of(log.events),
            person=person,
            now=now,
            drawn=np.random.default_rng(seed),
            by="automatic" if judge == "automatic" else "simulated" if rehearsal else "person",
            recorded=recorded,
        )


def write_study(
    where: Path, mapping: Mapping[str, Any], people: Mapping[str, Person], **options: Any
) -> list[Path]:
    made = []
    with without_sync():
        for row, (code, person) in enumerate(people.items()):
            with sitting(where / code, mapping, person, code=code, row=row, seed=100 + row, **options) as one:
                one.run()
            made.append(where / code)
    return made
