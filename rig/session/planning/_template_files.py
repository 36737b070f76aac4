"""Access to the protocol templates of this package: commented protocol files that pass the check.

`rig session new` uses it.
"""

import json
from functools import cache
from importlib.resources import files
from pathlib import Path

from rig.config.checked import did_you_mean
from rig.core.errors import ConfigError, RecordingError
from rig.recording.files import plain_errors
from rig.session.planning._load import json_schema

# A session of some minutes at a rate that a simulated rig reaches in real time.
DEFAULT = "first-steps"
# Name of the JSON schema beside a protocol; the protocol's first line refers to it.
SCHEMA = "haptic-rig-protocol.schema.json"


@cache
def template_names() -> tuple[str, ...]:
    """Return the names of the built-in protocol templates."""
    found = (files("rig.session") / "templates").iterdir()
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in found if entry.name.endswith(".toml")))


def template_text(name: str) -> str:
    """Return the text of a protocol template; raise `ConfigError` for an unknown name."""
    if name not in template_names():
        choice = did_you_mean(name, template_names(), f"choose one of: {', '.join(template_names())}")
        raise ConfigError(f"unknown template {name!r}", remedy=choice)
    return (files("rig.session") / "templates" / f"{name}.toml").read_text(encoding="utf-8")


def template_path(name: str) -> Path:
    """Return the path of a protocol template's file, which is not checked for existence."""
    return Path(str(files("rig.session") / "templates" / f"{name}.toml"))


def template_subject(name: str) -> str:
    """Return the subject of a protocol template: its first line. Raise `ConfigError` for an unknown name."""
    return template_text(name).partition("\n")[0].removeprefix("# ")


def write_template(name: str, path: Path) -> Path | None:
    """Write a protocol template to a new file, and next to it the JSON schema with which editors complete and check it.

    Return the path of the schema, or None if a schema existed, which is never overwritten. Raise `ConfigError` for an
    unknown name, and `RecordingError` if the file `path` exists or writing fails.
    """
    if path.exists():
        raise RecordingError(
            f"cannot write {path}: the file exists, and a protocol is never overwritten",
            remedy="give another file name",
        )
    text = f"#:schema ./{SCHEMA}\n{template_text(name)}"
    with plain_errors("write", path), path.open("x", encoding="utf-8") as file:
        file.write(text)
    beside = path.parent / SCHEMA
    with plain_errors("write", beside):
        try:
            with beside.open("x", encoding="utf-8") as file:
                json.dump(json_schema(), file, indent=1, ensure_ascii=False)
                file.write("\n")
        except FileExistsError:
            # An earlier template left its schema, or its user changed it: it stays.
            return None
    return beside
