"""Signals of an excited rig: one realisation of an excitation and its response, in whole periods.

Channels need not be taken at the same instant, nor stand still between samples. Each says how late it is, and an
effort that was held says for how long; both are undone in the frequency domain, exactly, because the record is
periodic. At 4 kHz one sample of misalignment turns the phase by 9° at 100 Hz, which is more than most walls have
left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import ConfigError

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

ON_GRID = 1e-6  # of a line spacing


@dataclass(frozen=True, eq=False)
class ExcitedRun:
    """One realisation: whole periods of excitation and answer, transients cut.

    Attributes
    ----------
    rate_hz
        Sampling rate of all channels (Hz).
    period_samples, periods
        Samples in a period of the excitation, and how many periods there are.
    excitation
        Commanded excitation at the instants of the samples: the instrument r. Only its phase and size at the lines
        matter.
    effort
        Effort that the world applied to the handle, as measured or known (N·m or N), positive along the position.
    position
        Position of the handle (rad or m), measured or true.
    lines_hz
        Excited lines (Hz), multiples of rate/period_samples below half the rate.
    effort_delay_s, position_delay_s
        How late each channel is: sample k shows what was at k/rate − delay. Below zero, what is still to come.
    effort_hold_s
        How long each sample of the effort then stood (s), 0 for an effort that is sampled and not held. The held
        effort has at the lines sin(πfT)/(πfT)·e^{−jπfT} of its samples.

    All arrays have shape (period_samples · periods,).
    """

    rate_hz: float
    period_samples: int
    periods: int
    excitation: Floats
    effort: Floats
    position: Floats
    lines_hz: Floats
    effort_delay_s: float = 0.0
    position_delay_s: float = 0.0
    effort_hold_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("excitation", "effort", "position", "lines_hz"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.float64))
        samples = self.period_samples * self.periods
        if samples < 1 or not self.rate_hz > 0.0:
            raise ConfigError(
                "the record has no samples or no sampling rate", remedy="excite for whole periods"
            )
        for name in ("excitation", "effort", "position"):
            channel = getattr(self, name)
            if channel.shape != (samples,):
                raise ConfigError(
                    f"{name} has shape {channel.shape}; {self.periods} periods of "
                    f"{self.period_samples} samples need {samples}",
                    remedy="cut the record to whole periods",
                )
            if not np.isfinite(channel).all():
                raise ConfigError(f"{name} contains a value that is not a number", remedy="measure again")
        off = np.abs(self.lines_hz * self.period_samples / self.rate_hz - self.bins)
        inside = len(self.bins) and self.bins[0] >= 1 and 2 * self.bins[-1] < self.period_samples
        if not inside or (np.diff(self.bins) < 1).any() or off.max() > ON_GRID:
            raise ConfigError(
                "the lines are not ascending multiples of 1/period below half the rate",
                remedy="give the lines of the excitation",
            )

    @property
    def bins(self) -> NDArray[np.int64]:
        """Return the bin of each line in the transform of one period."""
        return np.rint(self.lines_hz * self.period_samples / self.rate_hz).astype(np.int64)

    def effort_gain(self, frequency_hz: Floats) -> Complexes:
        """Return the factor from the effort's transform to that of the acting effort, at time 0 of a sample."""
        late = np.exp(2j * np.pi * frequency_hz * self.effort_delay_s)
        return np.asarray(late * hold(frequency_hz, self.effort_hold_s))

    def velocity_gain(self, frequency_hz: Floats) -> Complexes:
        """Return jω·e^{jω·delay}: from the position's transform to that of the velocity at time 0 of a sample."""
        s = 2j * np.pi * frequency_hz
        return np.asarray(s * np.exp(s * self.position_delay_s))

    def level_position(self) -> Floats:
        """Return the position less its mean and, with two periods or more, its steady drift.

        A free rig wanders while it excites. The drift is the mean change from a sample to the one a period later,
        which is zero for whatever is periodic. Left in, the jump from the record's end to its start adds drift to
        every line of the velocity.
        """
        centred = self.position - self.position.mean()
        if self.periods < 2:
            return np.asarray(centred)
        n = self.period_samples
        slope = float(np.mean(centred[n:] - centred[:-n])) / n
        steps = np.arange(len(centred)) - 0.5 * (len(centred) - 1)
        return np.asarray(centred - slope * steps)


def hold(frequency_hz: Floats, hold_s: float) -> Complexes:
    """Zero-order hold (1 − e^{−sT})/(sT) at s = j2πf: what a sample that stands for T has of itself at f."""
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    return np.asarray(np.sinc(frequency * hold_s) * np.exp(-1j * np.pi * frequency * hold_s))
