"""Measure which walls a real rig renders stably, in a dialogue with the person beside it, on standard error.

`rig zwidth` and `rig design` use it. Without --confirm no, no hit may start on a real rig before the person has agreed.
"""

import sys
import time
from pathlib import Path

import click

from rig.cli import output
from rig.control.verdict import Kind, Measured
from rig.core.errors import ConfigError, RigError, StoppedError
from rig.core.sample import unit_of
from rig.devices import load_backend
from rig.experiments.mapping import interface as maps
from rig.experiments.mapping.interface import DeviceMap, MapPlan, Next, OnDevice, ZWidth, work_of

CONFIRM = ("each", "series", "no")
CRITERIA = ("felt", "heard", "any")  # rig.control.verdict.CRITERIA, without its imports
SHOWN_PAUSE_S = 2.0


class Dialogue:
    """A dialogue that measures which walls (K, B) a device renders stably, while a person stands beside it.

    `plan` has the walls to hit. `confirm` is when to ask: before each hit, before each series (the hits at one
    damping), or never ("no"); None to ask before each hit on a real device and never on a simulated one.
    """

    def __init__(self, plan: MapPlan, url: str, *, realtime: bool, confirm: str | None) -> None:
        self._plan = plan
        self._url = url
        self._realtime = realtime
        simulated = url.startswith("sim:")
        self._virtual = simulated and not realtime
        self._confirm = confirm or ("no" if simulated else "each")

    def map(self, directory: Path, *, verified: bool) -> tuple[Path, ZWidth]:
        """Measure which walls are stable; return the new directory below `directory`, and the limits.

        `verified` is True if the operator has checked the polarity of encoder and motor.
        """
        place = maps.directory_for(self._plan, directory, "zwidth", work_of(self._url, self._realtime))
        session = DeviceMap(
            where=OnDevice(
                url=self._url,
                realtime=self._realtime,
                verified=verified,
                recordings=place / maps.RECORDINGS,
                hands_off=self._hands_off,
            ),
            agrees=self._agrees,
            report=self._report,
            pause=self._pause,
        )
        try:
            return place, maps.map_on_rig(self._plan, place, session)
        except RigError as error:
            # An error with a recording names its file itself.
            if error.recording is None and (place / maps.RECORDINGS).exists():
                click.echo(f"rig: the hits so far are in {place / maps.RECORDINGS}", err=True)
            raise

    def _agrees(self, asked: Next) -> bool:
        motion = self._plan.experiment.rig.motion
        if asked.number == 1 and asked.attempt == 1:
            _print_message(
                f"series {asked.series} of {asked.total}: {asked.scheme}, "
                f"B = {asked.damping:.4g} {unit_of('damping', motion)}"
            )
        again = f", attempt {asked.attempt}" if asked.attempt > 1 else ""
        text = f"  hit {asked.number}{again}: K = {asked.stiffness:.4g} {unit_of('stiffness', motion)}"
        if asked.thrown_out:
            _print_message("  the wall threw the handle out: put it back near its start")
        first = asked.number == 1 and asked.attempt == 1
        if asked.thrown_out or self._confirm == "each" or (self._confirm == "series" and first):
            return _ask(f"{text}   Enter: continue, q: end ")
        _print_message(text)
        return True

    def _hands_off(self, text: str) -> None:
        """Ask for consent to the torque pulse that tests the rig before a hit; raise `StoppedError` if refused."""
        if self._confirm == "no":
            _print_message(f"  {text}")
        elif not _ask(f"  {text}   Enter: continue, q: end "):
            raise StoppedError("the operator ended the map before the torque pulse; the motor did not move")

    def _report(self, asked: Next, done: Measured, valid: bool) -> None:
        kind = done.kind if valid else Kind.INVALID
        passed = ", ".join(name for name in CRITERIA if done.passes(name)) or "none"
        _print_message(
            f"    {output.coloured(str(kind))}; {f'passes: {passed}' if valid else 'it is repeated'}"
        )

    def _pause(self, seconds: float) -> None:
        if self._virtual:
            return
        if seconds >= SHOWN_PAUSE_S:
            _print_message(f"    the motor cools for {seconds:.0f} s")
        time.sleep(seconds)


def load_device(url: str) -> None:
    """Import the driver for a device URL and compile the control loop for wall hits on this device."""
    load_backend(url)


def refuse_without_device(verified: bool, confirm: str | None) -> None:
    """Raise `ConfigError` if an option for a device (--verified, --confirm) is given without --url."""
    given = [name for name, value in (("--verified", verified), ("--confirm", confirm)) if value]
    if given:
        option = given[0]
        raise ConfigError(
            f"{option} needs a device, but --url is missing",
            remedy=f"give the device with --url, or drop {option}",
        )


def _ask(text: str) -> bool:
    while True:
        click.echo(text, nl=False, err=True)
        line = sys.stdin.readline()
        answer = line.strip().lower()
        if not line or answer in ("q", "quit", "n", "no"):
            click.echo(err=True)
            return False
        if answer in ("", "y", "yes"):
            return True


def _print_message(text: str) -> None:
    click.echo(text, err=True)
