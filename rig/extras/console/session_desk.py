"""The job `session`: a participant's session, or a rehearsal, that is operated from a page.

The session engine runs in the job's process, with a *desk*, which exchanges questions and answers with the operator.
The server (`rig.extras.console.sessions`) renders the pages and interprets keys. Besides the messages of every job
(`rig.extras.console.worker`) the two processes exchange:

* to the server: ``setup`` (process id, meaning of keys, hand), ``view`` (console state), ``ask`` (number, question)
* to the job: ``reply`` (number, action, value, time since the question was shown), ``stop``
"""

import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rig import config
from rig.core.errors import ConfigError, StoppedError
from rig.extras.console.hits import short
from rig.extras.console.session_lists import protocol_file
from rig.extras.console.talk import Talk
from rig.recording.canonical import canonical_json
from rig.session import conducting
from rig.session.conducting import LOG, Desk, DeviceRunner, Person, TrialRunner, read, thresholds_of
from rig.session.page import SILENCE_S, AskingDesk, HandKind, KeyMap, full_press, keymap_for, refuse_a_hand
from rig.session.protocols import Protocol, as_mapping, load_walls

REMEDY = "continue with `rig session resume`, or on the page"


class PageDesk(AskingDesk):
    """Connection of a session to its operator, who uses a page of the console, through the messages of `talk`.

    `keymap` is the meaning of each key, from the study's protocol. `hand` is the device that moves the simulated hand
    on the page (mouse or keyboard), and its press (N); None if the hand moves by itself. After `silence_s` (s) without
    a message from the console during a hit, the hit is stopped.
    """

    def __init__(
        self,
        talk: Talk,
        keymap: KeyMap,
        hand: tuple[HandKind, float] | None = None,
        *,
        silence_s: float = SILENCE_S,
    ) -> None:
        super().__init__()
        self._talk, self._silence_s = talk, silence_s
        moved = None if hand is None else {"kind": hand[0], "press": hand[1]}
        talk.tell("setup", pid=os.getpid(), keys=keymap, hand=moved)

    def _send(self, kind: str, **content: Any) -> None:
        self._talk.tell(kind, **content)

    def _take(self, patience_s: float) -> Any:
        return self._talk.hear(patience_s)

    def _check_there(self) -> None:
        if self._talk.silent_s > self._silence_s:
            raise StoppedError(
                f"no message from the console for {self._silence_s:g} s during a hit; the effort is zero",
                remedy=REMEDY,
            )


def digest_of(protocol: str, directory: str) -> str:
    """Return a short digest of protocol and experiment, from the name or file `protocol`.

    If `directory` is not empty, use protocol and experiment in the log of the session there instead.
    """
    if directory:
        began = read(Path(directory) / LOG)[0].content
        return short(canonical_json([began["protocol"], began["experiment"]]))
    walls = load_walls(protocol_file(protocol))
    return short(canonical_json([as_mapping(walls.protocol), config.as_mapping(walls.base)]))


def session(content: Mapping[str, Any], talk: Talk) -> dict[str, Any]:
    """Run or resume a participant's session as a page requests it by `content`; `talk` connects to the page's server.

    Raise `ConfigError` if protocol or experiment have changed since a person at the rig confirmed their ``digest``.
    """
    agreed = content["digest"]
    if agreed is not None and agreed != digest_of(content["protocol"], content["directory"]):
        raise ConfigError(
            "the protocol has changed since the operator agreed to it", remedy="begin the session again"
        )
    given = content["person"]
    directory = Path(content["directory"]) if content["directory"] else None
    if directory is not None:
        person = conducting.read_person(directory)
    else:
        person = given and Person(**{**given, "thresholds": thresholds_of(given["thresholds"])})
    runner = DeviceRunner(
        url=content["url"] or None,
        realtime=content["realtime"] or person is None,
        verified=content["verified"],
        arm_anyway=content["arm_anyway"],
        lossy_anyway=content["lossy_anyway"],
    )
    if person is None:
        desk: conducting.DeskFor = partial(_at_page, talk, content["hand_kind"], Path(content["hand"]))
    else:
        desk = partial(_rehearse, talk, person)
    if directory is not None:
        result = conducting.resume_session(
            directory,
            desk,
            runner=runner,
            at=content["at"],
            marks="lsl" if content["lsl"] else None,
            other_device=content["other_device"],
        )
    else:
        result = conducting.run_session(
            protocol_file(content["protocol"]),
            content["code"],
            desk,
            runner=runner,
            study=Path(content["study"]) if content["study"] else None,
            row=content["row"],
            person=person,
            again=content["again"],
            other_protocol=content["other_protocol"],
            marks="lsl" if content["lsl"] else None,
        )
    return {"stands": result.stands, "pairs": result.pairs, "over": result.ended is not None}


def _at_page(
    talk: Talk,
    kind: HandKind | None,
    path: Path,
    protocol: Protocol,
    experiment: Mapping[str, Any],
    runner: TrialRunner,
) -> Desk:
    refuse_a_hand(kind, runner)
    hand = None if kind is None else (kind, full_press(experiment))
    desk = PageDesk(talk, keymap_for(protocol.keys, kind), hand)
    if kind is not None and isinstance(runner, DeviceRunner):
        runner.hand = path
    return desk


def _rehearse(
    talk: Talk, person: Person, protocol: Protocol, experiment: Mapping[str, Any], runner: TrialRunner
) -> Desk:
    talk.tell("setup", pid=os.getpid(), keys=KeyMap.of(protocol.keys), hand=None)
    make = conducting.rehearsal_desk(person, lambda view: talk.tell("view", view=view))
    return make(protocol, experiment, runner)
