"""Compare the protocols of a study's sessions key by key, and decide which differences can affect a result.

A session compares its protocol with the earlier sessions before it begins; an analysis compares all sessions. Both use
these functions, so an analysis accepts every session that was allowed to begin.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig import config
from rig.config.checked import flatten
from rig.core.check import Check, Outcome
from rig.core.errors import ConfigError, RigError
from rig.session.engine._log import Event, read
from rig.session.engine._state import SessionState
from rig.session.planning._conditions import ReachFor, Walls
from rig.session.planning._load import as_mapping, protocol_from_mapping
from rig.session.planning._names import directory_name
from rig.session.planning._protocol import Protocol

LOG = "session.log"
TITLE = "study.title"
# Keys, and sections of keys, that decide neither a verdict nor what is compared: wording, names of files (what they
# contain is compared), plans, and how a session is conducted.
NEUTRAL = (
    *(TITLE, "study.participants", "study.code", "study.notes", "study.preset", "study.experiment"),
    *("trial.say", "trial.ready_s", "trial.verdict_s", "trial.fastest_verdict_s", "trial.attempts"),
    *("keys", "question", "rest", "stop", "practice"),
    *("experiment.rig.description", "experiment.rig.source", "experiment.excitation"),
    # the protocol replaces them
    *("experiment.wall.stiffness", "experiment.wall.damping", "experiment.trial.seed"),
)
_LONGEST_VALUE = 60  # characters of a value in a message
_LISTED = 5  # names in a message


@dataclass(frozen=True, slots=True)
class Difference:
    """A key in which the protocols of sessions differ, with each participant's value (None if missing)."""

    key: str
    values: Mapping[str, Any]

    @property
    def is_neutral(self) -> bool:
        """True if a difference in this key of the protocol cannot affect the results of a study."""
        return is_within(self.key, NEUTRAL)

    @property
    def usual(self) -> Any:
        """Most frequent value of the key in the protocols of all participants; of equals, the first."""
        texts = {code: json.dumps(value, sort_keys=True) for code, value in self.values.items()}
        (most, _), *_ = Counter(texts.values()).most_common(1)
        return next(self.values[code] for code, text in texts.items() if text == most)

    @property
    def sentence(self) -> str:
        """Text with the protocol's key, its values, and the participants who have each value."""
        texts = {code: value_words(value) for code, value in self.values.items()}
        each = (
            f"{text}: {list_names([code for code, theirs in texts.items() if theirs == text])}"
            for text in dict.fromkeys(texts.values())
        )
        return f"{self.key} ({'; '.join(each)})"


def is_within(key: str, keys: Iterable[str]) -> bool:
    """Return True if a dotted key, e.g. "trial.say", is in `keys`, or belongs to a section in `keys`, e.g. "trial"."""
    return any(key == one or key.startswith(f"{one}.") for one in keys)


def value_words(value: Any) -> str:
    """Return the value of a setting as text for a message, shortened if it is long; "not given" for None."""
    text = "not given" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONGEST_VALUE else f"{text[: _LONGEST_VALUE - 1]}…"


def list_names(names: Sequence[str]) -> str:
    """Return the first five names as text, with the number of the remaining names."""
    more = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def walls_in(state: SessionState, reach_for: ReachFor | None = None) -> Walls:
    """Return the walls of a session as experiments, from its log.

    `reach_for` computes how long a simulated hand moves to the wall; None if no hand is simulated.
    """
    base = config.experiment_from_mapping(state.experiment, "the experiment in the session's log")
    return Walls(state.protocol, base, reach_for)


def settings_of(protocol: Protocol, experiment: Mapping[str, Any]) -> dict[str, Any]:
    """Return the value of every dotted key of a protocol, and of its experiment (``experiment.…``), as JSON types.

    Keys of conditions and questions contain their names; the key ``condition`` has the names of conditions in order.
    """
    table = as_mapping(protocol)
    names = [one["name"] for one in table["condition"]]
    table["condition"] = {one["name"]: one for one in table["condition"]}
    table["question"] = {one["name"]: one for one in table["question"]}
    plain = json.loads(json.dumps({**table, "experiment": experiment}))
    return {"condition": names, **{key: value for key, value in flatten(plain) if value != {}}}


