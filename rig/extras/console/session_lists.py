"""List the sessions that a page may begin or resume: from the working directory, and from the templates.

`errand_worker` and the job `session` call it. It must not write into a session.
"""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from rig.config.checked import read_toml
from rig.core.errors import RigError
from rig.session.conducting import LOG, REHEARSALS, SESSIONS, read_person, session_state, took_place
from rig.session.protocols import template_names, template_path, template_subject

MOST = 100  # protocol files, and sessions that may be resumed, in one list


def list_sessions() -> dict[str, Any]:
    """Return ``protocols``, with which a user can begin a session, and ``resumable``, the interrupted sessions."""
    return {"protocols": protocols(), "resumable": resumable()}


def describe_resumption(directory: str) -> dict[str, Any]:
    """Return from a session's log what is needed to resume it: rehearsal or not, the device's URL, real time or not."""
    place = took_place(Path(directory))
    return {
        "rehearsed": read_person(Path(directory)) is not None,
        "url": place.url or "",
        "realtime": place.realtime,
    }


def protocols() -> list[dict[str, str]]:
    """Return name and title of each protocol file in the working directory and of each protocol template."""
    found = []
    for path in sorted(Path().glob("*.toml"))[:MOST]:
        with suppress(RigError):
            table = read_toml(path, "a protocol")
            if "study" in table and "condition" in table:
                title = table["study"].get("title") if isinstance(table["study"], dict) else None
                found.append({"name": str(path), "about": str(title or "")})
    return found + [{"name": name, "about": template_subject(name)} for name in template_names()]


def resumable() -> list[dict[str, Any]]:
    """Return the unfinished sessions below the working directory, newest first.

    Each has directory, participant's code, title, number of trials, why it stopped, and if it is a rehearsal.
    """
    return [session for log in _logs()[:MOST] if (session := _describe_unfinished(log)) is not None]


def protocol_file(name: str) -> Path:
    """Return the path of the protocol template `name`, or `name` as a path if there is no such template."""
    if name in template_names():
        return template_path(name)
    return Path(name)


def _logs() -> list[Path]:
    def found() -> Iterator[tuple[float, Path]]:
        for place in (SESSIONS, REHEARSALS):
            for log in place.glob(f"*/*/{LOG}"):
                with suppress(OSError):
                    yield log.stat().st_mtime, log

    return [log for _, log in sorted(found(), reverse=True)]


def _describe_unfinished(log: Path) -> dict[str, Any] | None:
    with suppress(RigError):
        state, events = session_state(log.parent)
        if state.ended is None:
            return {
                "directory": str(log.parent),
                "code": state.code,
                "title": state.protocol.study.title,
                "trials": len(state.trials),
                "stopped": state.stopped or "",
                "rehearsal": bool(events[0].content.get("rehearsal")),
            }
    return None
