"""Find plug-ins that third parties add by entry points: estimators, laws, backends. A broken one affects no other.

A program can also register its own plug-in temporarily under a name; in this process it is then found like an installed
one.

Devices, `rig.control`, commands and `rig.experiments.lab` look plug-ins up here. It must not import a plug-in before it
is requested by name.
"""

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
    """Register `part` as a plug-in of an entry-point group, for all threads, until the ``with`` block ends.

    Other processes, such as workers of a cluster or a later run that resumes a map, find only installed plug-ins. Raise
    `ConfigError` if the name is in `built_in`, the names that this package itself provides.
    """
    if name in built_in:
        raise ConfigError(
            f"{name!r} is already the name of a built-in estimator, law or backend",
            remedy='choose another name: name="…"',
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
    """Return the names of all registered and installed plug-ins of an entry-point group, without built-in names."""
    return list(
        dict.fromkeys([*_registered_for(group), *(point.name for point in find_plugins(group, built_in))])
    )


def find_plugins(group: str, built_in: Container[str]) -> list[EntryPoint]:
    """Return the installed plug-ins of an entry-point group, sorted by name, without those with a built-in name."""
    return [point for point in _find_plugins(entry_points, group) if point.name not in built_in]


# Cached: it reads the metadata of every installed package, some milliseconds for each scheme and each check.
@cache
def _find_plugins(find: Callable[..., Any], group: str) -> tuple[EntryPoint, ...]:
    return tuple(sorted(find(group=group), key=lambda point: str(point.name)))


def load(group: str, kind: str, name: str, fits: Callable[[Any], bool]) -> Any:
    """Import and return the plug-in `name` of an entry-point group; None if it is not registered or installed.

    `kind` is its kind in messages (estimator, law, backend). Raise `ConfigError` if the import fails, or if `fits`, a
    function, returns False for the object.
    """
    if name in (parts := _registered_for(group)):
        return parts[name]
    point = next((point for point in _find_plugins(entry_points, group) if point.name == name), None)
    if point is None:
        return None
    plugin = f"{kind} {name!r} ({point.value})"
    remedy = f"fix or remove {point.dist.name if point.dist else 'that package'}"
    try:
        part = point.load()
    except (Exception, SystemExit) as error:  # a third party's module may raise anything
        raise ConfigError(f"cannot import the plug-in {plugin}: {error!r}", remedy=remedy) from error
    if not fits(part):
        raise ConfigError(
            f"the plug-in {plugin} must provide a {kind}, but provides a {type(part).__name__}", remedy=remedy
        )
    return part
