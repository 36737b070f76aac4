"""Check rules that relate several keys of a protocol; each function yields the problems that it finds.

The protocol must already have valid types and ranges. No experiment is needed. `rig.session.planning._load` calls them.
"""

from __future__ import annotations

import inspect
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from itertools import islice
from typing import Any

from rig.config import shown
from rig.config.checked import Problem, did_you_mean
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.session import search
from rig.session.planning._bands import BANDS
from rig.session.planning._keymap import KeyMap
from rig.session.planning._protocol import Protocol, Search
from rig.session.planning._schedule import level_steps, rule

MOST_LEVELS = 400
MOST_RUNS = 10_000
MOST_STEPS_OF_A_SCALE = 100
# Keys of mechanical or electrical parts: only a person can change these on a rig, not a command.
MACHINE = ("rig.mechanics.", "rig.amplifier.", "rig.encoder.")
# A pattern of codes must match none of these: names of people, a path, and the empty code.
REFUSED_CODES = ("Anna", "Li Wei", "Jean-Paul", "Müller", "anna.k", "a.k@lab.org", "../anna", "")
FIRST_NAMES = ("anna", "Anna", "ANNA", "AnnaSchmidt")
# Stand for names of any length: two letters are initials, and a pattern for names of 16 letters matches shorter ones.
LETTER_WORDS = tuple(word for n in range(3, 17) for word in ("a" * n, "A" * n, "A" + "a" * (n - 1)))
# Prefixes and suffixes that such a pattern may require around a name.
BEFORE = ("", "P", "P-", "P01", "P01-", "P01_", "1", "01", "01-", "01_")
AFTER = ("", "1", "-1", "01", "-01", "_01", "85", "001", "1985")
_THREE_LETTERS = re.compile(r"[^\W\d_]{3,}")
# The parts of a pattern that are not literal text: escapes, character classes, heads of groups.
_NO_TEXT = re.compile(r"\\.|\[\^?\]?(?:\\.|[^\]\\])*\]|\(\?(?:P?<\w+>|P=\w+|[a-zA-Z-]*:?)")


def broken_rules(protocol: Protocol) -> list[Problem]:
    """Return the problems of a protocol in rules that relate several keys, e.g. a lowest level above the highest."""
    return [problem for rule_between in RULES for problem in rule_between(protocol)]


def looks_like_a_name(code: str) -> bool:
    """Return True if a participant's code has more than two letters and nothing else, as a person's name would."""
    letters = [character for character in code if character not in "-_.'"]
    return len(letters) > 2 and all(character.isalpha() for character in letters)


def spells_a_name(code: str, pattern: str) -> bool:
    """Return True if a code has three letters in a row that its pattern does not prescribe.

    The pattern SUB[0-9]{2} prescribes the letters SUB.
    """
    prescribed = sorted(_THREE_LETTERS.findall(_NO_TEXT.sub(" ", pattern)), key=len, reverse=True)
    remaining = (
        re.sub("|".join(map(re.escape, prescribed)), " ", code, flags=re.IGNORECASE) if prescribed else code
    )
    return _THREE_LETTERS.search(remaining) is not None


# Every log of a study has its protocol with it, which is checked whenever the log is read.
@lru_cache(maxsize=64)
def _find_names(pattern: str) -> tuple[str, ...]:
    return tuple(islice(_iterate_names(re.compile(pattern)), 3))


def _iterate_names(compiled: re.Pattern[str]) -> Iterator[str]:
    begins = re.match(r"[\w-]*", compiled.pattern)
    before = dict.fromkeys((*BEFORE, begins[0] if begins else ""))
    yield from (code for code in REFUSED_CODES if compiled.fullmatch(code))
    for words, always in ((FIRST_NAMES, True), (LETTER_WORDS, False)):
        for code in (f"{first}{word}{last}" for word in words for first in before for last in AFTER):
            if compiled.fullmatch(code) and (always or spells_a_name(code, compiled.pattern)):
                yield code


def rig_of(protocol: Protocol) -> Iterator[Problem]:
    """Yield a problem unless the protocol names either a preset or an experiment file."""
    study = protocol.study
    if (study.preset is None) == (study.experiment is None):
        yield Problem(
            "study.preset",
            "" if study.preset is None else shown(study.preset),
            (
                "is missing, and so is study.experiment: one of the two must name the rig"
                if study.preset is None
                else "must not be given beside study.experiment: only one of the two may name the rig"
            ),
            "name a preset, or an experiment file",
        )


