"""Compare a drive with the rig of an experiment: values that must agree, and limits that the drive sets.

`moteus` and `odrive` use it for what is the same for every drive. It must not communicate with a drive.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from rig.core.board import peak_current
from rig.core.errors import DeviceRefusedError
from rig.core.model import RigModel
from rig.core.sample import unit_of

TORQUE_TOLERANCE = 0.1  # chosen: by how much the torque constant may differ from the experiment's
EXACT_COUNTS = 2**23 - 1  # up to here a float32 is exact to half a count
Difference = tuple[str, str]  # description, remedy


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """Properties of a drive's output shaft, as the drive reports them.

    Attributes
    ----------
    encoder, counts
        Encoder that measures the position, and counts per turn of its own shaft.
    counts_per_turn
        Counts per turn of the output.
    torque_constant, most_current
        Torque at the output (N·m) for 1 A; largest current (A).
    most_speed
        Speed (turns/s) above which the drive does not give the commanded torque; inf: no limit.
    minimum, maximum
        Positions (turns) outside of which the drive gives no torque; NaN: no limit.
    kind
        Kind of drive, "moteus" or "odrive".
    encoder_setting, scale_setting, current_setting
        Names of the drive's settings for the encoder, the torque constant and the largest current.
    scale_remedy
        What to do about a wrong torque constant.
    """

    kind: str
    encoder: str
    counts: int
    counts_per_turn: float
    torque_constant: float
    most_current: float
    most_speed: float = math.inf
    minimum: float = math.nan
    maximum: float = math.nan
    encoder_setting: str
    scale_setting: str
    current_setting: str
    scale_remedy: str

    def transmission(self, model: RigModel) -> float:
        """Return the angle (rad) by which the drive's output shaft turns when the handle moves by 1 rad or 1 m."""
        return 2.0 * math.pi / (self.counts_per_turn * model.encoder.resolution)

    def ranges(self, model: RigModel) -> dict[str, tuple[int, int]]:
        """Return the range (lowest, highest) of each device parameter that the drive limits, by parameter name."""
        effort = self.most_current * self.torque_constant * self.transmission(model)
        most = min(peak_current(model), math.floor(effort / model.amplifier.effort_quantum * (1.0 + 1e-6)))
        low, high = (
            self._counts(turns, default)
            for turns, default in ((self.minimum, -EXACT_COUNTS), (self.maximum, EXACT_COUNTS))
        )
        speed = math.floor(min(self.most_speed * abs(self.counts_per_turn), EXACT_COUNTS))
        return {
            "current_limit": (0, most),
            "continuous_current": (0, most),
            "speed_limit": (0, speed),
            "window_minimum": (low, high),
            "window_maximum": (low, high),
        }

    def _counts(self, turns: float, default: int) -> int:
        counts = turns * self.counts_per_turn
        return default if math.isnan(turns) else round(max(-EXACT_COUNTS, min(EXACT_COUNTS, counts)))

    def differences(self, model: RigModel) -> Iterator[Difference]:
        """Yield each difference between the drive and the rig, as (difference, remedy)."""
        encoder, amplifier = model.encoder, model.amplifier
        if encoder.counts_per_revolution is not None:
            counts = encoder.counts_per_revolution * encoder.decoding
            if counts != self.counts:
                yield (
                    f"the drive's {self.encoder} encoder has {self.counts} counts per turn, but the experiment has "
                    f"{counts}",
                    f"set encoder.counts_per_revolution = {self.counts // encoder.decoding} with decoding "
                    f"{encoder.decoding}, or change {self.encoder_setting} of the drive",
                )
                return
        per_ampere = self.torque_constant * self.transmission(model)
        if not math.isclose(per_ampere, amplifier.effort_per_ampere, rel_tol=TORQUE_TOLERANCE):
            unit = unit_of("effort/A", model.motion)
            yield (
                f"by its calibration the motor gives {per_ampere:.4g} {unit} at the handle, but the experiment has "
                f"{amplifier.effort_per_ampere:.4g}",
                f"set amplifier.effort_per_ampere = {per_ampere:.4g} (and check encoder.ratio, the turns of the "
                f"encoder per turn of the handle), or {self.scale_remedy}",
            )
        if amplifier.drive != "current":
            yield (
                f'the drive controls the current, but the experiment has amplifier.drive = "{amplifier.drive}"',
                'set amplifier.drive = "current"',
            )
        if model.reference.index or model.reference.limit_switch != "none":
            yield (
                "the drive reports neither an encoder index nor a limit switch, but rig.reference uses one",
                "remove rig.reference; put the handle at position zero before each start",
            )
        if not amplifier.current_monitor:
            yield (
                "the drive measures its current, but the experiment has amplifier.current_monitor = false",
                "set amplifier.current_monitor = true",
            )


def refuse(differences: Iterable[Difference]) -> None:
    """Raise `DeviceRefusedError` with one sentence for each of `differences`; return if the sequence is empty."""
    wrong = list(differences)
    if wrong:
        raise DeviceRefusedError(
            "\n".join(text for text, _ in wrong), remedy="; ".join(dict.fromkeys(do for _, do in wrong))
        )
