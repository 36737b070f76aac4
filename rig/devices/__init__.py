"""Open the device at a URL: find the backend of the URL's scheme, open the link, speak the protocol.

A backend is a function ``open_link(url: DeviceUrl, model: RigModel | None) -> Link``. Extras add URL schemes by their
tables (`rig.core.extras`), third parties by the entry-point group ``rig.devices``. No built-in scheme can be replaced.

Commands, `rig.doctor`, `rig.experiments`, `rig.firmware`, sessions and `rig.testing` open devices here. It must not
load a backend before a URL names its scheme, and opening a device must not arm it.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any, cast

from rig import config
from rig.config import presets
from rig.core import extras, plugins
from rig.core.errors import ConfigError, DeviceNotFoundError
from rig.core.model import RigModel
from rig.core.namesakes import NEEDED, explain_failure, wrong_package
from rig.devices.device import DeviceUrl, Link
from rig.devices.fault_script import Faults
from rig.devices.framed import FramedDevice
from rig.devices.simulated import OpenExcitedSimulation, OpenRig, OpenWatchedLink, WatchedLink

BUILT_IN = {
    "sim": "sim_backend.ends.link:open_link",
    "serial": "rig.devices._threaded_serial:open_link",
    "usb": "rig.devices.usb:open_link",
}
if sys.platform == "linux":
    BUILT_IN |= {
        "serial": "rig.devices.serial:open_link",
        "unix": "rig.devices._local_socket:open_link",
    }
# Schemes that stay reserved for an extra of this distribution while it is missing or broken: another package's backend
# would drive the motor in its place.
RESERVED = {"moteus": "drives", "odrive": "drives"}
FIRMWARE = "firmware"  # option of sim://: 1 is the compiled firmware in place of its mirror in Python
# What the simulation offers beside its link (`rig.devices.simulated`), and its server (`rig.devices.local`).
HITS, EXCITED = "sim_backend.bare.hits:RigOfHits", "sim_backend.bare.excited:ExcitedPlant"
PLANT, TRIAL = "sim_backend.mechanics.plant:DiscretePlant", "sim_backend.bare.trial:run_trial"
SERVER = "sim_backend.ends.pty:serve"
DISTRIBUTION = "haptic-rig"


@dataclass(frozen=True, slots=True)
class Backend:
    """Backend of a URL scheme: its opening function (``module:function``), and the installed package that has it."""

    scheme: str
    target: str
    distribution: str


def backends() -> list[Backend]:
    """Return the backends that are available on this system: built-in ones, then those of extras and plug-ins."""
    ours = {row.name: row.target for row in extras.added("schemes").values() if _is_of_this_system(row)}
    own = BUILT_IN | {scheme: target for scheme, target in ours.items() if scheme not in BUILT_IN}
    # `broken` explains why a scheme of a broken extra is missing.
    own |= {scheme: "" for scheme, extra in RESERVED.items() if extra in extras.broken()}
    table = [Backend(scheme, target, DISTRIBUTION) for scheme, target in own.items()]
    return table + [
        Backend(point.name, point.value, point.dist.name if point.dist else "?")
        for point in plugins.find_plugins("rig.devices", {*own, *RESERVED})
    ]


def broken(scheme: str) -> str:
    """Return the reason why devices with this URL scheme cannot be opened; "" if they can."""
    if scheme in NEEDED and (wrong := wrong_package(scheme)):  # serial and usb are the names of both
        return str(wrong)
    try:
        load_backend(f"{scheme}://")
    except (ConfigError, DeviceNotFoundError) as error:
        return str(error)
    return ""


def load_backend(url: str) -> Callable[[DeviceUrl, RigModel | None], Link]:
    """Import a URL's backend and return its function ``open_link(url, model)``; `ConfigError` for an unknown scheme."""
    scheme = DeviceUrl.parse(url).scheme
    if scheme in BUILT_IN:
        opener = loaded(BUILT_IN[scheme], scheme)
    elif (row := _row_of_extra(scheme)) is not None:
        opener = loaded(row.target, scheme) if _is_of_this_system(row) else None
    else:
        opener = plugins.load("rig.devices", "backend", scheme, callable)
    if opener is None:
        schemes = ", ".join(f"{backend.scheme}://" for backend in backends())
        raise ConfigError(
            f"there is no backend for {scheme}:// (in {url!r})", remedy=f"use one of these schemes: {schemes}"
        )
    return cast("Callable[[DeviceUrl, RigModel | None], Link]", opener)