def codes(protocol: Protocol) -> Iterator[Problem]:
    """Yield a problem if the pattern of participants' codes is not a valid pattern, or matches first names."""
    pattern = protocol.study.code
    try:
        taken = _find_names(pattern)
    except (re.error, OverflowError, RecursionError) as error:
        yield Problem(
            "study.code",
            shown(pattern),
            f"is not a regular expression: {error}",
            'write one like "P[0-9]{2}"',
        )
        return
    if taken:
        yield Problem(
            "study.code",
            shown(pattern),
            f"matches {' and '.join(map(repr, taken))}, and so could match names of people",
            'require a number, as in "P[0-9]{2}"',
        )


def conditions(protocol: Protocol) -> Iterator[Problem]:
    """Yield problems of the conditions: none defined, equal names, and invalid dampings or sampling schemes."""
    if not protocol.condition:
        yield Problem(
            "[[condition]]",
            "",
            "is missing: a study needs at least one condition",
            "add one, with a name and a scheme",
        )
    yield from _names_twice("condition.name", [one.name for one in protocol.condition])
    for number, one in enumerate(protocol.condition, 1):
        key = f"condition {number}.damping"
        if min(one.damping) < 0:
            yield Problem(
                key, shown(one.damping), "must not contain a damping below 0", "remove the negative values"
            )
        for damping in _twice(one.damping):
            yield Problem(key, shown(one.damping), f"contains {damping:g} more than once", "write it once")
        if one.scheme is not None:
            yield from _scheme(f"condition {number}.scheme", one.scheme)


def fits(protocol: Protocol) -> Iterator[Problem]:
    """Yield problems of conditions for which a person must fit a mechanical part to the rig between blocks (`fit`)."""
    blocks = protocol.order.blocks
    if len({one.fit for one in protocol.condition}) > 1 and blocks != "condition":
        must = 'must be "condition" where conditions differ in fit: the rig is not refitted within a block'
        yield Problem("order.blocks", shown(blocks), must, 'write blocks = "condition"')
    for number, one in enumerate(protocol.condition, 1):
        for key, value in one.changes.items():
            if key.startswith(MACHINE) and not one.fit:
                must = f"changes the machine, but condition {number}.fit does not say which part has to be fitted"
                instead = 'set it, for example fit = "the damper"; changes of all conditions belong to study.changes'
                yield Problem(f"condition {number}.changes.{key}", shown(value), must, instead)


def _scheme(key: str, text: str) -> Iterator[Problem]:
    try:
        Scheme.parse(text)
    except ConfigError as error:
        yield Problem(key, shown(text), f"is not a scheme: {error.message}", error.remedy)


def searches(protocol: Protocol) -> Iterator[Problem]:
    """Yield problems of searches for the stiffest stable wall: invalid levels, or settings unknown to their rule."""
    own = [(f"condition {n}.search", one.search) for n, one in enumerate(protocol.condition, 1)]
    for key, wanted in [("search", protocol.search), *own]:
        if wanted is not None:
            yield from _levels(key, wanted)


def _levels(key: str, wanted: Search) -> list[Problem]:
    if wanted.lowest >= wanted.highest:
        must = f"must be below {key}.highest, {wanted.highest:g}"
        return [Problem(f"{key}.lowest", f"{wanted.lowest:g}", must, "swap lowest and highest")]
    if (wanted.step is None) == (wanted.ratio is None):
        must = (
            f"is missing, and so is {key}.ratio: one of the two must give the distance between levels"
            if wanted.step is None
            else f"must not be given beside {key}.ratio = {wanted.ratio:g}: only one of the two may give the distance"
        )
        given = "" if wanted.step is None else f"{wanted.step:g}"
        return [
            Problem(f"{key}.step", given, must, "give either the step or the ratio of neighbouring levels")
        ]
    steps = level_steps(wanted)
    if not 1 <= steps < MOST_LEVELS:
        name = "step" if wanted.step is not None else "ratio"
        return [
            Problem(
                f"{key}.{name}",
                f"{getattr(wanted, name):g}",
                f"makes {steps + 1} levels from {wanted.lowest:g} to {wanted.highest:g}, allowed 2 to {MOST_LEVELS}",
                f"choose a {'larger' if steps >= MOST_LEVELS else 'smaller'} {name}",
            )
        ]
    wrong = [_wrong_setting(key, wanted, name) for name in wanted.settings]
    return [problem for problem in wrong if problem] or _refused_settings(key, wanted)


