"""The commands of ``rig``, which parse arguments and print results.

An error of `rig.core.errors` is printed as one line with its exit code, without a traceback; set ``RIG_DEBUG=1`` to see
the origin of an unexpected error. `rig.__main__` calls this package, and the builder of documents lists its commands.
It must not compute a result or command a device: a command calls a function of another package and prints its result.
"""

import io
import os
import select
import signal
import sys
from itertools import pairwise

import click

from rig.cli._compiling import EXPECTED, CompilingNotice
from rig.cli._lazy import LazyGroup
from rig.cli._table import TITLES
from rig.cli.output import error_facts, for_terminal, print_json
from rig.core.errors import ConfigError, RigError
from rig.core.namesakes import explain_failure, wrong_package
from rig.realtime import compiling


@click.group(cls=LazyGroup, titles=TITLES, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="haptic-rig", prog_name="rig")
def rig() -> None:
    """Run 1-DOF haptic rigs: dual-rate virtual walls, velocity estimators, wall-hit experiments.

    Try it without hardware: `rig hit`. A rig of your own begins with `rig experiment new`. Every command takes --help,
    and --json for machines. For completion, put eval "$(_RIG_COMPLETE=bash_source rig)" into ~/.bashrc; zsh and fish
    likewise.
    """


def main(obj: object = None) -> None:
    """Run the command line of this process with click's context object `obj`, and exit; SIGTERM acts like Ctrl-C."""
    # Matrices here are small: threads of a linear algebra library cost more than they give, and a loop its quiet.
    for library in ("OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A program reads it, or a file stores it (`rig experiment preset … > mine.toml`): UTF-8 in every locale.
        encoding = None if sys.stdout.isatty() else "utf-8"
        # A file's name need not be text, and \udcff is JSON.
        sys.stdout.reconfigure(encoding=encoding, errors="backslashreplace")
    signal.signal(signal.SIGTERM, _interrupt)
    if {"-q", "--quiet"}.isdisjoint(sys.argv[1:]):
        compiling.listen(CompilingNotice(EXPECTED.get("".join(sys.argv[1:2]), 0)))
    code = run(sys.argv[1:], obj)
    sys.exit(_flush(code))


def _flush(code: int) -> int:
    """Flush standard output and error; return `code`, or 74 if `code` is 0 and a stream could not be written."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except OSError as error:
            # The interpreter tries again at its end, and would complain and exit with 120 whatever the command
            # returned: what nothing takes goes to the null device.
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, stream.fileno())
            os.close(null)
            if not isinstance(error, BrokenPipeError):  # a reader that has gone wants no more
                code = code or 74
    return code


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt(signal.Signals(number).name)


def run(arguments: list[str], obj: object = None) -> int:
    """Run a command line with click's context object `obj`, print its errors, and return its exit code."""
    try:
        return _run(arguments, obj)
    except OSError:  # standard error takes no more either
        return 74


def _run(arguments: list[str], obj: object) -> int:  # noqa: PLR0911  (one exit code for each kind of end)
    try:
        _refuse_empty(arguments)
        if not hasattr(sys.modules["rig"], "_NAMES") and arguments[:1] != ["stop"]:
            raise wrong_package("rig") or ConfigError(
                "files of the package rig are missing", remedy="install haptic-rig again"
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
        return _incomplete("a reader closed the pipe")
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
    for before, word in pairwise(["rig", *arguments]):
        name, equals, value = word.partition("=")
        if not word or (name.startswith("--") and equals and not value):
            raise ConfigError(
                f"no value is given {f'for {name}' if word else f'after {before}'}",
                remedy="give a value, or leave the option out",
            )


def _reader_has_gone() -> bool:
    """Return True if standard output is a pipe whose reader has closed it."""
    if sys.platform == "win32":
        return True  # it cannot be queried there, and click raises this error for nothing else
    else:
        output = select.poll()
        output.register(1, 0)
        return any(event & select.POLLERR for _, event in output.poll(0))


def _incomplete(why: str) -> int:
    click.echo(f"rig: {why}: the output above may be incomplete", err=True)
    return 74


def _report(error: RigError, arguments: list[str]) -> None:
    if "--json" in arguments and not error.reported:
        print_json({"error": error_facts(error)})
    for message in error.messages:
        click.echo(f"rig: {for_terminal(message)}", err=True)
    click.echo(f"rig: {for_terminal(str(error))}", err=True)
    if error.recording is not None:
        click.echo(f"rig: the recording up to that point: {error.recording}", err=True)