def _row_of_extra(scheme: str) -> extras.ExtraRow | None:
    """Return the table row of the optional package that adds a URL scheme, else None; `ConfigError` if missing."""
    if scheme in RESERVED or scheme in extras.added("schemes"):
        return extras.find("schemes", scheme, RESERVED.get(scheme, ""))
    return None


def _is_of_this_system(row: extras.ExtraRow) -> bool:
    return bool(row.more.get("platform", sys.platform) == sys.platform)


def loaded(target: str, scheme: str = "sim") -> Any:
    """Import and return the object ``module:attribute``; raise `DeviceNotFoundError` if the import fails."""
    try:
        return resolve_name(target)
    except Exception as error:
        if wrong := explain_failure():
            raise wrong from error
        raise DeviceNotFoundError(
            f"cannot import the backend for {scheme}:// ({target}): {error}",
            remedy=f"reinstall {DISTRIBUTION}",
        ) from error


def open_link(url: str, model: RigModel | None = None) -> Link:
    """Open the device at a URL and return the link (byte stream) to it.

    Raise `ConfigError` if the scheme or an option is unknown, and `DeviceNotFoundError` if the port does not exist, may
    not be opened, or is in use by another program.

    Parameters
    ----------
    url
        ``sim://koul-compliant``, ``serial:///dev/ttyACM0?baud=921600``, ….
    model
        Physics of the rig, for a backend that simulates the rig or is built from it (`is_made_for_a_rig`). A preset
        named in the URL (``sim://koul-compliant``) takes precedence.
    """
    parsed = DeviceUrl.parse(url)
    try:
        return load_backend(url)(parsed, simulated_model(parsed, model))
    except (ImportError, AttributeError) as error:
        if wrong := explain_failure():
            raise wrong from error
        raise


def open_watched(url: str, model: RigModel | None = None, faults: Faults | None = None) -> WatchedLink:
    """Open a simulated rig in virtual time with scripted faults; raise `ConfigError` unless the URL is ``sim://``."""
    parsed = DeviceUrl.parse(url)
    if parsed.scheme != "sim":
        raise ConfigError(
            f"{url} is not a simulated rig: only sim:// can simulate faults",
            remedy="use a simulated rig, like sim://koul-compliant",
        )
    opener = cast("OpenWatchedLink", loaded(BUILT_IN["sim"]))
    return opener(parsed, simulated_model(parsed, model), faults)


def simulated_model(url: DeviceUrl, model: RigModel | None) -> RigModel | None:
    """Return the physics of the preset that a ``sim://`` URL names; without a preset return `model`.

    The person at the handle is always that of `model`, because the person belongs to the experiment.
    """
    if url.scheme == "sim" and url.place:
        named = config.rig_model(presets.load(url.place))
        return named if model is None else named.held_by(model.operator, model.reach)
    return model


def is_made_for_a_rig(url: str) -> bool:
    """Return True if the backend at a URL needs the model of a rig, because it simulates the rig or is built for it."""
    scheme = url.partition(":")[0]
    if scheme in BUILT_IN:
        return scheme == "sim"
    row = _row_of_extra(scheme)
    return row is not None and bool(row.more.get("made_for_a_rig"))


def url_for(url: str, loop: str) -> str:
    """Return the device's URL, with ``firmware=1`` if a simulated one must run the law itself (`loop` "device")."""
    if loop != "device" or not url.startswith("sim:") or FIRMWARE in DeviceUrl.parse(url).options:
        return url
    return f"{url}{'&' if '?' in url else '?'}{FIRMWARE}=1"


def simulated_rig() -> OpenRig:
    """Return the function that creates simulated rigs for fast wall hits; `DeviceNotFoundError` without a simulator."""
    return cast("OpenRig", loaded(HITS))


def excited_simulation() -> OpenExcitedSimulation:
    """Return the function that creates rigs with a second, exciting actuator; `DeviceNotFoundError` if missing."""
    return cast("OpenExcitedSimulation", loaded(EXCITED))


def simulated_trial() -> tuple[Any, Any]:
    """Return two functions: build a simulated plant, run a trial on it; `DeviceNotFoundError` without a simulator."""
    return loaded(PLANT).build, loaded(TRIAL)


def open_device(url: str, model: RigModel | None = None) -> FramedDevice:
    """Open a device for requests; `ConfigError` for a wrong URL, `DeviceNotFoundError` if it is missing or in use."""
    return FramedDevice(open_link(url, model))