def _wrong_setting(key: str, wanted: Search, name: str) -> Problem | None:
    settings = settings_of(wanted.rule)
    known = list(settings)
    key, value = f"{key}.settings.{name}", wanted.settings[name]
    if name in ("levels", "seed"):
        instead = "set levels by lowest, highest and step or ratio, and the seed by study.seed"
        return Problem(key, shown(value), f"is not a setting of the rule {wanted.rule}", instead)
    if name not in known:
        instead = did_you_mean(name, known, f"choose one of: {', '.join(known)}")
        return Problem(key, shown(value), f"is not a setting of the rule {wanted.rule}", instead)
    must, fits, _ = _TYPES[str(settings[name].annotation)]
    return None if fits(value) else Problem(key, shown(value), f"must be {must}", "write it without quotes")


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _number(value: Any) -> bool:
    return _whole(value) or (isinstance(value, float) and math.isfinite(value))


# For each type annotation of a setting in `rig.session.search`: its name in messages, a check, and its JSON schema.
_TYPES: dict[str, tuple[str, Callable[[Any], bool], dict[str, Any]]] = {
    "int": ("a whole number", _whole, {"type": "integer"}),
    "float": ("a number", _number, {"type": "number"}),
    "float | None": ("a number", _number, {"type": "number"}),
    "Sequence[int]": (
        "a list of whole numbers",
        lambda value: isinstance(value, list | tuple) and all(map(_whole, value)),
        {"type": "array", "items": {"type": "integer"}},
    ),
}


def settings_of(name: str) -> dict[str, inspect.Parameter]:
    """Return the settings that a protocol may give to a search rule such as "staircase", by name."""
    parameters = inspect.signature(search.RULES[name]).parameters
    return {key: one for key, one in parameters.items() if key not in ("levels", "seed")}


def settings_schema(name: str) -> dict[str, Any]:
    """Return the JSON schema of the settings of a search rule such as "staircase", with texts from its docstring."""
    # A rule may leave a shared setting to the docstring of another rule; its own text replaces the others'.
    meanings: dict[str, str] = {}
    for one in (*search.RULES.values(), search.RULES[name]):
        meanings |= _meanings(inspect.getdoc(one) or "")
    properties = {}
    for key, setting in settings_of(name).items():
        properties[key] = {**_TYPES[str(setting.annotation)][2], "description": meanings.get(key, "")}
        if setting.default not in (None, inspect.Parameter.empty):
            default = setting.default
            properties[key]["default"] = list(default) if isinstance(default, tuple) else default
    return {"type": "object", "additionalProperties": False, "properties": properties}


def _meanings(documentation: str) -> dict[str, str]:
    """Return the text of each parameter in a docstring in numpy's style, in one line."""
    found: dict[str, str] = {}
    names: list[str] = []
    for line in documentation.splitlines():
        if line.startswith(" ") and names:
            found |= {name: f"{found.get(name, '')} {line.strip()}".strip() for name in names}
        else:
            names = [name.strip() for name in line.split(",")]
    return found


def _refused_settings(key: str, wanted: Search) -> list[Problem]:
    try:
        rule(wanted, 0)
    except ConfigError as error:
        return [
            Problem(
                f"{key}.settings",
                "",
                f"are not valid for the rule {wanted.rule}: {error.message}",
                error.remedy,
            )
        ]
    return []


def runs(protocol: Protocol) -> Iterator[Problem]:
    """Yield a problem if conditions × dampings × repeats give more searches than a session can have."""
    cells = sum(len(one.damping) for one in protocol.condition)
    if cells * protocol.order.repeats > MOST_RUNS:
        yield Problem(
            "order.repeats",
            f"{protocol.order.repeats}",
            f"makes {cells * protocol.order.repeats} runs with {cells} pairs of condition and damping; "
            f"allowed are at most {MOST_RUNS}",
            "repeat less",
        )


