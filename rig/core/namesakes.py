"""Detect another package with the import name of a needed package; pip may install it over the needed one silently.

Commands and devices call it after a failed import. It must not install or remove a package.
"""

import shlex
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.util import find_spec
from typing import Any

from rig.core.deferred import metadata, serial, usb
from rig.core.errors import ConfigError

# By import name: the distribution that is meant, and a name that only its package has.
NEEDED: Mapping[str, tuple[str, Callable[[], Any]]] = {
    "rig": ("haptic-rig", lambda: vars(sys.modules["rig"])["_NAMES"]),
    "serial": ("pyserial", lambda: serial.Serial),
    "usb": ("pyusb", lambda: usb.find),
}


def explain_failure() -> ConfigError | None:
    """Return an error if a needed package is missing or replaced by one with the same import name, else None."""
    return next((wrong for package in NEEDED if (wrong := wrong_package(package))), None)


def wrong_package(package: str) -> ConfigError | None:
    """Return an error if the package with this import name is missing or replaced by another one, else None."""
    distribution, find_own_name = NEEDED[package]
    with suppress(Exception):  # whatever a package of others does while it is imported
        find_own_name()
        return None
    pip = f"{shlex.quote(sys.executable)} -m pip"
    spec = find_spec(package)
    if spec is None:
        return ConfigError(f"{distribution} is not installed", remedy=f"{pip} install {distribution}")
    others = sorted(set(metadata.packages_distributions().get(package, ())) - {distribution})
    place = spec.origin or ", ".join(spec.submodule_search_locations or ())
    # No index is sure to have this package.
    again = "then install it from where it came" if package == "rig" else f"{pip} install {distribution}"
    return ConfigError(
        f"the package {package} in {place} does not belong to {distribution}"
        + (f", but to {' and '.join(others)}, which was installed over it" if others else ""),
        remedy=f"{pip} uninstall -y {' '.join([*others, distribution])}; {again}",
    )
