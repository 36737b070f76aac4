"""Format the experiment file of an identification: all keys, the identified ones with interval and recordings.

`rig identify` and `rig.format_identification` use this module.
"""

from collections.abc import Mapping
from typing import Any

from rig import config
from rig.config import parameters
from rig.experiments.identification.identify import Identification


def format_identification(found: Identification) -> str:
    """Return the text of a TOML file with the identified experiment, which `rig.config.load_experiment` can read."""
    experiment = found.experiment
    where = "its simulation" if found.simulated else "the rig itself"
    lines = [
        f"# {experiment.rig.name}, identified on {where}.",
        "# Keys marked [identified] have their 95 % interval (scatter and uncertainty of friction) and the names of",
        "# their recordings. All other keys are unchanged.",
        "",
    ]
    lines += [f"# {warning}" for warning in found.warnings]
    _section(config.as_mapping(experiment), "", found, lines)
    return "\n".join(lines).rstrip() + "\n"


def _section(table: Mapping[str, Any], path: str, found: Identification, lines: list[str]) -> None:
    """Append the lines of a TOML table: first its keys, then its sub-tables."""
    leaves = {key: value for key, value in table.items() if not isinstance(value, dict)}
    if path and (leaves or not table):
        lines.append(f"[{path}]")
    for key, value in leaves.items():
        lines.append(_line(key, value, f"{path}.{key}" if path else key, found))
    if path and (leaves or not table):
        lines.append("")
    for key, value in table.items():
        if isinstance(value, dict):
            _section(value, f"{path}.{_key(key)}" if path else _key(key), found, lines)


def _line(key: str, value: Any, dotted: str, found: Identification) -> str:
    written = f"{_key(key)} = {_toml(value)}"
    if dotted in found.sources:
        return f"{written:<44} # [identified] {found.sources[dotted]}"
    known = parameters().get(dotted)
    if known is None:
        return written
    unit = known.unit_for(found.experiment.rig.motion)
    return (
        f"{written:<44} # {' '.join(word for word in (f'[{unit}]' if unit else '', known.meaning) if word)}"
    )


def _key(key: str) -> str:
    return key if key.replace("_", "").replace("-", "").isalnum() else f'"{key}"'


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        return f'"{escaped}"'
    return repr(value)
