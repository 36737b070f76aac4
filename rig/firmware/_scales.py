"""Check that the scales of a board's current output and sensor fit the rig and its amplifier.

The checks reject an output that saturates below the peak current, a sensor that saturates below the over-current limit,
and coarse steps. A device reports the commanded current, which is the real one only if the output can deliver it. The
build calls it before it compiles. It must not correct a setting: it only rejects.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import inf

from firmware_protocol.dictionary import SettingValue
from rig.config import amplifiers
from rig.config.amplifiers import AmplifierProfile
from rig.core.board import OVER_CURRENT_MARGIN
from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.firmware._boards import Board

CONVERTER_V, CONVERTER_STEPS = 3.3, 4096  # range and steps of the A/D converter of a current monitor
LEAST_STEPS = 50  # of the output, from zero to the rig's peak current
DAC_STEPS = 65536  # of the D/A converter, from full negative to full positive current
# Settings of a board with an output (the Pico's board.toml); if one is missing, the step is unknown.
SCALES = {"full_scale", "current_monitor"}
PULSE_WIDTH = {"duty_minimum", "duty_maximum", "set_point", "pwm_frequency", "clock"}


def monitor_step_a(settings: Mapping[str, SettingValue]) -> float:
    """Return the current (A) of one step of the A/D converter that reads the amplifier's current monitor."""
    return CONVERTER_V / CONVERTER_STEPS / float(settings["monitor_scale"])


def _has_pulse_width(settings: Mapping[str, SettingValue]) -> bool:
    return settings.get("output", "pwm") == "pwm"


def _step_of_full_scale(settings: Mapping[str, SettingValue]) -> float | None:
    """Return one step of the board's current output as a share of full scale; None if settings for it are missing."""
    if not settings.keys() >= SCALES:
        return None
    if not _has_pulse_width(settings):
        return 2.0 / DAC_STEPS
    if not settings.keys() >= PULSE_WIDTH:
        return None
    span = float(settings["duty_maximum"]) - float(settings["duty_minimum"])
    one_way = 0.5 * span if settings["set_point"] == "offset" else span
    mhz = re.fullmatch(r"(\d+)mhz", str(settings["clock"]))
    cycles = float(mhz[1]) * 1e6 / float(settings["pwm_frequency"]) if mhz else inf
    return 1.0 / (one_way * cycles)


def set_point_step_a(model: RigModel, settings: Mapping[str, SettingValue]) -> float | None:
    """Return one step of the current set-point (A): the coarser of the board's output step and the amplifier's.

    Return None for a board without an output for set-points. If its clock is not given in MHz, the amplifier's step
    counts.
    """
    if (sent := _step_of_full_scale(settings)) is None:
        return None
    smallest_step = amplifiers.load(model.amplifier.profile).steps
    seen = 2.0 / smallest_step if smallest_step else 0.0
    return float(settings["full_scale"]) * max(sent, seen)


def check_scales(board: Board, model: RigModel, settings: Mapping[str, SettingValue]) -> float | None:
    """Check that a board can output and measure the rig's currents; return one step of the set-point (A).

    Raise `ConfigError` if a setting does not fit the rig or its amplifier; the message has both numbers and the remedy.

    Parameters
    ----------
    board, model
        The board, and the rig with the name of its amplifier's profile.
    settings
        All settings of the board. A board without an output for set-points is not checked, and the result is None.
    """
    if (step := set_point_step_a(model, settings)) is None:
        return None
    profile = amplifiers.load(model.amplifier.profile)
    peak = model.amplifier.effort_limit / model.amplifier.effort_per_ampere
    full_scale = float(settings["full_scale"])
    refuse = _Refusal(board, model)
    wanted = profile.settings.get("output")
    if wanted is not None and settings.get("output", wanted) != wanted:
        raise refuse(
            "output",
            f"{settings['output']} does not match the input of the amplifier {profile.name}",
            f"set it to {wanted}, or choose another rig.amplifier.profile",
        )
    if full_scale < peak * (1.0 - 1e-9):
        raise refuse(
            "full_scale",
            f"{full_scale:g} A is below the peak current of {peak:.4g} A: larger set-points would saturate unnoticed",
            f"set it to {peak:.4g} A or more, in the amplifier too, or lower rig.amplifier.effort_limit",
        )
    if full_scale > (profile.most_a or inf):
        raise refuse(
            "full_scale",
            f"{full_scale:g} A exceeds the maximum of {profile.name}",
            f"set it to at most {profile.most_a:g} A, in the amplifier too",
        )
    if _has_pulse_width(settings):
        _check_frequency(float(settings["pwm_frequency"]), profile, model.amplifier.set_point_delay_s, refuse)
    if step > peak / LEAST_STEPS:
        raise refuse(
            "full_scale",
            f"{full_scale:g} A in steps of {step:.3g} A gives only {peak / step:.0f} steps up to the rig's "
            f"peak current of {peak:.4g} A; at least {LEAST_STEPS} are required",
            f"set it closer to {peak:.4g} A, in the amplifier too",
        )
    if settings["current_monitor"] == "adc":
        _check_monitor(peak * OVER_CURRENT_MARGIN, settings, refuse)
    return step


def _check_frequency(frequency: float, profile: AmplifierProfile, delay_s: float, refuse: _Refusal) -> None:
    """Raise `ConfigError` if the amplifier rejects the PWM frequency (Hz), or its period exceeds `delay_s` (s)."""
    least, most = profile.pwm_frequency or (0.0, inf)
    if not least <= frequency <= most:
        raise refuse(
            "pwm_frequency",
            f"{frequency:g} Hz is outside the range of {profile.name}",
            f"set pwm_frequency to {least:g} to {most:g} Hz",
        )
    if profile.set_point_delay_s and delay_s * frequency < 1.0 - 1e-9:
        raise refuse(
            "pwm_frequency",
            f"{frequency:g} Hz has a period of {1e6 / frequency:.4g} µs, but theory assumes {1e6 * delay_s:.4g} µs",
            f"set rig.amplifier.set_point_delay_s = {1.0 / frequency:.4g}, or a higher frequency",
        )


def _check_monitor(over_a: float, settings: Mapping[str, SettingValue], refuse: _Refusal) -> None:
    """Raise `ConfigError` if the current monitor cannot measure ± the over-current limit `over_a` (A)."""
    zero, scale = float(settings["monitor_zero"]), float(settings["monitor_scale"])
    room_v = min(zero, CONVERTER_V * (1.0 - 1.0 / CONVERTER_STEPS) - zero)
    if over_a * scale > room_v:
        raise refuse(
            "monitor_scale",
            f"a monitor of {scale:g} V/A about {zero:g} V can measure up to {room_v / scale:.4g} A, less than the "
            f"over-current limit of {over_a:.4g} A",
            f"scale the monitor to {room_v / over_a:.3g} V/A or less",
        )


class _Refusal:
    """A factory of `ConfigError` messages that name the board and the rig."""

    def __init__(self, board: Board, model: RigModel) -> None:
        self._of = f"board {board.name} for the rig {model.name}"

    def __call__(self, name: str, why: str, remedy: str) -> ConfigError:
        return ConfigError(f"{name} of {self._of}: {why}", remedy=remedy)
