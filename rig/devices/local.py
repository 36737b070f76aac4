"""A simulated device as a process of its own, for a run in real time on this machine.

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

    The calling thread gets real-time scheduling and its processor while it serves, where that is granted, and
    `scheduled` is called with them; ``realtime="off"`` requests none. It has them from the announcement on: loading and
    compiling a device takes a second and more, in which no other device, loop or drive on that processor would run: of
    three that were opened at once with the priority from the start, every third sent no reply, and none has since.
    Raises `DeviceNotFoundError` when the simulation does not load, and `PlanError` where the system is not Linux.
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
    """Return scheduling of a loop, on the processor of the device when that is a program here and the user names none.

    So a pause of that processor (of a virtual machine, by another program) stops both, and loses no sample.
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

    A name in the URL wins over `model`, and ``firmware=1`` means the firmware, as in virtual time. ``hand=PATH`` lets
    a program drive the hand that holds the handle, through a file that exists (`rig.realtime.hand`). `realtime` as in
    `serve`. With `terminal` the port is a pseudo-terminal, for programs of any language.

    Raises
    ------
    ConfigError
        A scheme that cannot be served, an unknown name, no such hand, an experiment without a hand, or another option,
        which belongs to virtual time; a system that is not Linux.
    DeviceNotFoundError
        The process does not come up.
    """
    refuse_real_time("a simulated rig", IN_VIRTUAL_TIME)
    parsed = DeviceUrl.parse(url)
    if parsed.scheme != "sim":
        raise ConfigError(f"{url} cannot be served", remedy="only sim:// can, like sim://koul-compliant")
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
    """Open a device; in real time a simulated one becomes a process of its own, which ends with the context.

    Parameters
    ----------
    url
        Of the device; where the law runs on it, see `rig.devices.url_for`.
    model
        What is simulated, or what a bridge is made for; None for another real device.
    in_real_time
        Whether a simulated device follows the clock on the wall. A real one always does.
    seed
        Of the simulation.
    realtime
        ``host.realtime`` of the experiment: with "off" the process asks for no scheduling, either.

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
    """Return the options of a URL that mean something in real time."""
    options = dict(url.options)
    firmware, hand = options.pop("firmware", None), options.pop("hand", None)
    if options:
        raise ConfigError(
            f"{url.text}: {next(iter(options))} has no effect in real time",
            remedy="leave it out, or run in virtual time",
        )
    if firmware not in (None, "0", "1"):
        raise ConfigError(
            f"{url.text}: firmware = {firmware} is neither 0 nor 1", remedy="give 1, or leave it out"
        )
    return ({} if firmware is None else {"firmware": firmware == "1"}) | (
        {} if hand is None else {"hand": hand}
    )


def _check_led(path: str, model: RigModel | None) -> None:
    """Raise here what would only end the process."""
    SharedHand.open(path).close()
    if model is None or model.operator is None:
        raise ConfigError(
            f"{path} drives a hand, but the experiment has none", remedy='set trial.kind = "human"'
        )
