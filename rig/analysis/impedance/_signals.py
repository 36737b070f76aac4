"""Signals of an excited rig: one realisation (draw of the phases) of an excitation and its response, in whole periods.

Effort and position may be sampled at different instants: each channel has a delay, and a held effort has a hold time.
Delay and hold are removed in the frequency domain, which is exact because the record is periodic. At 4 kHz one sample
of misalignment turns the phase by 9° at 100 Hz, more than the phase margin of most walls.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import ConfigError

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# A line may differ from a multiple of the line spacing by this share of the spacing.
ON_GRID = 1e-6


@dataclass(frozen=True, eq=False)
class ExcitedRun:
    """Record of one realisation: whole periods of the excitation and of the rig's response, without transients.

    Excitation, effort and position have shape (period_samples · periods,).

    Attributes
    ----------
    rate_hz
        Sampling rate of all channels (Hz).
    period_samples, periods
        Number of samples in a period of the excitation, and number of periods.
    excitation
        Commanded excitation at the instants of the samples, the instrument r of the estimate.
    effort
        External effort on the handle, measured or known (N·m or N), positive in the direction of the position.
    position
        Position of the handle (rad or m), measured or exact.
    lines_hz
        Excited lines (frequencies in Hz), multiples of rate/period_samples below half the rate.
    effort_delay_s, position_delay_s
        Delay of each channel (s): sample k shows the value at time k/rate − delay. A negative delay is allowed.
    effort_hold_s
        Time T for which each sample of the effort is held (s); 0 for an effort that is sampled and not held. At
        frequency f the transform of the held effort is sin(πfT)/(πfT)·e^{−jπfT} times the transform of its samples.
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
                f"the record has {samples} samples at {self.rate_hz:g} Hz; both must be above 0",
                remedy="record at least one whole period of the excitation",
            )
        for name in ("excitation", "effort", "position"):
            channel = getattr(self, name)
            if channel.shape != (samples,):
                raise ConfigError(
                    f"{name} has shape {channel.shape}; {self.periods} periods of "
                    f"{self.period_samples} samples need {samples}",
                    remedy="cut the record to a whole number of periods",
                )
            if not np.isfinite(channel).all():
                raise ConfigError(
                    f"{name} contains NaN or infinity; all samples must be finite", remedy="measure again"
                )
        off = np.abs(self.lines_hz * self.period_samples / self.rate_hz - self.bins)
        inside = len(self.bins) and self.bins[0] >= 1 and 2 * self.bins[-1] < self.period_samples
        if not inside or (np.diff(self.bins) < 1).any() or off.max() > ON_GRID:
            raise ConfigError(
                f"the excited frequencies must be ascending multiples of {self.rate_hz / self.period_samples:g} Hz "
                f"(1/period), above 0 and below {self.rate_hz / 2.0:g} Hz (half the rate)",
                remedy="give the frequencies that the excitation contains (lines_hz)",
            )

    @property
    def bins(self) -> NDArray[np.int64]:
        """Return the index of each excited frequency in the Fourier transform of one period, shape (lines,)."""
        return np.rint(self.lines_hz * self.period_samples / self.rate_hz).astype(np.int64)

    def effort_gain(self, frequency_hz: Floats) -> Complexes:
        """Return the complex factor that removes the effort's delay and applies its hold, at each frequency (Hz)."""
        late = np.exp(2j * np.pi * frequency_hz * self.effort_delay_s)
        return np.asarray(late * hold(frequency_hz, self.effort_hold_s))

    def velocity_gain(self, frequency_hz: Floats) -> Complexes:
        """Return jω·e^{jω·delay} at each frequency (Hz), the factor from recorded position to undelayed velocity."""
        s = 2j * np.pi * frequency_hz
        return np.asarray(s * np.exp(s * self.position_delay_s))

    def level_position(self) -> Floats:
        """Return the position (rad or m) minus its mean and, with two periods or more, minus its steady drift."""
        centred = self.position - self.position.mean()
        if self.periods < 2:
            return np.asarray(centred)
        n = self.period_samples
        # A periodic motion has no change over a period. If a drift were left in, the jump from the record's end to its
        # start would add to every line.
        slope = float(np.mean(centred[n:] - centred[:-n])) / n
        steps = np.arange(len(centred)) - 0.5 * (len(centred) - 1)
        return np.asarray(centred - slope * steps)


def hold(frequency_hz: Floats, hold_s: float) -> Complexes:
    """Return the frequency response of a zero-order hold over `hold_s` = T (s): (1 − e^{−sT})/(sT) at s = j2πf."""
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    return np.asarray(np.sinc(frequency * hold_s) * np.exp(-1j * np.pi * frequency * hold_s))
