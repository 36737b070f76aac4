"""Run a simulated device in its own process, for a run in real time on this computer.

The process communicates through a socket (`rig.devices._local_socket`), so that the host runs the same code as with a
real rig. `rig serve rig` communicates through a pseudo-terminal, which exercises pyserial too.

`rig serve rig`, hits, trials, identification, `rig.doctor`, sessions and `rig.testing` use it. It must not request
real-time scheduling for the process before the device has been compiled.
"""

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
    """Serve a simulated rig in this process, in real time and behind a port, until it is stopped.

    When the device is ready, the calling thread gets real-time scheduling and processor `cpu` if the system grants them
    (``realtime="off"``: no request); then `scheduled` is called with what was granted, and `announce` with the path of
    the port. `options` are arguments of `sim_backend.ends.pty.serve`. Raise `DeviceNotFoundError` if the simulation is
    not installed, and `PlanError` if the system is not Linux.
    """
    refuse_real_time("a simulated rig", IN_VIRTUAL_TIME)
    server = devices.loaded(devices.SERVER)
    with obtained(BoardScheduling(realtime, cpu=cpu)) as granted:

        def ready(place: str) -> None:
            # Not earlier: compiling takes more than a second, in which no other device, loop or drive on this processor
            # would run. With the priority from the start, every third of three devices opened at once sent no reply.
            granted.enter_thread()
            scheduled(granted)
            announce(place)

        try:
            server(model, announce=ready, **options)
        finally:
            granted.leave_thread()


def host_beside(host: Host, link: Link) -> Host:
    """Return `host`, the loop's scheduling request, with the processor of the device if it runs as a program here.

    A processor that the user names has precedence. If loop and device share a processor, a pause of this processor (of
    a virtual machine, by another program) stops both at once, and no sample is lost.
    """
    cpu = getattr(link, "cpu", None)
    return replace(host, cpu=cpu) if host.cpu is None and cpu is not None else host


def _serve_in_child(
    announce: Callable[[str], None], model: RigModel, realtime: str, options: Mapping[str, Any]
) -> None:
    serve(model, realtime=realtime, announce=announce, **options)


@contextmanager
def serve_locally(
    url: str, model: RigModel, *, seed: int = 0, realtime: str = "try", terminal: bool = False
) -> Iterator[str]:
    """Start a process with a simulated device and yield the URL of its port; the process ends with this context.

    A preset in the URL takes precedence over `model`; ``firmware=1`` simulates the firmware. With ``hand=PATH`` another
    program moves the simulated hand, through an existing file (`rig.realtime.hand`). `realtime` is "try" or "off". With
    `terminal` the port is a pseudo-terminal, for programs of any language; else it is a Unix socket.

    Raises
    ------
    ConfigError
        The scheme is not ``sim``, the preset or the hand's file does not exist, the experiment has no hand, or another
        option is given.
    PlanError
        The system is not Linux.
    DeviceNotFoundError
        The process does not start.
    """
    refuse_real_time("a simulated rig", IN_VIRTUAL_TIME)
    parsed = DeviceUrl.parse(url)
    if parsed.scheme != "sim":
        raise ConfigError(
            f"{url} cannot be served: only a simulated rig runs in a process of its own",
            remedy="give the URL of a simulated rig, like sim://koul-compliant",
        )
    options = _served_options(parsed)
    described = simulated_model(parsed, model)
    if "hand" in options:
        _check_hand_file(options["hand"], described)
    cpu = max(processors())
    with scratch("device") as place:
        options |= {"seed": seed, "cpu": cpu} | ({} if terminal else {"socket": f"{place}/port"})
        with start_announced(
            _serve_in_child, described, realtime, options, name="rig-device", by_hand="rig serve rig"
        ) as port:
            yield f"serial://{port}" if terminal else DeviceUrl.of("unix", port, {"cpu": str(cpu)}).text


@contextmanager
def open_for_run(
    url: str, model: RigModel | None, *, in_real_time: bool, seed: int = 0, realtime: str = "try"
) -> Iterator[FramedDevice]:
    """Open a device within this context; for a run in real time, a simulated device runs in its own process.

    Raise `RigError` if the device cannot be opened, or the process of a simulated device does not start.

    Parameters
    ----------
    url
        URL of the device; if the law runs on the device, use `rig.devices.url_for`.
    model
        Rig to simulate, or for which a bridge (firmware in front of a drive) is built; None for another real device.
    in_real_time
        True if a simulated device runs in real time. A real device always does.
    seed
        Seed of the simulation.
    realtime
        ``host.realtime`` of the experiment; with "off" the process requests no real-time scheduling.
    """
    with ExitStack() as stack:
        if in_real_time and url.startswith("sim:"):
            assert model is not None
            wanted = "off" if realtime == "off" else "try"
            url = stack.enter_context(serve_locally(url, model, seed=seed, realtime=wanted))
            model = None
        yield stack.enter_context(devices.open_device(url, model))


def _served_options(url: DeviceUrl) -> dict[str, Any]:
    """Return the URL's options that are valid in real time (``firmware``, ``hand``); raise `ConfigError` for others."""
    options = dict(url.options)
    firmware, hand = options.pop("firmware", None), options.pop("hand", None)
    if options:
        raise ConfigError(
            f"{url.text}: the option {next(iter(options))} has no effect in real time",
            remedy="remove this option, or run in virtual time",
        )
    if firmware not in (None, "0", "1"):
        raise ConfigError(
            f"{url.text}: firmware = {firmware} is not allowed; it must be 0 or 1",
            remedy="give firmware=1 to simulate the compiled firmware, or leave it out",
        )
    return ({} if firmware is None else {"firmware": firmware == "1"}) | (
        {} if hand is None else {"hand": hand}
    )


def _check_hand_file(path: str, model: RigModel | None) -> None:
    """Raise `ConfigError`, which the device's process cannot report, if the file is wrong or no hand holds the rig."""
    SharedHand.open(path).close()
    if model is None or model.operator is None:
        raise ConfigError(
            f"the file {path} drives a simulated hand, but the experiment has no hand",
            remedy='set trial.kind = "human"',
        )
