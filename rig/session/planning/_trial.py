"""Record of one trial: the presented wall, the result of the hit, and the verdict.

All other representations of a trial are derived from this record: the event in the log, the state, the marker of a
stream, the rows of tables and exports (`rig.extras.study.rows.TrialRow`), and the sentences of
`rig.session.engine._telling`. Units and meanings of columns are defined only here. A renamed field would make older
logs unreadable.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any

from rig.control.verdict import Kind
from rig.core.present import plain
from rig.core.quantity import Quantity
from rig.session.planning._names import normalise
from rig.session.search import Probe

REDONE, RESTARTED, LEFT_OUT = "redone", "restarted", "left out"
VOIDED = (REDONE, RESTARTED, LEFT_OUT)  # why a trial does not count, by decision of a person
MARKED = ("trial", "condition", "stiffness", "damping")  # of a wall, in a marker


@dataclass(kw_only=True)
class Presented:
    """Wall that a trial presents, and the search (sequence of trials) to which the trial belongs."""

    block: Annotated[int, Quantity("", "number from 1; 0 is practice")]
    run: Annotated[
        int,
        Quantity(
            "", "number of the run (search) that chose the wall, over the session from 1; 0 is practice"
        ),
    ]
    trial: Annotated[
        int, Quantity("", "number over the session from 1, including practice and repeated trials")
    ]
    attempt: Annotated[int, Quantity("", "attempt at this trial, from 1; higher after invalid ones")]
    condition: Annotated[str, Quantity("", "condition's name in the protocol")]
    damping: Annotated[float, Quantity("damping", "B of the wall")]
    repeat: Annotated[int, Quantity("", "number of the repeat of this condition and damping, from 1")]
    stiffness: Annotated[float, Quantity("stiffness", "K of the wall")]
    track: Annotated[
        int, Quantity("", "track of the search that chose the wall, from 0; -1 for a catch trial")
    ]
    catch: Annotated[
        bool,
        Quantity("", "true for a catch trial, whose correct verdict is known and which the search ignores"),
    ]
    practice: Annotated[bool, Quantity("", "true for practice before the first block, which is not counted")]
    seed: Annotated[int, Quantity("", "seed of the simulation")]

    @property
    def probe(self) -> Probe:
        """The presented wall in the form that search rules use: stiffness, and who chose it."""
        return Probe(self.stiffness, track=self.track, catch=self.catch)

    @property
    def marked(self) -> dict[str, Any]:
        """Number of the trial, condition, stiffness and damping, as content of a marker in a data stream."""
        return {name: getattr(self, name) for name in MARKED}


@dataclass(kw_only=True)
class HitOutcome:
    """Result of one recorded hit on a wall, before a person judges it."""

    recording: Annotated[str, Quantity("", "file of the recording, relative to the participant's directory")]
    sha256: Annotated[str, Quantity("", "SHA-256 of the sealed recording")]
    rows_sha256: Annotated[
        str,
        Quantity("", "digest of the rows alone, which is reproducible in a simulation with the same seed"),
    ]
    ended: Annotated[str, Quantity("", "finished, or why the hit ended early")]
    aborted: Annotated[str, Quantity("", "reason why the hit was cut off for safety; empty if it was not")]
    automatic: Annotated[str, Quantity("", "automatic verdict: stable, limit cycle, unstable, invalid")]
    reasons: Annotated[tuple[str, ...], Quantity("", "reasons of the automatic verdict")]
    outside: Annotated[
        tuple[str, ...],
        Quantity("", "how impact speed or press lay outside the protocol's ranges; empty if inside"),
    ]
    by_machine: Annotated[
        bool,
        Quantity(
            "", "true if invalid only because of gaps or late ticks, caused by the computer or the link"
        ),
    ]
    passes: Annotated[
        Mapping[str, bool | None],
        Quantity("", "true if the wall is stable under each criterion; None: invalid"),
    ]
    numbers: Annotated[Mapping[str, float | None], Quantity("", "measured numbers of the automatic verdict")]
    baseline: Annotated[
        Mapping[str, float] | None,
        Quantity("", "measurements in free space before the hit (rig.session.engine._baseline)"),
    ]
    heat: Annotated[float, Quantity("1", "share of the winding's heat budget after the hit")]


@dataclass(kw_only=True)
class RecordedTrial(Presented, HitOutcome):
    """Recorded trial with its verdict, as stored in the log."""

    verdict: Annotated[
        str, Quantity("", "stable, buzz, unstable, unsure; corrections included; empty if not yet judged")
    ] = ""
    judged_by: Annotated[str, Quantity("", "person, simulated or automatic; empty if not yet judged")] = ""
    response_time_s: Annotated[float | None, Quantity("s", "from the question to the verdict")] = None
    too_fast: Annotated[
        bool,
        Quantity(
            "", "true if a person's verdict came sooner after the question than trial.fastest_verdict_s"
        ),
    ] = False
    void: Annotated[
        str,
        Quantity(
            "",
            "why the trial does not count: redone, restarted, left out, invalid, not judged; empty if it counts",
        ),
    ] = ""

    @property
    def invalid(self) -> bool:
        """True if the hit cannot be judged, so that the trial is repeated without asking for a verdict."""
        return self.automatic == Kind.INVALID

    @property
    def judged(self) -> bool:
        """True if the trial has a verdict on its wall."""
        return self.verdict != "" and not self.invalid

    def leave_out(self, why: str) -> None:
        """Exclude the trial from the results for the reason `why`; keep an earlier reason of the operator."""
        if self.void in ("", LEFT_OUT):
            self.void = why


def event_of(presented: Presented, hit: HitOutcome) -> dict[str, Any]:
    """Return the content of the log entry for a trial: the wall that it presented, and the result of the hit."""
    content: dict[str, Any] = plain({**vars(presented), **vars(hit)})
    return content


def trial_of(content: Mapping[str, Any]) -> RecordedTrial:
    """Return the trial that a log entry describes; it is marked as left out if the operator excluded it later."""
    given = {one.name: content[one.name] for one in (*fields(Presented), *fields(HitOutcome))}
    # A log may be older than the normalisation of names in protocols.
    given["condition"] = normalise(given["condition"])
    given["reasons"], given["outside"] = tuple(given["reasons"]), tuple(given["outside"])
    return RecordedTrial(**given, void=LEFT_OUT if content.get("void") else "")
