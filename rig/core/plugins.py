"""Parts that third parties add by entry points: estimators, laws, backends. A broken one breaks nothing else.

A program can temporarily register a part of its own under a name: within this process it is then found like an
installed one.

Devices, `rig.control`, commands and `rig.experiments.lab` look parts up here. It must not import a part before that
part is asked for by name.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from rig.core.errors import ConfigError

_registered: list[
    tuple[str, str, Any]
] = []  # group, name, part; of a name that is there twice the newest one


@contextmanager
def register_temporarily(group: str, built_in: Container[str], name: str, part: Any) -> Iterator[None]:
    """Register a part by its name temporarily, in all threads; `ConfigError` if a built-in one has that name.

    Other processes, such as the workers of a cluster or a later run that resumes a map, find installed parts only.
    """
    if name in built_in:
        raise ConfigError(
            f"{name!r} is already the name of a built-in", remedy='choose another name: name="…"'
        )
    entry = (group, name, part)
    _registered.append(entry)
    try:
        yield
    finally:
        _registered[:] = [other for other in _registered if other is not entry]


def _registered_for(group: str) -> dict[str, Any]:
    return {name: part for of, name, part in list(_registered) if of == group}


def names(group: str, built_in: Container[str]) -> list[str]:
    """Return the names of the parts of a group that are no built-in ones, each once."""
    return list(
        dict.fromkeys([*_registered_for(group), *(point.name for point in find_plugins(group, built_in))])
    )


def find_plugins(group: str, built_in: Container[str]) -> list[EntryPoint]:
    """Return the plug-ins of a group by name, without those that have the name of a built-in part."""
    return [point for point in _find_plugins(entry_points, group) if point.name not in built_in]


# Cached: it reads the metadata of every installed package, some milliseconds for each scheme and each check.
@cache
def _find_plugins(find: Callable[..., Any], group: str) -> tuple[EntryPoint, ...]:
    return tuple(sorted(find(group=group), key=lambda point: str(point.name)))


def load(group: str, kind: str, name: str, fits: Callable[[Any], bool]) -> Any:
    """Return the part (an estimator, a law: `kind`) that a plug-in of that name provides, None if not found.

    Raises `ConfigError` when it does not load, or gives something that does not fit.
    """
    if name in (parts := _registered_for(group)):
        return parts[name]
    point = next((point for point in _find_plugins(entry_points, group) if point.name == name), None)
    if point is None:
        return None
    where = f"{kind} {name!r} ({point.value})"
    remedy = f"fix or remove {point.dist.name if point.dist else 'that package'}"
    try:
        part = point.load()
    except (Exception, SystemExit) as error:  # a third party's module may raise anything
        raise ConfigError(f"{where} does not load: {error!r}", remedy=remedy) from error
    if not fits(part):
        raise ConfigError(f"{where} must be a {kind}, and is a {type(part).__name__}", remedy=remedy)
    return part
