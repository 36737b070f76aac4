"""Error types and exit codes by which a script distinguishes errors."""

import importlib
import pkgutil
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import rig
from rig.core.errors import ConfigError, RigError


def every_error(root: Any = RigError) -> Iterator[Any]:
    for child in root.__subclasses__():
        yield child
        yield from every_error(child)


def test_unrelated_errors_have_different_exit_codes() -> None:
    for module in pkgutil.walk_packages(rig.__path__, "rig."):
        if module.name != "rig.__main__":
            with suppress(ConfigError):  # an extra that is not installed
                importlib.import_module(module.name)
    owners = {}
    for error in every_error():
        if "exit_code" in vars(error):
            assert owners.setdefault(error.exit_code, error) is error
    assert set(owners) == {*range(2, 19), 130}
