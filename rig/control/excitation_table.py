"""The multisine that a device plays from a table of samples: computes that table bit for bit as the firmware does.

The host streams no samples: it sends a few parameters, and the device computes one period as 16-bit numbers in units of
2^−bits quanta (smallest steps of current) before the rig moves, and adds one of them to the current in each tick. The
device uses integers (firmware/law/excitation.c), so the host can compute the same table exactly.
`ExcitationTable.multisine` returns the `rig.control.excitation.Multisine` that the table approximates, and
`ExcitationTable.error` bounds the error of the approximation. The excitation is faded in by a raised cosine over `ramp`
ticks.

Measurements of impedance in `rig.experiments` use it. It must match the firmware bit for bit, and sends nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.control.excitation import Floats, Multisine
from rig.core.errors import ConfigError

Phases = Literal["hashed", "schroeder"]
PHASES: tuple[Phases, ...] = ("hashed", "schroeder")  # in the order of the parameter excitation_phases

LINE_BITS = 16  # of amplitudes and of what is played (quanta)
MOST_BITS = 15  # of the table
MOST_LINES, MOST_PERIOD, MOST_RAMP = 4_096, 65_536, 2**24
MOST_SUM = 2**38  # of all amplitudes, quanta · 2^16
GREATEST = 2**15 - 1  # of a number in the table

_TURN = 2**32
_COSINE_BITS = 24
_GAIN_BITS = 15
_QUARTER = np.rint(2**_COSINE_BITS * np.sin(0.5 * np.pi * np.minimum(np.arange(258), 256) / 256)).astype(
    np.int32
)
_SLOPE = np.diff(_QUARTER)  # below 2^17, so that a product with 14 bits fits 32
_COSINE_ERROR = 5.2e-6  # a line between 257 points of a quarter, and a phase cut to 2^-24 turns
_CHUNK = 1 << 15  # cosines at a time: what they need stays in a processor's cache

Integers = NDArray[np.int64]
Turns = NDArray[np.uint32]


def cosine(phase: Turns) -> NDArray[np.int32]:
    """Return 2^24 times the cosine of each phase; phases are in 2^−32 turns."""
    turned = phase + np.uint32(_TURN // 4)
    within = turned & np.uint32(2**30 - 1)
    x = np.where(turned & np.uint32(2**30), np.uint32(2**30) - within, within)
    at, share = x >> np.uint32(22), (x >> np.uint32(8) & np.uint32(2**14 - 1)).view(np.int32)
    value = _QUARTER[at] + (_SLOPE[at] * share >> 14)
    return np.asarray(np.where(turned & np.uint32(2**31), -value, value))


def hashed_phases(seed: int, lines: int) -> Turns:
    """Return a pseudo-random phase (2^−32 turns) at tick 0 for each spectral line, by the hash in excitation.h."""
    z = (seed + 0x9E3779B9 * np.arange(1, lines + 1, dtype=np.uint64)).astype(np.uint32)
    z = (z ^ z >> np.uint32(16)) * np.uint32(0x85EBCA6B)
    z = (z ^ z >> np.uint32(13)) * np.uint32(0xC2B2AE35)
    return np.asarray(z ^ z >> np.uint32(16))


def schroeder_phases(lines: int) -> Turns:
    """Return Schroeder's phases (2^−32 turns) of spectral lines of equal height: −j(j + 1)/2 · floor(2^32/lines)."""
    j = np.arange(lines, dtype=np.uint64)
    return (-(j * (j + np.uint64(1)) // np.uint64(2) * np.uint64(_TURN // lines)).astype(np.int64)).astype(
        np.uint32
    )


@dataclass(frozen=True)
class ExcitationTable:
    """Excitation that a device plays: the device's parameters excitation_*, and the table that it computes from them.

    Parameters
    ----------
    lines
        Number of spectral lines.
    first, step
        Harmonic of the first spectral line, and the difference between the harmonics of neighbouring spectral lines.
    period
        Length of one period (ticks).
    amplitude
        Peak of each spectral line (current quanta · 2^16).
    bits
        Fractional bits of the numbers in the table.
    ramp
        Number of ticks in which the excitation rises from zero.
    phases
        Rule for the phases, one of `PHASES`.
    seed
        Seed of the hashed phases.

    Raises
    ------
    ConfigError
        A device would reject a parameter.
    """

    lines: int
    first: int
    step: int
    period: int
    amplitude: int
    bits: int = 0
    ramp: int = 0
    phases: Phases = "schroeder"
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least, most in (
            ("lines", 1, MOST_LINES),
            ("period", 2, MOST_PERIOD),
            ("first", 1, MOST_PERIOD),
            ("step", 1, MOST_PERIOD),
            ("amplitude", 0, 2**31 - 1),
            ("bits", 0, MOST_BITS),
            ("ramp", 0, MOST_RAMP),
            ("seed", 0, _TURN - 1),
        ):
            value = getattr(self, name)
            if not least <= value <= most:
                raise ConfigError(
                    f"{name} = {value} is out of range for an excitation that the device plays",
                    remedy=f"choose {name} from {least} to {most}",
                )
        if self.phases not in PHASES:
            raise ConfigError(
                f"phases = {self.phases!r} is not a rule for the phases",
                remedy=f"choose one of {', '.join(PHASES)}",
            )
        if int(self.harmonics[-1]) > (self.period - 1) // 2:
            raise ConfigError(
                f"the excitation has harmonic {int(self.harmonics[-1])}, which is beyond half of its period of "
                f"{self.period} ticks",
                remedy=f"end the band below harmonic {(self.period + 1) // 2}",
            )
        if self.lines * self.amplitude > MOST_SUM:
            raise ConfigError(
                f"{self.lines} lines of {self.amplitude / 2**LINE_BITS:g} quanta each exceed the largest sum of "
                f"amplitudes on a device, {MOST_SUM / 2**LINE_BITS:g} quanta",
                remedy="lower the rms or the peak of the excitation",
            )

    @classmethod
    def of(
        cls,
        multisine: Multisine,
        rate_hz: float,
        effort_quantum: float,
        *,
        ramp: int = 0,
        phases: Phases = "schroeder",
        seed: int = 0,
    ) -> ExcitationTable:
        """Return the table with the lines and the amplitude of a multisine; its phases follow the rule `phases`.

        The multisine has equally spaced lines of equal amplitude (N·m or N). `rate_hz` is the rate of the device, and
        `effort_quantum` the effort of one current quantum (N·m or N). The excitation rises from zero within `ramp`
        ticks. The rule for the phases is "schroeder" or pseudo-random (`PHASES`), then with a seed.

        Raise `ConfigError` if lines or amplitudes are not equal, the period is not a whole number of ticks, or a device
        would reject a parameter. `bits` is the largest number with which the peak fits 16 bits, so one step of the
        table is between 2^−15 and 2^−14 of the peak.
        """
        harmonics, ticks = multisine.harmonics, rate_hz * multisine.period_s
        steps = np.diff(harmonics)
        if (steps != steps[:1]).any() or np.ptp(multisine.amplitudes) > 1e-9 * multisine.amplitudes.max():
            raise ConfigError(
                "the lines of the excitation differ in spacing or amplitude; the device plays only equal ones",
                remedy='choose the spectrum "flat", or let the host run the law',
            )
        if abs(ticks - round(ticks)) > 1e-6:
            raise ConfigError(
                f"a period of {multisine.period_s:g} s is not a whole number of ticks at {rate_hz:g} Hz",
                remedy=f"choose a period that is a whole multiple of 1/({rate_hz:g} Hz)",
            )
        table = cls(
            lines=len(harmonics),
            first=int(harmonics[0]),
            step=int(steps[0]) if len(steps) else 1,
            period=round(ticks),
            amplitude=round(float(multisine.amplitudes[0]) / effort_quantum * 2**LINE_BITS),
            ramp=ramp,
            phases=phases,
            seed=seed,
        )
        return table.with_most_bits()

    def with_most_bits(self) -> ExcitationTable:
        """Return the same excitation with as many fractional bits as the 16-bit numbers of its table allow.

        Raises `ConfigError` if the peak does not fit even without fractional bits.
        """
        for bits in range(MOST_BITS, -1, -1):
            if np.abs(self._at(bits)).max() <= GREATEST:
                better = replace(self, bits=bits)
                better.__dict__["_sums"] = self._sums  # they do not depend on the bits, and take a while
                return better
        raise ConfigError(
            f"the peak of the excitation exceeds {GREATEST} current quanta",
            remedy="lower the rms or the peak of the excitation",
        )

    @property
    def harmonics(self) -> Integers:
        """Return the harmonic number (multiple of 1/period) of each spectral line, shape (lines,)."""
        return self.first + self.step * np.arange(self.lines, dtype=np.int64)

    @property
    def line_phases(self) -> Turns:
        """Return the phase of each spectral line at tick 0 (2^−32 turns), shape (lines,)."""
        return (
            schroeder_phases(self.lines)
            if self.phases == "schroeder"
            else hashed_phases(self.seed, self.lines)
        )

    @cached_property
    def table(self) -> NDArray[np.int16]:
        """Return one period of the excitation as the device stores it (current quanta · 2^bits), shape (period,)."""
        return np.clip(self._at(self.bits), -GREATEST - 1, GREATEST).astype(np.int16)

    @property
    def values(self) -> Floats:
        """Return one period of the excitation (in current quanta, the device's smallest steps), shape (period,)."""
        return np.asarray(self.table, np.float64) * 2.0**-self.bits

    @property
    def peak(self) -> float:
        """Return the largest magnitude of the excitation (in current quanta, the device's smallest steps)."""
        return float(np.abs(self.values).max())

    @property
    def rms(self) -> float:
        """Return the excitation's root mean square over a period (in current quanta, the device's smallest steps)."""
        return float(np.sqrt(np.mean(self.values**2)))

    @property
    def error(self) -> float:
        """Return an upper bound (current quanta) of the difference between the table and the multisine it approximates.

        It is half a step of the table, plus for each spectral line the error of its cosine (5.2e-6 of the amplitude)
        and of its phase (at most 2^−32 turns for each line before it, plus two).
        """
        phase: float = 2.0 * math.pi / _TURN * (self.lines * (self.lines + 3) / 2)
        return 0.5 * 2.0**-self.bits + self.amplitude * 0.5**LINE_BITS * (self.lines * _COSINE_ERROR + phase)

    def multisine(self, rate_hz: float, effort_quantum: float) -> Multisine:
        """Return the multisine (N·m or N) that the table approximates.

        `rate_hz` is the device's rate (Hz), `effort_quantum` the effort of one current quantum (N·m or N).
        """
        amplitude = self.amplitude * 0.5**LINE_BITS * effort_quantum
        turns = np.asarray(self.line_phases.astype(np.int32), np.float64)  # from -1/2 to 1/2
        return Multisine(
            self.period / rate_hz,
            np.asarray(self.harmonics, np.float64) * (rate_hz / self.period),
            np.full(self.lines, amplitude),
            turns * (2.0 * np.pi / _TURN),
        )

    def efforts(self, effort_quantum: float) -> Floats:
        """Return one period of the excitation (N·m or N), shape (period,), for `rig.control.bilateral.excited_law`."""
        return self.values * effort_quantum

    def played(self, ticks: ArrayLike) -> Integers:
        """Return the current (quanta · 2^16) that the device adds at given ticks of the excitation, faded in."""
        tick = np.asarray(ticks, dtype=np.int64)
        gain = np.full(tick.shape, 1 << _GAIN_BITS, np.int64)
        if self.ramp > 0:
            rising = tick < self.ramp
            turned = (tick[rising] * (2**31 // self.ramp)).astype(np.uint32)
            gain[rising] = 2**_COSINE_BITS - cosine(turned) >> _COSINE_BITS + 1 - _GAIN_BITS
        sampled = self.table[tick % self.period].astype(np.int64)
        return np.asarray(sampled * gain * 2 ** (LINE_BITS - _GAIN_BITS) >> self.bits)

    def parameters(self) -> dict[str, int]:
        """Return the device parameters of this excitation by name (``excitation_lines`` and so on)."""
        values = asdict(self) | {"phases": PHASES.index(self.phases)}
        return {f"excitation_{name}": int(value) for name, value in values.items()}

    @cached_property
    def _sums(self) -> Integers:
        sums = np.empty(self.period, np.int64)
        line, own = np.arange(self.lines, dtype=np.uint32), self.line_phases
        for ticks in _chunks(self.period, self.lines):
            first, step = (
                (ticks * harmonic % self.period * _TURN // self.period).astype(np.uint32)
                for harmonic in (self.first, self.step)
            )
            sums[ticks] = cosine(first[:, None] + line * step[:, None] + own).sum(axis=1, dtype=np.int64)
        return sums

    def _at(self, bits: int) -> Integers:
        shift = _COSINE_BITS + LINE_BITS - bits
        return (self._sums * self.amplitude >> shift - 1) + 1 >> 1


def _chunks(period: int, lines: int) -> Iterator[Integers]:
    length = max(1, _CHUNK // lines)
    for start in range(0, period, length):
        yield np.arange(start, min(start + length, period), dtype=np.int64)
