"""Simulated device in its own process, for a run in real time on this machine.

The process communicates through a socket (`rig.devices._local_socket`); everything above the link is as with a real
rig. `rig serve rig` communicates through a pseudo-terminal, which exercises pyserial too.

`rig serve rig`, hits, trials, identification, `rig.doctor`, sessions and `rig.testing` call it. It must not give
real-time scheduling to the process before the device has been compiled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

from rig import devices
from rig.config import Host
from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.core.process import start_announced
from rig.core.scratch import scratch
from rig.core.this_system import processors, refuse_real_time
from rig.devices import simulated_model
from rig.devices.device import DeviceUrl, Link
from rig.devices.framed import FramedDevice
from rig.realtime.hand import SharedHand
from rig.realtime.scheduling import BoardScheduling, Realtime, obtained

IN_VIRTUAL_TIME = "simulate it in virtual time: leave `realtime` out, rehearse a session"


def serve(
    model: RigModel,
    *,
    realtime: str = "try",
    cpu: int | None = None,
    scheduled: Callable[[Realtime], object] = lambda granted: None,
    announce: Callable[[str], None] = print,
    **options: Any,
) -> None:
    """Serve a simulated rig in this process until stopped (see `sim_backend.ends.pty.serve`).

    When the device is ready, the calling thread gets real-time scheduling and its processor if the system grants them;
    then `scheduled` is called with the result. ``realtime="off"`` requests nothing. Scheduling does not begin earlier,
    because compiling takes more than a second, in which no other device, loop or drive on that processor would run: of
    three devices that were opened at once with the priority from the start, every third sent no reply.
    Raise `DeviceNotFoundError` if the simulation does not load, and `PlanError` if the system is not Linux.
    """
    refuse_real_time("a simulated rig", IN_VIRTUAL_TIME)
    server = devices.loaded(devices.SERVER)
    with obtained(BoardScheduling(realtime, cpu=cpu)) as granted:

        def ready(place: str) -> None:
            granted.enter_thread()
            scheduled(granted)
            announce(place)

        try:
            server(model, announce=ready, **options)
        finally:
            granted.leave_thread()


def host_beside(host: Host, link: Link) -> Host:
    """Return the loop's scheduling with the processor of a device that is a program here, unless the user names one.

    So a pause of this processor (of a virtual machine, by another program) stops loop and device, and loses no sample.
    """
    cpu = getattr(link, "cpu", None)
    return replace(host, cpu=cpu) if host.cpu is None and cpu is not None else host


def _child(
    announce: Callable[[str], None], model: RigModel, realtime: str, options: Mapping[str, Any]
) -> None:
    serve(model, realtime=realtime, announce=announce, **options)


@contextmanager
def serve_locally(
    url: str, model: RigModel, *, seed: int = 0, realtime: str = "try", terminal: bool = False
) -> Iterator[str]:
    """Start a device process and yield the URL of its port; the process ends with the context.

    A preset in the URL takes precedence over `model`; ``firmware=1`` simulates the firmware. With ``hand=PATH`` another
    program moves the hand at the handle, through an existing file (`rig.realtime.hand`). `realtime` is that of `serve`.
    With `terminal` the port is a pseudo-terminal, for programs of any language; else it is a Unix socket.

    Raises
    ------
    ConfigError
        The scheme is not ``sim``, the preset or the hand's file does not exist, the experiment has no hand, another
        option is given, or the system is not Linux.
    DeviceNotFoundError
        The process does not start.
    """
    refuse_real_time("a simulated rig", IN_VIRTUAL_TIME)
    parsed = DeviceUrl.parse(url)
    if parsed.scheme != "sim":
        raise ConfigError(
            f"{url} cannot be served", remedy="give the URL of a simulated rig, like sim://koul-compliant"
        )
    options = _served_options(parsed)
    described = simulated_model(parsed, model)
    if "hand" in options:
        _check_led(options["hand"], described)
    cpu = max(processors())
    with scratch("device") as place:
        options |= {"seed": seed, "cpu": cpu} | ({} if terminal else {"socket": f"{place}/port"})
        with start_announced(
            _child, described, realtime, options, name="rig-device", by_hand="rig serve rig"
        ) as port:
            yield f"serial://{port}" if terminal else DeviceUrl.of("unix", port, {"cpu": str(cpu)}).text


@contextmanager
def open_for_run(
    url: str, model: RigModel | None, *, in_real_time: bool, seed: int = 0, realtime: str = "try"
) -> Iterator[FramedDevice]:
    """Open a device; in real time, a simulated device runs in its own process, which ends with the context.

    Parameters
    ----------
    url
        URL of the device; if the law runs on the device, use `rig.devices.url_for`.
    model
        Rig to simulate, or for which a bridge of drives is built; None for another real device.
    in_real_time
        True if a simulated device runs in real time. A real device always does.
    seed
        Seed of the simulation.
    realtime
        ``host.realtime`` of the experiment; with "off" the process requests no real-time scheduling.

    Raises
    ------
    RigError
        As `serve_locally` and `rig.devices.open_device`.
    """
    with ExitStack() as stack:
        if in_real_time and url.startswith("sim:"):
            assert model is not None
            wanted = "off" if realtime == "off" else "try"
            url = stack.enter_context(serve_locally(url, model, seed=seed, realtime=wanted))
            model = None
        yield stack.enter_context(devices.open_device(url, model))


def _served_options(url: DeviceUrl) -> dict[str, Any]:
    """Return the options of a URL that are valid in real time (``firmware``, ``hand``); else raise `ConfigError`."""
    options = dict(url.options)
    firmware, hand = options.pop("firmware", None), options.pop("hand", None)
    if options:
        raise ConfigError(
            f"{url.text}: {next(iter(options))} has no effect in real time",
            remedy="remove this option, or run in virtual time",
        )
    if firmware not in (None, "0", "1"):
        raise ConfigError(
            f"{url.text}: firmware = {firmware} is neither 0 nor 1", remedy="give 1, or leave it out"
        )
    return ({} if firmware is None else {"firmware": firmware == "1"}) | (
        {} if hand is None else {"hand": hand}
    )


def _check_led(path: str, model: RigModel | None) -> None:
    """Raise `ConfigError` if the hand at `path` cannot be used: the device process could not report it."""
    SharedHand.open(path).close()
    if model is None or model.operator is None:
        raise ConfigError(
            f"{path} drives a hand, but the experiment has none", remedy='set trial.kind = "human"'
        )
