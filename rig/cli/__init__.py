"""Commands: arguments, presentation, nothing else.

Errors of `rig.core.errors` become one clear line and their exit code, never a traceback; set ``RIG_DEBUG=1`` to
see where an unexpected one comes from.
"""

from __future__ import annotations

import io
import os
import select
import signal
import sys
from itertools import pairwise

import click

from rig.cli.compiling import EXPECTED, CompilingNotice
from rig.cli.lazy import LazyGroup
from rig.cli.output import error_facts, for_terminal, print_json
from rig.core.errors import ConfigError, RigError
from rig.core.namesakes import explain_failure, wrong_package
from rig.realtime import compiling

# Group of `rig --help` → command → module:attribute, and the line that is shown without importing it.
GROUPS: dict[str, dict[str, tuple[str, str]]] = {
    "Run": {
        "new": (
            "rig.cli.new:new",
            "Write an experiment file for a rig of your own from the data sheets of motor and encoder.",
        ),
        "plan": (
            "rig.cli.plan:plan",
            "Check an experiment before it runs, and list what it will do: nothing moves.",
        ),
        "hit": ("rig.cli.hit:hit", "Hit a virtual wall: run, judge, record and draw one automated trial."),
        "preset": (
            "rig.cli.preset:preset",
            "List the built-in rigs, print one as a file to start from, or the schema of such files.",
        ),
    },
    "Measure a rig": {
        "check": (
            "rig.cli.check:check",
            "MOVE THE MOTOR by four small pushes: does the free handle move as the rig is described?",
        ),
        "reference": (
            "rig.cli.reference:reference",
            "Find position zero by the encoder's index and a limit switch, once after power-up.",
        ),
        "identify": (
            "rig.cli.identify:identify",
            "Identify a rig: signs, friction, inertia, damping, delay, first mode.",
        ),
        "impedance": (
            "rig.cli.impedance:impedance",
            "Measure the impedance of a rig and its walls: passive or not, and how faithful.",
        ),
    },
    "Rates and estimators": {
        "zwidth": (
            "rig.cli.zwidth:zwidth",
            "Map the walls (K, B) that a rig renders stably, scheme by scheme.",
        ),
        "compare": (
            "rig.cli.compare:compare",
            "Compare one simulated hit without damping, with uniform and with dual-rate sampling.",
        ),
        "design": (
            "rig.cli.design:design_",
            "Find rates, estimator and filter for a rig, for stated wishes, with their margin.",
        ),
        "kmax": ("rig.cli.kmax:kmax", "Find the stiffest undamped wall at each sampling rate."),
        "theory": (
            "rig.cli.theory:theory",
            "Say which walls are stable on a rig by exact linear theory, and what binds.",
        ),
        "limit-cycles": (
            "rig.cli.limit_cycles:limit_cycles",
            "Predict how the encoder's quantum makes walls oscillate, and simulate the same walls.",
        ),
        "plot": ("rig.cli.plot:plot", "Draw what the theory says: levant-regions."),
        "estimators": (
            "rig.cli.estimators:estimators",
            "List, compare and tune velocity estimators, and take one out as C.",
        ),
        "reproduce": (
            "rig.cli.reproduce:reproduce",
            "Reproduce a paper: figures, claims and open ideas, as one report.",
        ),
    },
    "People": {
        "session": (
            "rig.cli.session:session",
            "Run wall-hit experiments with people: protocol, sessions, analysis.",
        ),
    },
    "Recordings": {
        "show": ("rig.cli.show:show", "Show what a recording holds, its verdict and its picture."),
        "replay": ("rig.cli.replay:replay", "Run a recording's inputs through the same or another law."),
        "timing": (
            "rig.cli.timing:timing",
            "Show where the time of each tick of a recording went, and its worst ticks.",
        ),
        "export": ("rig.cli.export:export", "Write a recording as CSV, X-Y, Parquet, MAT or MCAP."),
        "recover": ("rig.cli.recover:recover", "Seal what a crash left unsealed, and say what it cost."),
    },
    "Live": {
        "console": (
            "rig.cli.console:console",
            "See and touch a rig in the browser: scope, wall, handle, STOP.",
        ),
        "stop": ("rig.cli.stop:stop", "Stop the loops that run in real time, from any terminal."),
        "set": ("rig.cli.set:set_", "Change the wall of a loop that runs in real time."),
        "lsl": ("rig.cli.lsl:lsl", "Stream the running loop by Lab Streaming Layer: samples and markers."),
    },
    "Hardware": {
        "devices": (
            "rig.cli.devices:devices",
            "List device backends and ports, or ask one device who it is and what is active there.",
        ),
        "doctor": (
            "rig.cli.doctor:doctor",
            "Report what this machine and a link can do, which walls that supports, and what fixes the rest.",
        ),
        "firmware": (
            "rig.cli.firmware:firmware",
            "Build the firmware of a controller board for a rig, flash it, have it test itself.",
        ),
        "bridge": ("rig.cli.bridge:bridge", "Run a bridge to a drive that you own: moteus, ODrive."),
        "sim": ("rig.cli.sim:sim", "Serve a simulated rig on a serial port of its own."),
    },
    "This program": {
        "docs": ("rig.cli.docs:docs", "Build these documents as a site, and open it in the browser."),
        "completion": (
            "rig.cli.completion:completion",
            "Print the script by which a shell completes commands, rigs, estimators, schemes and recordings.",
        ),
    },
}
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}