def differences(settings: Mapping[str, Mapping[str, Any]]) -> list[Difference]:
    """Return the keys in which the protocols of participants differ.

    `settings` contains the values of all keys, by the participant's code.
    """
    keys = dict.fromkeys(key for of in settings.values() for key in of)
    each = [Difference(key, {code: of.get(key) for code, of in settings.items()}) for key in keys]
    return [one for one in each if any(value != one.usual for value in one.values.values())]


def changed_keys(walls: Walls, study: Path, code: str = "") -> list[Difference]:
    """Return the keys in which a protocol differs from the sessions in a study's directory; [] without sessions.

    The values of this protocol have the name "here" in place of a participant's code. Sessions without a trial, the
    session of `code`, and sessions that cannot be read are ignored; the later analysis rejects sessions that cannot be
    read.
    """
    there = _settings_there(study, code)
    here = settings_of(walls.protocol, config.as_mapping(walls.base))
    return differences({**there, "here": here}) if there else []


def deciding(changes: Iterable[Difference], study: Path) -> list[Difference]:
    """Return the differences between protocols that can affect the results of a study.

    A changed title is also returned if the directory `study` is named after one of the titles.
    """

    def shares_a_directory(one: Difference) -> bool:
        return one.key == TITLE and study.name in {directory_name(title) for title in one.values.values()}

    return [one for one in changes if not one.is_neutral or shares_a_directory(one)]


def refuse_changed(changes: Sequence[Difference], study: Path) -> None:
    """Raise `ChangedProtocolError` if a difference between protocols can affect the results of the study."""
    found = deciding(changes, study)
    if found:
        raise ChangedProtocolError(_sentence(found, study), remedy=_remedy(found))


def protocol_check(walls: Walls, study: Path) -> Iterable[Check]:
    """Yield a check that compares a protocol with the sessions in a study's directory; nothing without sessions."""
    changes = changed_keys(walls, study)
    found = deciding(changes, study)
    if found:
        yield Check("protocol", Outcome.WARNING, _sentence(found, study), _remedy(found))
    elif changes:
        keys = list_names([one.key for one in changes])
        yield Check(
            "protocol",
            Outcome.OK,
            f"equal to that of the sessions in {study} except {keys}, which do not affect results",
        )
    elif _settings_there(study, ""):
        yield Check("protocol", Outcome.OK, f"equal to that of the sessions in {study}")


class ChangedProtocolError(ConfigError):
    """The protocol differs from the protocol of the study's earlier sessions."""


def _sentence(found: Sequence[Difference], study: Path) -> str:
    return f"the protocol differs from that of the sessions in {study}: {'; '.join(one.sentence for one in found)}"


def _remedy(found: Sequence[Difference]) -> str:
    across = " ".join(f"`across` {one.key}" for one in found if not one.is_neutral)
    analysed = f"; the analysis then needs {across}" if across else ""
    return (
        "restore these keys, or begin another study (study.title, or `study` DIR); to continue here nevertheless, give "
        f"`other_protocol`{analysed}"
    )


def _settings_there(study: Path, code: str) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for path in sorted(study.glob(f"*/{LOG}")):
        if path.parent.name != code:
            try:
                found |= _read_settings(read(path))
            except (RigError, KeyError, TypeError, ValueError):
                # Another version's or a damaged log of another participant must not stop this session.
                continue
    return found


def _read_settings(events: Sequence[Event]) -> dict[str, dict[str, Any]]:
    if not any(event.kind == "trial" for event in events):
        return {}
    began = events[0].content
    protocol = protocol_from_mapping(began["protocol"], "the protocol in the session's log")
    return {began["code"]: settings_of(protocol, began["experiment"])}
