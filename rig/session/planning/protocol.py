"""What a protocol file may say: an experiment with people, as sections with types, ranges and meanings.

A protocol says what is compared (conditions), how the limit of each is searched, in which order, who may see what, when
people rest, and when it ends. The physics (rig, trial, thresholds) is that of an experiment file, which the protocol
names and changes by dotted keys. `rig.session.planning.load` reads and checks, `rig.session.planning.schedule` makes
the order.

Stiffness, damping, effort and speed are in the units of the rig's motion (`rig.core.sample.unit_of`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Ge, Gt, Le, MinLen

from rig.core.quantity import STRICT, Quantity
from rig.session.search.catching import MOST_SHARE

Setting = bool | int | float | str

RuleName = Literal["ascending", "staircase", "interleaved", "psi", "grid"]

BLINDED = ("both", "operator")  # of `study.blind`: the operator sees no wall

Band = tuple[float, ...]  # least and most; empty: anything


@dataclass(frozen=True, kw_only=True, slots=True)
class Study:
    """What it is about, on which rig, and who may know what."""

    title: Annotated[str, MinLen(1), Quantity("", "of the study, as a report prints it")]
    preset: Annotated[str | None, MinLen(1), Quantity("", "built-in rig; or give experiment")] = None
    experiment: Annotated[
        str | None, MinLen(1), Quantity("", "experiment file, relative to this one; or give preset")
    ] = None
    changes: Annotated[
        Mapping[str, Setting], Quantity("", "changes to the experiment in all conditions, by dotted key")
    ] = field(default_factory=dict)
    seed: Annotated[int, Ge(0), Le(2**53 - 1), Quantity("", "of order, tracks and catch trials")] = 0
    participants: Annotated[int, Ge(1), Le(10_000), Quantity("", "how many are planned")] = 12
    code: Annotated[
        str, MinLen(1), Quantity("", "pattern of a participant's code, a regular expression; never a name")
    ] = "P[0-9]{2}"
    blind: Annotated[
        Literal["both", "operator", "participant", "none"],
        Quantity(
            "",
            "who sees no condition, stiffness or damping; operator and both hide them on the console, participant is a "
            "promise of the operator",
        ),
    ] = "both"
    judge: Annotated[
        Literal["person", "automatic"],
        Quantity("", "whose verdict the search follows; both are kept"),
    ] = "person"
    criterion: Annotated[
        Literal["any", "felt", "heard"], Quantity("", "what ends the Z-width in the automatic verdict")
    ] = "any"

    notes: Annotated[
        str, Quantity("", "what else whoever opens the study should know; kept, and printed nowhere")
    ] = ""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Order:
    """In which order conditions and repeats come."""

    kind: Annotated[
        Literal["fixed", "randomised", "latin-square"],
        Quantity(
            "",
            "of the runs in a block: as written, drawn anew for each block, or balanced over participants (Williams)",
        ),
    ] = "latin-square"
    repeats: Annotated[int, Ge(1), Le(1000), Quantity("", "runs of each condition and damping")] = 1
    blocks: Annotated[
        Literal["repeat", "condition", "one"],
        Quantity(
            "",
            "what a block holds: one repeat of everything, all repeats of one condition, or the whole session",
        ),
    ] = "repeat"
    interleave: Annotated[
        bool, Quantity("", "the runs of a block take turns, trial by trial, instead of following each other")
    ] = False

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Search:
    """How the stiffest wall is searched: the rule, its levels, and its settings (`rig.session.search`)."""

    lowest: Annotated[float, Gt(0), Quantity("stiffness", "softest wall that is asked for")]
    highest: Annotated[float, Gt(0), Quantity("stiffness", "stiffest wall that is asked for")]
    rule: Annotated[RuleName, Quantity("", "who decides which wall comes next")] = "staircase"
    step: Annotated[float | None, Gt(0), Quantity("stiffness", "between levels; or give ratio")] = None
    ratio: Annotated[float | None, Gt(1), Le(100), Quantity("1", "between levels; or give step")] = None
    settings: Annotated[
        Mapping[str, Any],
        Quantity("", "of the rule: repeats, stable_to_rise, start, steps, turns, most, hits, enough …"),
    ] = field(default_factory=dict)
    catch_share: Annotated[
        float,
        Ge(0),
        Le(MOST_SHARE),
        Quantity(
            "1",
            "of trials that are catch trials, of the softest or the stiffest wall: they count for no limit and "
            "show the lapse rate",
        ),
    ] = 0.0

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Condition:
    """One thing that is compared: a sampling scheme, with whatever else differs, at one or more dampings."""

    name: Annotated[
        str, MinLen(1), Quantity("", "in tables and pictures; nobody who is blinded ever sees it")
    ]
    scheme: Annotated[
        str | None,
        MinLen(1),
        Quantity(
            "", "like dual:20k/2k,estimator=kalman (rig.config.schemes); left out: the experiment's own"
        ),
    ] = None
    damping: Annotated[
        tuple[float, ...], MinLen(1), Quantity("damping", "B of each run; a search for each")
    ] = (0.0,)
    changes: Annotated[
        Mapping[str, Setting],
        Quantity("", "what else differs, by dotted key; a part of the machine needs fit"),
    ] = field(default_factory=dict)
    search: Annotated[Search | None, Quantity("", "instead of the study's [search]")] = None
    fit: Annotated[
        str,
        Quantity(
            "",
            "what somebody must fit to the rig for it, such as a damper: the session asks for that, blinded or not; "
            "empty: the rig as it is",
        ),
    ] = ""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """One hit, as a person lives it."""

    kind: Annotated[
        Literal["human", "constant-effort"], Quantity("", "who hits: the participant, or the motor")
    ] = "human"
    baseline_s: Annotated[
        float, Ge(0), Le(60), Quantity("s", "free space before the cue; 0 for a motor that pushes at once")
    ] = 0.0
    foreperiod_s: Annotated[
        float,
        Ge(0),
        Le(60),
        Quantity("s", "most of a random time after that, so that nobody anticipates the cue"),
    ] = 0.0
    duration_s: Annotated[
        float | None,
        Gt(0),
        Le(600),
        Quantity(
            "s", "the hit itself, or with hold_s how long the cue is waited upon; left out: the experiment's"
        ),
    ] = None
    hold_s: Annotated[
        float | None,
        Gt(0),
        Le(600),
        Quantity("s", "from first contact to the end of the hit; left out: duration_s, contact or not"),
    ] = None
    impact_speed: Annotated[
        Band,
        Quantity("velocity", "least and most at the first contact, as [0.2, 0.4]; left out: any"),
    ] = ()
    press: Annotated[
        Band,
        Quantity(
            "effort", "least and most of the mean effort in the judged tail, as [0.1, 0.3]; left out: any"
        ),
    ] = ()
    outside: Annotated[
        Literal["invalid", "keep"],
        Quantity("", "what a trial outside one of these bands is: invalid and repeated, or kept and marked"),
    ] = "invalid"
    ready_s: Annotated[
        float,
        Ge(0),
        Le(600),
        Quantity("s", "planned: from *ready?* to the start, with what the operator reads out"),
    ] = 3.0
    verdict_s: Annotated[
        float, Ge(0), Le(600), Quantity("s", "planned: from the end of a hit to the verdict's key")
    ] = 2.0
    fastest_verdict_s: Annotated[
        float,
        Ge(0),
        Le(10),
        Quantity(
            "s",
            "a person's verdict that comes sooner after the question is reported at once and marked too_fast; 0: none",
        ),
    ] = 0.1
    attempts: Annotated[
        int, Ge(1), Le(20), Quantity("", "at a trial that is invalid, before somebody is asked what to do")
    ] = 3
    unsure: Annotated[
        int,
        Ge(1),
        Le(20),
        Quantity("", "unsure verdicts in a row on one wall, before it counts as not stable"),
    ] = 3
    hand: Annotated[
        Literal["", "right", "left", "dominant"],
        Quantity("", "with which the handle is held; empty: not said"),
    ] = ""
    posture: Annotated[str, Quantity("", "how the participant sits and holds, a sentence for the report")] = (
        ""
    )
    masking_noise: Annotated[
        bool | None, Quantity("", "whether noise masks what is heard of the motor; left out: not said")
    ] = None
    say: Annotated[str, Quantity("", "what the operator reads to the participant before each hit")] = (
        "Push into the wall until it stops you, and stay there."
    )

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Practice:
    """Trials before the first block, which count for nothing."""

    stiffness: Annotated[
        tuple[float, ...], Quantity("stiffness", "walls of the practice trials, in this order")
    ] = ()
    condition: Annotated[str | None, Quantity("", "under which; left out: the first")] = None

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Rest:
    """When hand and motor rest."""

    every: Annotated[int, Ge(0), Le(10_000), Quantity("", "trials between two rests; 0: never")] = 0
    seconds: Annotated[float, Ge(0), Le(3600), Quantity("s", "length of such a rest")] = 60.0
    between_blocks_s: Annotated[
        float, Ge(0), Le(3600), Quantity("s", "rest after each block but the last")
    ] = 0.0
    heat: Annotated[
        float,
        Gt(0),
        Le(1),
        Quantity("1", "share of the winding's heat budget above which the motor cools before the next trial"),
    ] = 0.5

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Caps:
    """What no trial may exceed, whatever a rule asks for."""

    stiffness: Annotated[
        float | None, Gt(0), Quantity("stiffness", "stiffest wall; left out: no cap but the plan's checks")
    ] = None
    effort: Annotated[float | None, Gt(0), Quantity("effort", "over rig.limits.effort")] = None
    speed: Annotated[float | None, Gt(0), Quantity("velocity", "over rig.limits.speed")] = None
    energy: Annotated[
        float | None,
        Gt(0),
        Quantity("J", "that the motor may give to the hand in a hit; over rig.limits.energy"),
    ] = None

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Stop:
    """When a session ends early, whatever is left of it."""

    trials: Annotated[int | None, Ge(1), Le(100_000), Quantity("", "after so many trials")] = None
    minutes: Annotated[float | None, Gt(0), Le(1440), Quantity("min", "after this time, rests included")] = (
        None
    )
    invalid: Annotated[
        int | None,
        Ge(1),
        Le(1000),
        Quantity(
            "", "after so many invalid trials in a row, those aside that the computer or the link spoiled"
        ),
    ] = None
    machine: Annotated[
        int,
        Ge(1),
        Le(1000),
        Quantity(
            "", "trials in a row that gaps or late ticks spoiled, before the session pauses; it does not end"
        ),
    ] = 5
    aborts: Annotated[
        int | None,
        Ge(1),
        Le(1000),
        Quantity("", "after so many hits in a row that had to be cut off for safety"),
    ] = None

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Item:
    """One question of the questionnaire."""

    name: Annotated[str, MinLen(1), Quantity("", "column of the table; letters, digits, underscores")]
    text: Annotated[str, MinLen(1), Quantity("", "the question, as it is read out")]
    when: Annotated[
        Literal["start", "block", "end"],
        Quantity("", "before the first block, after each block, or at the end"),
    ] = "end"
    kind: Annotated[Literal["scale", "choice", "text"], Quantity("", "what an answer is")] = "scale"
    lowest: Annotated[int, Quantity("", "of a scale")] = 1
    highest: Annotated[int, Quantity("", "of a scale")] = 7
    choices: Annotated[tuple[str, ...], Quantity("", "of a choice")] = ()

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Keys:
    """Keys of the console; a foot pedal types one of them."""

    stable: Annotated[str, MinLen(1), Quantity("", "verdict: stable")] = "1"
    buzz: Annotated[str, MinLen(1), Quantity("", "verdict: buzz")] = "2"
    unstable: Annotated[str, MinLen(1), Quantity("", "verdict: unstable")] = "3"
    unsure: Annotated[str, MinLen(1), Quantity("", "verdict: unsure")] = "4"
    go: Annotated[str, MinLen(1), Quantity("", "continue; enter does so too")] = "g"
    redo: Annotated[str, MinLen(1), Quantity("", "the last trial does not count and comes again")] = "r"
    pause: Annotated[str, MinLen(1), Quantity("", "pause before the next trial")] = "p"
    note: Annotated[str, MinLen(1), Quantity("", "write a note into the log")] = "n"
    skip: Annotated[str, MinLen(1), Quantity("", "leave this run without a limit")] = "s"
    abort: Annotated[str, MinLen(1), Quantity("", "leave the session; it can be resumed")] = "a"
    bell: Annotated[bool, Quantity("", "ring when the participant may begin")] = True

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Protocol:
    """A whole protocol, validated."""

    study: Study
    condition: tuple[Condition, ...]
    search: Search
    order: Order = field(default_factory=Order)
    trial: Trial = field(default_factory=Trial)
    practice: Practice = field(default_factory=Practice)
    rest: Rest = field(default_factory=Rest)
    caps: Caps = field(default_factory=Caps)
    stop: Stop = field(default_factory=Stop)
    question: tuple[Item, ...] = ()
    keys: Keys = field(default_factory=Keys)

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT

    def condition_named(self, name: str) -> Condition:
        """Return the condition of this name; raise `KeyError` if it is missing."""
        for condition in self.condition:
            if condition.name == name:
                return condition
        raise KeyError(name)

    def search_of(self, condition: Condition) -> Search:
        """The search of a condition: its own, or the study's."""
        return condition.search or self.search
