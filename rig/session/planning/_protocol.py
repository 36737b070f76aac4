"""Sections of a protocol file for an experiment with participants: types, ranges and meanings of all keys.

The protocol names an experiment file with the physics (rig, trial, thresholds), and changes it by dotted keys.
Stiffness, damping, effort and speed are in the units of the rig's motion (`rig.core.sample.unit_of`). Each log contains
a protocol: a new key needs a default, or older logs cannot be read.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Ge, Gt, Le, MinLen

from rig.core.quantity import STRICT, Quantity
from rig.session.search._catching import MOST_SHARE

Setting = bool | int | float | str

RuleName = Literal["ascending", "staircase", "interleaved", "psi", "grid"]

# Values of `study.blind` with which the operator must not see the wall.
BLINDED = ("both", "operator")

Band = tuple[float, ...]  # least and most; empty: anything


@dataclass(frozen=True, kw_only=True, slots=True)
class Study:
    """Section ``[study]``: title, rig, number and codes of participants, and who must not know the presented walls."""

    title: Annotated[str, MinLen(1), Quantity("", "title of the study, printed in the report")]
    preset: Annotated[
        str | None, MinLen(1), Quantity("", "name of a built-in rig; give this or experiment")
    ] = None
    experiment: Annotated[
        str | None, MinLen(1), Quantity("", "experiment file, relative to this file; give this or preset")
    ] = None
    changes: Annotated[
        Mapping[str, Setting], Quantity("", "changes to the experiment in all conditions, by dotted key")
    ] = field(default_factory=dict)
    seed: Annotated[
        int, Ge(0), Le(2**53 - 1), Quantity("", "seed of the order, the tracks and the catch trials")
    ] = 0
    participants: Annotated[int, Ge(1), Le(10_000), Quantity("", "number of planned participants")] = 12
    code: Annotated[
        str,
        MinLen(1),
        Quantity("", "regular expression that participants' codes must match; must not match names"),
    ] = "P[0-9]{2}"
    blind: Annotated[
        Literal["both", "operator", "participant", "none"],
        Quantity(
            "",
            "who must not see condition, stiffness and damping; operator and both hide them on the console, "
            "participant only records a promise of the operator",
        ),
    ] = "both"
    judge: Annotated[
        Literal["person", "automatic"], Quantity("", "whose verdict the search uses; both are recorded")
    ] = "person"
    criterion: Annotated[
        Literal["any", "felt", "heard"],
        Quantity(
            "",
            "ripple beyond which the automatic verdict is not stable: any, felt (velocity), heard (effort)",
        ),
    ] = "any"

    notes: Annotated[str, Quantity("", "remarks about the study; stored, but not printed")] = ""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Order:
    """Section ``[order]``: in which order a session presents the conditions, and how often it repeats them."""

    kind: Annotated[
        Literal["fixed", "randomised", "latin-square"],
        Quantity(
            "",
            "order of runs in a block: as written, random in each block, or balanced over participants (Williams)",
        ),
    ] = "latin-square"
    repeats: Annotated[int, Ge(1), Le(1000), Quantity("", "number of runs of each condition and damping")] = 1
    blocks: Annotated[
        Literal["repeat", "condition", "one"],
        Quantity(
            "",
            "contents of a block: one repeat of every run, all repeats of one condition, or the whole session",
        ),
    ] = "repeat"
    interleave: Annotated[
        bool,
        Quantity(
            "", "alternate between the runs of a block trial by trial, instead of one run after the other"
        ),
    ] = False

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Search:
    """Section ``[search]``: how the stiffest stable wall is searched: rule, its settings, levels of stiffness."""

    lowest: Annotated[float, Gt(0), Quantity("stiffness", "softest wall of the search")]
    highest: Annotated[float, Gt(0), Quantity("stiffness", "stiffest wall of the search")]
    rule: Annotated[RuleName, Quantity("", "search rule, which chooses the next wall")] = "staircase"
    step: Annotated[
        float | None, Gt(0), Quantity("stiffness", "difference between levels; give this or ratio")
    ] = None
    ratio: Annotated[
        float | None, Gt(1), Le(100), Quantity("1", "ratio between levels; give this or step")
    ] = None
    settings: Annotated[
        Mapping[str, Any],
        Quantity(
            "", "settings of the rule: repeats, stable_to_rise, start, steps, turns, most, hits, enough …"
        ),
    ] = field(default_factory=dict)
    catch_share: Annotated[
        float,
        Ge(0),
        Le(MOST_SHARE),
        Quantity(
            "1",
            "share of catch trials, with the softest or stiffest wall: they are not used for limits and "
            "show the lapse rate",
        ),
    ] = 0.0

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Condition:
    """A condition that a study compares with others: sampling scheme and other changed settings, and dampings."""

    name: Annotated[
        str, MinLen(1), Quantity("", "name in tables and figures; never shown to blinded persons")
    ]
    scheme: Annotated[
        str | None,
        MinLen(1),
        Quantity(
            "",
            "sampling and estimator, like dual:20k/2k,estimator=kalman (rig.config.schemes); default: the experiment's",
        ),
    ] = None
    damping: Annotated[
        tuple[float, ...],
        MinLen(1),
        Quantity("damping", "damping B of the wall; each value gets its own search"),
    ] = (0.0,)
    changes: Annotated[
        Mapping[str, Setting],
        Quantity("", "other changes to the experiment, by dotted key; changes of the machine need fit"),
    ] = field(default_factory=dict)
    search: Annotated[
        Search | None, Quantity("", "search settings of this condition, replacing the study's [search]")
    ] = None
    fit: Annotated[
        str,
        Quantity(
            "",
            "part that must be fitted to the rig for this condition, such as a damper: the session asks for it even if "
            "blinded; empty: no part",
        ),
    ] = ""

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """Section ``[trial]``: who hits, instructions, durations, and required ranges of impact speed and press."""

    kind: Annotated[
        Literal["human", "constant-effort"], Quantity("", "who hits: the participant, or the motor")
    ] = "human"
    baseline_s: Annotated[
        float,
        Ge(0),
        Le(60),
        Quantity("s", "duration of free space before the cue; 0 for a motor that pushes at once"),
    ] = 0.0
    foreperiod_s: Annotated[
        float,
        Ge(0),
        Le(60),
        Quantity(
            "s",
            "maximum of a random foreperiod after baseline_s, so that participants cannot anticipate the cue",
        ),
    ] = 0.0
    duration_s: Annotated[
        float | None,
        Gt(0),
        Le(600),
        Quantity(
            "s",
            "duration of the hit, or with hold_s the longest wait for contact after the cue; default: the experiment's",
        ),
    ] = None
    hold_s: Annotated[
        float | None,
        Gt(0),
        Le(600),
        Quantity(
            "s",
            "from first contact to the end of the hit; default: the hit lasts duration_s regardless of contact",
        ),
    ] = None
    impact_speed: Annotated[
        Band, Quantity("velocity", "required range of speed at first contact, as [0.2, 0.4]; default: any")
    ] = ()
    press: Annotated[
        Band,
        Quantity("effort", "required range of mean effort in the judged tail, as [0.1, 0.3]; default: any"),
    ] = ()
    outside: Annotated[
        Literal["invalid", "keep"],
        Quantity(
            "", "treatment of a trial outside one of these ranges: invalid and repeated, or kept and marked"
        ),
    ] = "invalid"
    ready_s: Annotated[
        float,
        Ge(0),
        Le(600),
        Quantity(
            "s", "planned duration from *ready?* to the start, including the text that the operator reads out"
        ),
    ] = 3.0
    verdict_s: Annotated[
        float,
        Ge(0),
        Le(600),
        Quantity("s", "planned duration from the end of a hit to the key of the verdict"),
    ] = 2.0
    fastest_verdict_s: Annotated[
        float,
        Ge(0),
        Le(10),
        Quantity(
            "s",
            "a person's verdict given sooner after the question is reported and marked too_fast; 0: no verdict is",
        ),
    ] = 0.1
    attempts: Annotated[
        int,
        Ge(1),
        Le(20),
        Quantity("", "number of invalid attempts at a trial before the operator is asked how to continue"),
    ] = 3
    unsure: Annotated[
        int,
        Ge(1),
        Le(20),
        Quantity("", "number of unsure verdicts in a row on one wall after which it counts as not stable"),
    ] = 3
    hand: Annotated[
        Literal["", "right", "left", "dominant"],
        Quantity("", "hand that holds the handle; empty: not specified"),
    ] = ""
    posture: Annotated[
        str, Quantity("", "how the participant sits and holds the handle, a sentence for the report")
    ] = ""
    masking_noise: Annotated[
        bool | None, Quantity("", "true if noise masks the sound of the motor; default: not specified")
    ] = None
    say: Annotated[str, Quantity("", "text that the operator reads to the participant before each hit")] = (
        "Push into the wall until it stops you, and stay there."
    )

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Practice:
    """Section ``[practice]``: trials before the first block, which are not evaluated."""

    stiffness: Annotated[
        tuple[float, ...], Quantity("stiffness", "stiffness of the practice trials, in this order")
    ] = ()
    condition: Annotated[str | None, Quantity("", "condition of the practice trials; default: the first")] = (
        None
    )

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Rest:
    """Section ``[rest]``: rests of the hand and cooling pauses of the motor."""

    every: Annotated[
        int, Ge(0), Le(10_000), Quantity("", "number of trials between two rests; 0: no rests")
    ] = 0
    seconds: Annotated[float, Ge(0), Le(3600), Quantity("s", "duration of such a rest")] = 60.0
    between_blocks_s: Annotated[
        float, Ge(0), Le(3600), Quantity("s", "rest after each block except the last")
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
    """Section ``[caps]``: limits, such as stiffness and energy, that no trial of a study may exceed."""

    stiffness: Annotated[
        float | None,
        Gt(0),
        Quantity("stiffness", "stiffest allowed wall; default: limited only by the plan's checks"),
    ] = None
    effort: Annotated[float | None, Gt(0), Quantity("effort", "over rig.limits.effort")] = None
    speed: Annotated[float | None, Gt(0), Quantity("velocity", "over rig.limits.speed")] = None
    energy: Annotated[
        float | None,
        Gt(0),
        Quantity("J", "energy that the motor may give to the hand in a hit; replaces rig.limits.energy"),
    ] = None

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Stop:
    """Section ``[stop]``: rules that end a session early."""

    trials: Annotated[int | None, Ge(1), Le(100_000), Quantity("", "end after this number of trials")] = None
    minutes: Annotated[
        float | None, Gt(0), Le(1440), Quantity("min", "end after this time, including rests")
    ] = None
    invalid: Annotated[
        int | None,
        Ge(1),
        Le(1000),
        Quantity(
            "",
            "end after this number of invalid trials in a row, not counting those caused by the computer or link",
        ),
    ] = None
    machine: Annotated[
        int,
        Ge(1),
        Le(1000),
        Quantity(
            "", "pause (not end) after this number of trials in a row made invalid by gaps or late ticks"
        ),
    ] = 5
    aborts: Annotated[
        int | None,
        Ge(1),
        Le(1000),
        Quantity("", "end after this number of hits in a row that were cut off for safety"),
    ] = None

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Item:
    """A question of the questionnaire."""

    name: Annotated[str, MinLen(1), Quantity("", "name of the table's column; letters, digits, underscores")]
    text: Annotated[str, MinLen(1), Quantity("", "text of the question")]
    when: Annotated[
        Literal["start", "block", "end"],
        Quantity("", "asked before the first block, after each block, or at the end"),
    ] = "end"
    kind: Annotated[Literal["scale", "choice", "text"], Quantity("", "kind of answer")] = "scale"
    lowest: Annotated[int, Quantity("", "lower end of a scale")] = 1
    highest: Annotated[int, Quantity("", "upper end of a scale")] = 7
    choices: Annotated[tuple[str, ...], Quantity("", "answers of a choice")] = ()

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Keys:
    """Section ``[keys]``: keys of the keyboard with which the operator controls a session, also for a foot pedal."""

    stable: Annotated[str, MinLen(1), Quantity("", "verdict: stable")] = "1"
    buzz: Annotated[str, MinLen(1), Quantity("", "verdict: buzz")] = "2"
    unstable: Annotated[str, MinLen(1), Quantity("", "verdict: unstable")] = "3"
    unsure: Annotated[str, MinLen(1), Quantity("", "verdict: unsure")] = "4"
    go: Annotated[str, MinLen(1), Quantity("", "continue; the Enter key does the same")] = "g"
    redo: Annotated[str, MinLen(1), Quantity("", "discard the last trial and repeat it")] = "r"
    pause: Annotated[str, MinLen(1), Quantity("", "pause before the next trial")] = "p"
    note: Annotated[str, MinLen(1), Quantity("", "write a note into the log")] = "n"
    skip: Annotated[str, MinLen(1), Quantity("", "end this run without a limit")] = "s"
    abort: Annotated[str, MinLen(1), Quantity("", "leave the session; it can be resumed")] = "a"
    bell: Annotated[bool, Quantity("", "ring the bell when the participant may begin")] = True

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Protocol:
    """Complete and checked protocol of a study."""

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
        """Return the condition with this name; raise `KeyError` if it is missing."""
        for condition in self.condition:
            if condition.name == name:
                return condition
        raise KeyError(name)

    def search_of(self, condition: Condition) -> Search:
        """Return how the stiffest stable wall of a condition is searched: its own settings, or those of the study."""
        return condition.search or self.search