def stiffness_cap(protocol: Protocol) -> Iterator[Problem]:
    """Yield problems of searched and practice walls that are stiffer than allowed (``caps.stiffness``)."""
    cap = protocol.caps.stiffness
    own = [(f"condition {n}.search", one.search) for n, one in enumerate(protocol.condition, 1)]
    for key, wanted in [("search", protocol.search), *own]:
        if wanted is not None and cap is not None and wanted.highest > cap:
            must = f"must be at most caps.stiffness, {cap:g}"
            yield Problem(
                f"{key}.highest", f"{wanted.highest:g}", must, f"lower {key}.highest, or raise caps.stiffness"
            )
    walls = protocol.practice.stiffness
    if walls and min(walls) <= 0:
        yield Problem(
            "practice.stiffness",
            shown(walls),
            "must be above 0",
            "a wall of stiffness 0 does not stop the handle",
        )
    if cap is not None and walls and max(walls) > cap:
        must = f"must be at most caps.stiffness, {cap:g}"
        yield Problem("practice.stiffness", shown(walls), must, "use softer walls for practice")


def practice(protocol: Protocol) -> Iterator[Problem]:
    """Yield a problem if the condition of the practice trials does not exist."""
    names = [one.name for one in protocol.condition]
    wanted = protocol.practice.condition
    if wanted is not None and wanted not in names:
        instead = did_you_mean(wanted, names, f"choose one of: {', '.join(map(shown, names))}")
        yield Problem("practice.condition", shown(wanted), "is not a condition", instead)


def bands(protocol: Protocol) -> Iterator[Problem]:
    """Yield problems of required ranges (impact speed, press) that are not ascending, or in trials without a hand."""
    for name in BANDS:
        key, band = f"trial.{name}", getattr(protocol.trial, name)
        if band and protocol.trial.kind != "human":
            must = f'applies to a hand, but the motor hits (trial.kind = "{protocol.trial.kind}")'
            yield Problem(key, shown(band), must, 'omit it, or set trial.kind = "human"')
        elif band and not (len(band) == 2 and 0.0 <= band[0] < band[1]):
            yield Problem(
                key,
                shown(band),
                "must be two numbers not below 0, the lower first",
                "write it like [0.1, 0.3]",
            )


def items(protocol: Protocol) -> Iterator[Problem]:
    """Yield problems of questions that cannot be answered, or whose names cannot name a column of a table."""
    yield from _names_twice("question.name", [item.name for item in protocol.question])
    for number, item in enumerate(protocol.question, 1):
        key = f"question {number}"
        if re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", item.name) is None:
            must = "must be a letter, then letters, digits and underscores: it names a column"
            yield Problem(f"{key}.name", shown(item.name), must, 'write one like "felt_tired"')
        if item.kind == "scale" and not 1 <= item.highest - item.lowest <= MOST_STEPS_OF_A_SCALE:
            must = f"must be 1 to {MOST_STEPS_OF_A_SCALE} above lowest, {item.lowest}"
            yield Problem(f"{key}.highest", f"{item.highest}", must, "change highest or lowest of the scale")
        if item.kind == "choice" and len(set(item.choices)) < max(2, len(item.choices)):
            must = "must be two or more different answers"
            yield Problem(f"{key}.choices", shown(item.choices), must, 'write them like ["yes", "no"]')
        places = {str(place): choice for place, choice in enumerate(item.choices, 1)}
        if item.kind == "choice" and any(places.get(choice, choice) != choice for choice in item.choices):
            must = "must not contain the number of another choice: participants answer with these numbers"
            yield Problem(f"{key}.choices", shown(item.choices), must, 'use words, or kind = "scale"')
        if item.kind != "choice" and item.choices:
            must = f'is not used by a question of kind = "{item.kind}"'
            yield Problem(f"{key}.choices", shown(item.choices), must, 'set kind = "choice", or omit it')


def console_keys(protocol: Protocol) -> Iterator[Problem]:
    """Yield problems of keyboard keys that are not valid or have two meanings."""
    try:
        KeyMap.of(protocol.keys)
    except ConfigError as error:
        yield Problem("keys", "", error.message, error.remedy)


RULES: tuple[Callable[[Protocol], Iterable[Problem]], ...] = (
    rig_of,
    codes,
    conditions,
    fits,
    searches,
    runs,
    stiffness_cap,
    practice,
    bands,
    items,
    console_keys,
)


def _names_twice(key: str, names: list[str]) -> Iterator[Problem]:
    for name in _twice(name.casefold() for name in names):
        written = dict.fromkeys(shown(one) for one in names if one.casefold() == name)
        yield Problem(key, " and ".join(written), "is used more than once", "give each its own name")


def _twice(values: Iterable[Any]) -> list[Any]:
    return [value for value, times in Counter(values).items() if times > 1]