@click.group(
    cls=LazyGroup, table=COMMANDS, groups=GROUPS, context_settings={"help_option_names": ["-h", "--help"]}
)
@click.version_option(package_name="haptic-rig", prog_name="rig")
def rig() -> None:
    """Run 1-DOF haptic rigs: dual-rate virtual walls, velocity estimators, wall-hit experiments.

    Try it without hardware: `rig hit`. A rig of your own begins with `rig new`. Every command takes --help, and --json
    for machines.
    """


def main(obj: object = None) -> None:
    """Run the command line of this process; SIGTERM ends it like Ctrl-C. `obj` is for its command."""
    # Matrices here are small: threads of a linear algebra library cost more than they give, and a loop its quiet.
    for library in ("OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A program reads it, or a file keeps it (`rig preset … > mine.toml`): JSON and TOML are UTF-8 in every locale.
        encoding = None if sys.stdout.isatty() else "utf-8"
        # A file's name need not be text, and \udcff is JSON.
        sys.stdout.reconfigure(encoding=encoding, errors="backslashreplace")
    signal.signal(signal.SIGTERM, _interrupt)
    if {"-q", "--quiet"}.isdisjoint(sys.argv[1:]):
        compiling.listen(CompilingNotice(EXPECTED.get("".join(sys.argv[1:2]), 0)))
    code = run(sys.argv[1:], obj)
    sys.exit(_flushed(code))


def _flushed(code: int) -> int:
    """Write what is still buffered, and return the exit code: 74 where a good run could not write all of it.

    The interpreter tries again at its end, and would complain and exit with 120 whatever the command returned. So what
    nothing takes goes to the null device.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except OSError as error:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, stream.fileno())
            os.close(null)
            if not isinstance(error, BrokenPipeError):  # a reader that has gone wants no more
                code = code or 74
    return code


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt(signal.Signals(number).name)


def run(arguments: list[str], obj: object = None) -> int:
    """Run a command line and return its exit code; prints errors, raises nothing."""
    try:
        return _run(arguments, obj)
    except OSError:  # standard error takes no more either
        return 74


def _run(arguments: list[str], obj: object) -> int:  # noqa: PLR0911  (one exit code for each kind of end)
    try:
        _refuse_empty(arguments)
        if not hasattr(sys.modules["rig"], "_NAMES") and arguments[:1] != ["stop"]:
            raise wrong_package("rig") or ConfigError(
                "the package rig is not complete", remedy="install it again"
            )
        result = rig.main(args=arguments, prog_name="rig", standalone_mode=False, obj=obj)
        return result if isinstance(result, int) else 0
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt) as error:
        cause = error.__cause__ or error  # click makes an Abort of both
        if isinstance(cause, EOFError):
            return _defect(cause, arguments)
        signal_name = cause.args[0] if cause.args else "SIGINT"
        by = f" by {signal_name}" if isinstance(cause, KeyboardInterrupt) else ""
        click.echo(f"rig: stopped{by}", err=True)
        return 130
    except RigError as error:
        _report(error, arguments)
        return error.exit_code
    except SystemExit:  # click's answer to a broken pipe
        if _reader_has_gone():
            return 0  # nothing to complain about
        return _incomplete("a pipe broke")
    except OSError as error:
        return _incomplete(str(error.strerror or error))
    except Exception as error:
        return _defect(error, arguments)


def _defect(error: Exception, arguments: list[str]) -> int:
    if os.environ.get("RIG_DEBUG"):
        raise error
    if wrong := explain_failure():
        _report(wrong, arguments)
        return wrong.exit_code
    click.echo(
        f"rig: internal error: {type(error).__name__}: {error}. This is a bug; RIG_DEBUG=1 shows where",
        err=True,
    )
    return 70


def _refuse_empty(arguments: list[str]) -> None:
    """An empty word is a variable of a shell that is not set: no path, no URL and no name, whatever the command."""
    for before, word in pairwise(["rig", *arguments]):
        name, equals, value = word.partition("=")
        if not word or (name.startswith("--") and equals and not value):
            raise ConfigError(
                f"nothing is given {f'for {name}' if word else f'after {before}'}",
                remedy="give a value, or leave the option out",
            )


def _reader_has_gone() -> bool:
    """Whether nobody reads standard output any more."""
    if sys.platform == "win32":
        return True  # no question there tells; click says it of nothing else
    else:
        output = select.poll()
        output.register(1, 0)
        return any(event & select.POLLERR for _, event in output.poll(0))


def _incomplete(why: str) -> int:
    click.echo(f"rig: {why}: what was printed may be incomplete", err=True)
    return 74


def _report(error: RigError, arguments: list[str]) -> None:
    if "--json" in arguments and not error.reported:
        print_json({"error": error_facts(error)})
    for message in error.messages:
        click.echo(f"rig: {for_terminal(message)}", err=True)
    click.echo(f"rig: {for_terminal(str(error))}", err=True)
    if error.recording is not None:
        click.echo(f"rig: what was recorded until then: {error.recording}", err=True)
