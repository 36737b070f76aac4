"""Fit inertia, delay and the first structural mode to excited motion, by least squares in the frequency domain.

The motor's effort F is known, the position X is measured with an encoder's noise. So the fit minimises the error of X
(output error: noise in X then causes no bias), weighted at each line by the error's variance over the realisations:

    X = H·P·F − P·S,    P = 1/(s·(m·s + b)) · (s²/ω_a² + 2ζ_a·s/ω_a + 1)/(s²/ω_r² + 2ζ_r·s/ω_r + 1)

H is the delay of the effort: whole ticks and a first-order lag. The second factor of P is used for a rig of two masses
with a sensor beside the motor: at the anti-resonance ω_a the link vibrates while the motor stands still, at the
resonance ω_r motor and link vibrate against each other, and m·(ω_a/ω_r)² is the motor's share of the inertia. S is
Coulomb friction: the levels from sliding, with the sign of the measured velocity. A rigid handle is then simulated with
the fitted values: it also sticks at its reversals, with less friction than the level. If this explains the motion
better, its friction is S; with the full level the inertia of koul-rigid was 0.17 % too large in every realisation.

Under voltage drive the acting effort is H·F minus the back-EMF b_e·s·X behind the lag L, so P is replaced by 1/(1/P +
b_e·s·L). b_e must be given, because the motion of a rigid rig does not separate it from b.

If the frequency band ends below the mode, the second factor is 1 + c·s²: the compliance of the mode above the band. It
is part of the model if the 95 % interval of c is above zero; left out, it would appear as inertia and delay.

An effort that is held between samples has images around each multiple of the rate, whose motion folds back onto the
lines; the first two images on each side are part of the model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.analysis.identification._interval import Interval, from_left_out, from_scatter
from rig.analysis.identification._quality import (
    LARGEST_UNEXPLAINED,
    LEAST_LINES,
    Band,
    IdentificationError,
    check_excited,
    check_explained,
)
from rig.analysis.identification._sliding import Sliding
from rig.analysis.impedance._signals import Complexes, ExcitedRun, Floats, hold
from rig.core.deferred import optimize
from rig.core.present import reported

IMAGES = (-2, -1, 0, 1, 2)
# Number of lines over which a variance is averaged.
NEIGHBOURS = 5
ROUNDS = 3  # of fit and weights
# A mode is accepted if it reduces the weighted error by this factor.
MODE_GAIN = 1.5
# Resonance over anti-resonance; below this ratio the two cancel each other.
LEAST_SPLIT = 1.05
# Largest damping ratio of a mode; more damping is no vibration.
LARGEST_RATIO = 0.5
# Share of Coulomb friction over effort (rms) by which friction may still miss the inertia, by the source of its sign.
# Measured velocity: a handle that sticks has less friction than its level, and the link behind an elastic drive
# reverses at other times than the motor; 83 random rigid rigs came out too heavy by 2 % of the share (median; 90 % of
# them by −2 to 8 %).
# Simulated: with steps of 12.5 instead of 50 µs nine of these moved by 0.2 to 0.5 % of it (2026-11-29).
MEASURED_BIAS, SIMULATED_BIAS = 0.05, 0.005
# If no model explains the whole band, this share of its lines is tried next.
SHORTER = 0.75
# Least number of steps per second of simulated friction.
STEP_HZ = 20_000.0
# Times that friction is simulated with the fitted values, and the fit repeated.
PASSES = 2

M, B, LAG, F_A, ZETA_A, F_R, ZETA_R = range(7)  # parameters
# Parameter c = 1/ω² of a rigid body with a mode above the band, in the place of the mode's parameters.
COMPLIANCE = 3
# Number of parameters of each model, by which `compliance` distinguishes them.
RIGID, COMPLIANT, TWO_MASS = 3, 4, 7

Runs = slice | NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class StructuralMode:
    """First structural mode (elastic vibration) of motor and link, measured by a sensor beside the motor.

    Attributes
    ----------
    antiresonance_hz
        Frequency at which the link vibrates while the motor stands still (Hz).
    resonance_hz
        Frequency at which motor and link vibrate against each other (Hz).
    antiresonance_ratio, resonance_ratio
        Damping ratios of anti-resonance and resonance.
    motor_inertia, link_inertia
        Motor's share m·(f_a/f_r)² of the total inertia m, and the link's share, the rest of m (kg·m² or kg).
    stiffness
        Stiffness of the transmission, link inertia·ω_a² (N·m/rad or N/m).
    """

    antiresonance_hz: Interval
    resonance_hz: Interval
    antiresonance_ratio: Interval
    resonance_ratio: Interval
    motor_inertia: Interval
    link_inertia: Interval
    stiffness: Interval


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Inertia, damping, delay and structural mode of a rig, as fitted by `fit_dynamics`.

    Attributes
    ----------
    inertia
        Inertia of all moving parts (kg·m² or kg).
    damping
        Viscous damping without back-EMF (N·m·s/rad or N·s/m): as given to the fit, otherwise fitted.
    delay_s
        Delay from a sample to the effort that is computed from it (s): whole ticks plus lag, without the half tick of
        the hold.
    delay_ticks, lag_s
        The two parts of the delay: whole ticks, and the time constant of a first-order lag (s).
    mode
        First structural mode, or None if a rigid body explains the motion as well.
    mode_above_hz
        Anti-resonance of a mode above the band (Hz), estimated from its compliance within the band; None if that
        compliance is not significant.
    band
        The range of excited spectral lines that was fitted.
    lines_hz, coherence
        Fitted lines (Hz), and coherence γ² of motion and excitation at each spectral line, shape (n,).
    measured, fitted
        Position over effort at the spectral lines (rad/(N·m) or m/N), without friction but with the delay: mean over
        the realisations, and the model, shape (n,).
    deviation
        Standard deviation of the magnitude of `measured` over the realisations, shape (n,).
    unexplained
        Share of the velocity (rms over the lines) that follows the effort but not the model; noise is not counted.
    """

    inertia: Interval
    damping: Interval
    delay_s: Interval
    delay_ticks: int
    lag_s: Interval
    mode: StructuralMode | None
    mode_above_hz: float | None
    band: Band
    lines_hz: Floats
    coherence: Floats
    measured: Complexes
    fitted: Complexes
    deviation: Floats
    unexplained: float

    def later(self, ticks: int, tick_s: float) -> Dynamics:
        """Return this result with a delay longer by `ticks` periods `tick_s` (s) of the control loop."""
        delay = Interval(self.delay_s.value + ticks * tick_s, self.delay_s.ci95)
        s = 2j * np.pi * self.lines_hz
        late = np.exp(-s * ticks * tick_s)
        return replace(
            self,
            delay_s=delay,
            delay_ticks=self.delay_ticks + ticks,
            measured=self.measured * late,
            fitted=self.fitted * late,
        )

    @reported
    def coherence_median(self) -> float:
        """Return the median coherence γ² of motion and excitation over the excited frequencies."""
        return float(np.median(self.coherence))


def fit_dynamics(
    runs: Sequence[ExcitedRun],
    *,
    resolution: float,
    inertia: float,
    sliding: Sliding | None = None,
    damping: Interval | None = None,
    back_emf: float = 0.0,
) -> Dynamics:
    """Fit inertia, damping, delay and, if it is significant, the first structural mode.

    Parameters
    ----------
    runs
        Realisations of one excitation in whole periods; `effort` is the motor's effort, `position` the measured one.
    resolution
        Travel for one count (rad or m).
    inertia
        Start value of the fit, right within a factor of ten (kg·m² or kg).
    sliding
        Result of `fit_sliding` with the Coulomb friction to remove; None if the rig has no Coulomb friction.
    damping
        Known viscous damping (N·m·s/rad or N·s/m), such as `Sliding.damping`; None to fit it.
    back_emf
        Damping by back-EMF under voltage drive (N·m·s/rad or N·s/m); it acts behind the fitted lag.

    Raises
    ------
    IdentificationError
        The motion is too small, drifts or is not coherent with the excitation, or no model of one or two masses
        explains it.
    """
    whole, found = check_excited(runs, resolution)
    start = np.array([inertia, 0.0 if damping is None else damping.value, 0.0])
    free = [M, LAG] if damping is not None else [M, B, LAG]
    lines, band = whole.lines, whole
    while True:
        chosen = [replace(run, lines_hz=run.lines_hz[band.chosen]) for run in runs]
        problem = _Problem.of(chosen, resolution, sliding, back_emf)
        problem, best, freed = problem.best(start, free)
        lines = int(SHORTER * lines)
        if best.unexplained <= LARGEST_UNEXPLAINED or lines < LEAST_LINES:
            break
        band = whole.shorter(runs[0].lines_hz, lines, "no model of one or two masses explains the motion")
    check_explained(best.unexplained)
    return _dynamics(problem, best, freed, band, found[band.chosen], damping, sliding)


@dataclass(frozen=True, eq=False)
class _Fit:
    parameters: Floats
    ticks: int
    weights: Floats  # standard deviation of the position at each line
    costs: Floats  # mean square of each run's error under the weights of the problem's noise
    unexplained: float = math.nan

    @property
    def cost(self) -> float:
        return float(self.costs.mean())


@dataclass(frozen=True, eq=False)
class _Problem:
    """Data of the least-squares fit: spectra of position, effort and friction, shape (runs, spectral lines)."""

    lines: Floats
    rate: float
    # The lines and the frequencies that sampling folds onto them, shape (images, lines).
    images: Floats
    # Gain of the hold from an effort's samples to each of these frequencies.
    held: Complexes
    position: Complexes
    effort: Complexes
    friction: Complexes
    # Noise of the encoder in a line of the position.
    floor: float
    back_emf: float
    efforts: Floats  # mean period of each run, shape (runs, samples)
    sliding: Sliding | None
    bias: float = MEASURED_BIAS

    @classmethod
    def of(
        cls, runs: Sequence[ExcitedRun], resolution: float, sliding: Sliding | None, back_emf: float
    ) -> _Problem:
        spectra = [_spectra(run, sliding) for run in runs]
        first = runs[0]
        samples = first.period_samples * first.periods
        which = IMAGES if first.effort_hold_s else (0,)
        images = first.lines_hz + first.rate_hz * np.array(which)[:, np.newaxis]
        return cls(
            lines=first.lines_hz,
            rate=first.rate_hz,
            images=images,
            held=hold(images, first.effort_hold_s),
            position=np.array([one[0] for one in spectra]),
            effort=np.array([one[1] for one in spectra]),
            friction=np.array([one[2] for one in spectra]),
            # The quantisation noise of a sample is Δ/√12, and a bin is scaled by 2/n.
            floor=resolution / math.sqrt(3.0 * samples),
            back_emf=back_emf,
            efforts=np.array([run.effort.reshape(run.periods, -1).mean(axis=0) for run in runs]),
            sliding=sliding,
        )

    def sticking(self, fit: _Fit) -> _Problem:
        """Return the data with Coulomb friction as simulated on a rigid handle with fitted values, which can stick."""
        assert self.sliding is not None
        steps = math.ceil(STEP_HZ / self.rate)  # of a tick
        step_s = 1.0 / (steps * self.rate)
        efforts = np.roll(np.repeat(self.efforts, steps, axis=1), steps * fit.ticks, axis=1)
        friction = np.fft.rfft(
            [simulate_friction(one, step_s, fit.parameters, self.back_emf, self.sliding) for one in efforts]
        )
        bins = np.rint(self.lines * efforts.shape[1] * step_s).astype(np.int64)
        lines = 2.0 / efforts.shape[1] * friction[:, bins] * hold(self.lines, step_s)
        return replace(self, friction=lines, bias=SIMULATED_BIAS)

    def gain(self, parameters: Floats, ticks: int) -> Complexes:
        """Return the model's position over effort (rad/(N·m) or m/N) at the excited frequencies, delay included."""
        late = _delay_response(self.images, parameters, ticks / self.rate)
        return np.asarray((self.held * late * self.answer(self.images, parameters)).sum(axis=0))

    def answer(self, frequency_hz: Floats, parameters: Floats) -> Complexes:
        """Return the rig's position over acting effort (rad/(N·m) or m/N), with back-EMF but without delay and hold."""
        free = compliance(frequency_hz, parameters)
        if self.back_emf == 0.0:
            return free
        s = 2j * np.pi * frequency_hz
        return np.asarray(
            1.0 / (1.0 / free + self.back_emf * s * _delay_response(frequency_hz, parameters, 0.0))
        )

    def error(self, parameters: Floats, ticks: int, which: Runs = slice(None)) -> Complexes:
        predicted = self.gain(parameters, ticks) * self.effort[which]
        return self.position[which] - predicted + self.answer(self.lines, parameters) * self.friction[which]

    def solve(
        self, start: Floats, free: Sequence[int], ticks: int, weights: Floats, which: Runs = slice(None)
    ) -> Floats:
        """Return all model parameters after a least-squares fit of those with the indices `free`."""
        # Units of their own size: the parameters span ten orders of magnitude.
        size = np.abs(start)
        size[B] = max(size[B], 1e-3 * abs(start[M]) * 2.0 * np.pi * self.lines[0])
        size[LAG] = 0.1 / self.rate if size[LAG] == 0.0 else size[LAG]
        if len(start) == COMPLIANT:
            size[COMPLIANCE] = (2.0 * math.pi * self.lines[-1]) ** -2

        def parameters(x: Floats) -> Floats:
            whole = start.copy()
            whole[free] = x * size[free]
            return whole

        def weighted(x: Floats) -> Floats:
            e = (self.error(parameters(x), ticks, which) / weights).ravel()
            return np.concatenate([e.real, e.imag])

        found = optimize.least_squares(weighted, (start / size)[list(free)], x_scale="jac", max_nfev=200)
        return parameters(found.x)

    def fit(self, start: Floats, free: Sequence[int], ticks: int) -> _Fit:
        """Fit the parameters with indices `free`, each round weighted by the smoothed residuals of the last round."""
        first = self.first_weights()
        weights, parameters = first, start
        for _ in range(ROUNDS):
            parameters = self.solve(parameters, free, ticks, weights)
            residual_power = np.mean(np.abs(self.error(parameters, ticks)) ** 2, axis=0)
            weights = np.sqrt(_smooth(residual_power) + (0.3 * self.floor) ** 2)
        error = self.error(parameters, ticks)
        costs = np.mean(np.abs(error / first) ** 2, axis=1)
        return _Fit(parameters, ticks, weights, costs, self._unexplained(error))

    def first_weights(self) -> Floats:
        """Return the position's error at each line for a first fit: 2 % of the motion, and the encoder's noise."""
        return np.asarray(np.sqrt((0.02**2) * np.mean(np.abs(self.position) ** 2, axis=0) + self.floor**2))

    def _unexplained(self, error: Complexes) -> float:
        """Return the share of the rms velocity that follows the effort but not the model; `error`: its residual."""
        power = np.mean(np.abs(self.position) ** 2, axis=0)
        # Noise is not correlated with the effort: the mean over realisations removes it.
        runs, drive = len(error), np.mean(np.abs(self.effort) ** 2, axis=0)
        gain = np.mean(error * self.effort.conj(), axis=0) / drive
        noise = np.sum(np.abs(error - gain * self.effort) ** 2, axis=0) / (runs - 1)
        own = np.abs(gain) ** 2 * drive - noise / runs
        speed = self.lines**2
        return math.sqrt(max(0.0, float(np.sum(speed * own))) / float(np.sum(speed * power)))

    def with_delay(self, start: Floats, free: Sequence[int]) -> _Fit:
        """Fit the parameters with indices `free` and a delay of 0, 1, … ticks plus a lag; return the best fit."""
        fits = self.by_delay(self.fit(start, free, 0), free)
        best = min(fits, key=lambda fit: fit.cost)
        return self.fit(best.parameters, free, best.ticks)

    def by_delay(self, near: _Fit, free: Sequence[int]) -> list[_Fit]:
        """Return a fit for each delay of 0, 1, … whole ticks, up to the one that leaves no positive lag."""
        period, weights = 1.0 / self.rate, self.first_weights()
        total = near.ticks + near.parameters[LAG] / period
        fits: list[_Fit] = []
        for ticks in range(max(1, math.floor(total + 1.5))):
            start = near.parameters.copy()
            start[LAG] = max(total - ticks, 0.0) * period
            parameters = self.solve(start, free, ticks, weights)
            costs = np.mean(np.abs(self.error(parameters, ticks) / weights) ** 2, axis=1)
            if not fits or parameters[LAG] > -0.1 * period:
                fits.append(_Fit(parameters, ticks, weights, costs))
        return fits

    def alike(self, best: _Fit, free: Sequence[int]) -> list[tuple[Floats, float]]:
        """Return how fits with other whole ticks of delay, equally good within scatter, differ from the best fit.

        Each is a difference of the parameters, and of the delay (s).
        """
        fits = self.by_delay(best, free)
        own = next((fit for fit in fits if fit.ticks == best.ticks), fits[0])
        return [
            (fit.parameters - own.parameters, (fit.ticks - own.ticks) / self.rate)
            for fit in fits
            if from_scatter(0.0, fit.costs - own.costs).ci95 > np.mean(fit.costs - own.costs)
        ]

    def best(self, start: Floats, free: Sequence[int]) -> tuple[_Problem, _Fit, Sequence[int]]:
        """Select a model: rigid body, two masses, or rigid body with a compliance.

        Return the data with the friction of this model, its fit, and the indices of its fitted parameters.
        """
        rigid = self.with_delay(start, free)
        mode_start = self.mode_start(rigid.parameters)
        if mode_start is not None:
            freed = [*free, F_A, ZETA_A, F_R, ZETA_R]
            two = self.with_delay(mode_start, freed)
            if _is_plausible_mode(two, rigid, self.lines):
                return self, two, freed
        problem = self
        for _ in range(PASSES if self.sliding is not None else 0):
            sticking = self.sticking(rigid)
            again = sticking.with_delay(rigid.parameters, free)
            if again.cost >= rigid.cost:
                break
            problem, rigid = sticking, again
        freed = [*free, COMPLIANCE]
        # A tick of delay more and less of lag looks like a compliance: it must show without one, too.
        above = problem.fit(np.array([*rigid.parameters, 0.0]), freed, rigid.ticks)
        for _ in range(2):
            others = [one[COMPLIANCE] for one in problem.left_out(above, freed)]
            if not from_left_out(above.parameters[COMPLIANCE], others).low > 0.0:
                return problem, rigid, free
            above = problem.with_delay(above.parameters, freed)
        return problem, above, freed

    def left_out(self, fit: _Fit, free: Sequence[int]) -> list[Floats]:
        """Return the parameters fitted without each realisation in turn (jackknife)."""
        runs = np.arange(len(self.position))
        return [self.solve(fit.parameters, free, fit.ticks, fit.weights, runs != i) for i in runs]

    def shifted(self, fit: _Fit, free: Sequence[int], damping: Interval | None) -> tuple[Floats, Floats]:
        """Return parameters refitted with damping, then with friction, at the upper end of its 95 % interval."""
        start, sliding, harder = fit.parameters.copy(), self.sliding, 1.0
        if damping is not None and math.isfinite(damping.ci95):
            start[B] += damping.ci95
        if sliding is not None and sliding.coulomb.value > 0.0 and math.isfinite(sliding.coulomb.ci95):
            harder += sliding.coulomb.ci95 / sliding.coulomb.value
        rubbed = replace(self, friction=self.friction * harder)
        return (
            self.solve(start, free, fit.ticks, fit.weights),
            rubbed.solve(fit.parameters, free, fit.ticks, fit.weights),
        )

    def mode_start(self, rigid: Floats) -> Floats | None:
        """Return start values for a model with a structural mode, from its notch and peak; None without these."""
        level = np.mean(np.abs(self.position), axis=0) / np.mean(np.abs(self.effort + 0.0), axis=0)
        flat = np.log(level * rigid[M] * (2.0 * np.pi * self.lines) ** 2 + 1e-300)
        flat = _smooth(flat - np.median(flat[: max(3, len(flat) // 4)]), 3)
        if len(flat) < 8:
            return None
        peak = int(np.argmax(flat[2:])) + 2
        notch = int(np.argmin(flat[:peak])) if peak > 1 else 0
        if not self.lines[notch] < self.lines[peak]:
            return None
        return np.array([*rigid, self.lines[notch], 0.03, self.lines[peak], 0.03])


def compliance(frequency_hz: Floats, parameters: Floats) -> Complexes:
    """Return position over effort (rad/(N·m) or m/N) per frequency (Hz), without friction, back-EMF and delay."""
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    p = 1.0 / (s * (parameters[M] * s + parameters[B]))
    if len(parameters) == COMPLIANT:
        p = p * (1.0 + parameters[COMPLIANCE] * s**2)
    if len(parameters) == TWO_MASS:
        a, r = s / (2.0 * np.pi * parameters[F_A]), s / (2.0 * np.pi * parameters[F_R])
        p = p * (1.0 + 2.0 * parameters[ZETA_A] * a + a**2) / (1.0 + 2.0 * parameters[ZETA_R] * r + r**2)
    return np.asarray(p)


def simulate_friction(
    effort: Floats, step_s: float, parameters: Floats, back_emf: float, sliding: Sliding
) -> Floats:
    """Return the Coulomb friction of a rigid handle in the last of three periods of `effort` (both N·m or N)."""
    mass, damping, lag_s = parameters[M], parameters[B], max(0.0, parameters[LAG])
    up, down = sliding.up.value, -sliding.down.value
    kept = math.exp(-step_s / lag_s) if lag_s > 0.0 else 0.0
    mobility = step_s / (mass + step_s * damping)
    lagging, inertial = (1.0 - kept) * lag_s / step_s, mass / step_s
    acting = velocity = 0.0
    found = []
    for sent in np.tile(effort, 3).tolist():
        target = sent - back_emf * velocity
        stopping = velocity * inertial + target + (acting - target) * lagging
        acting = target + (acting - target) * kept
        friction = down if stopping < down else up if stopping > up else stopping
        velocity = mobility * (stopping - friction)
        found.append(friction)
    return np.array(found[-len(effort) :])


def _delay_response(frequency_hz: Floats, parameters: Floats, delay_s: float) -> Complexes:
    s = 2j * np.pi * frequency_hz
    return np.asarray(np.exp(-s * delay_s) / (1.0 + s * parameters[LAG]))


def _spectra(run: ExcitedRun, sliding: Sliding | None) -> tuple[Complexes, Complexes, Complexes]:
    """Return position, effort and Coulomb friction at the spectral lines (complex), recorded delays removed."""
    n = run.period_samples
    whole = np.fft.rfft(run.level_position().reshape(run.periods, n).mean(axis=0))
    frequency = np.asarray(np.fft.rfftfreq(n, 1.0 / run.rate_hz), dtype=np.float64)
    # Above the last line there is only noise, which would reverse the sign of friction.
    excited = frequency <= run.lines_hz[-1] * (1.0 + 1e-9)
    velocity = np.fft.irfft(np.where(excited, run.velocity_gain(frequency) * whole, 0.0), n)
    effort = np.fft.rfft(run.effort.reshape(run.periods, n).mean(axis=0))
    rubbing = np.zeros(n)
    if sliding is not None:
        rubbing = np.where(velocity > 0.0, sliding.up.value, -sliding.down.value)
    friction = np.fft.rfft(rubbing)
    late = np.exp(2j * np.pi * run.lines_hz * run.position_delay_s)
    earlier = np.exp(2j * np.pi * run.lines_hz * run.effort_delay_s)
    scale, k = 2.0 / n, run.bins
    return scale * whole[k] * late, scale * effort[k] * earlier, scale * friction[k]


def _smooth(values: Floats, width: int = NEIGHBOURS) -> Floats:
    width = min(width, len(values))
    ends = (width // 2, width - 1 - width // 2)
    return np.convolve(np.pad(values, ends, mode="edge"), np.full(width, 1.0 / width), "valid")


def _is_plausible_mode(two: _Fit, rigid: _Fit, lines_hz: Floats) -> bool:
    _, _, _, f_a, zeta_a, f_r, zeta_r = two.parameters
    inside = lines_hz[0] < f_a and LEAST_SPLIT * f_a < f_r < lines_hz[-1]
    swings = 0.0 < zeta_a < LARGEST_RATIO and 0.0 < zeta_r < LARGEST_RATIO
    return inside and swings and rigid.cost > MODE_GAIN * two.cost


def _dynamics(
    problem: _Problem,
    best: _Fit,
    free: Sequence[int],
    band: Band,
    found: Floats,
    damping: Interval | None,
    sliding: Sliding | None,
) -> Dynamics:
    others, shifted = problem.left_out(best, free), problem.shifted(best, free, damping)
    correlation = 0.0 if sliding is None else sliding.correlation
    alike = problem.alike(best, free)

    def interval(of: Callable[[Floats], float], by_tick: float = 0.0) -> Interval:
        value = of(best.parameters)
        scatter = from_left_out(value, [of(one) for one in others])
        split = max(
            (abs(of(best.parameters + change) - value + by_tick * late) for change, late in alike),
            default=0.0,
        )
        sides = [of(one) - value for one in shifted]
        # Strokes give both: where one is too large the other is too small, and their effects cancel in part.
        given = math.hypot(*sides) ** 2 + 2.0 * correlation * sides[0] * sides[1]
        return Interval(value, math.hypot(scatter.ci95, split, math.sqrt(max(0.0, given))))

    mode = None
    if len(best.parameters) == TWO_MASS:
        mode = StructuralMode(
            antiresonance_hz=interval(lambda p: float(p[F_A])),
            resonance_hz=interval(lambda p: float(p[F_R])),
            antiresonance_ratio=interval(lambda p: float(p[ZETA_A])),
            resonance_ratio=interval(lambda p: float(p[ZETA_R])),
            motor_inertia=interval(_motor_inertia),
            link_inertia=interval(lambda p: float(p[M]) - _motor_inertia(p)),
            stiffness=interval(_stiffness),
        )
    inertia = interval(lambda p: float(p[M]))
    if sliding is not None:
        effort = math.sqrt(0.5 * float(np.mean(np.sum(np.abs(problem.effort) ** 2, axis=1))))
        missed = problem.bias * max(0.0, sliding.coulomb.value) / effort * inertia.value
        inertia = Interval(inertia.value, math.hypot(inertia.ci95, missed))
    if not inertia.value > 0.0:
        raise IdentificationError(
            f"the fit gives an inertia of {inertia.value:.3g} kg·m² or kg; it must be above 0",
            remedy="check the signs of motor and encoder, and the delay of the link",
        )
    lag, delay = (interval(lambda p: float(p[LAG]), by_tick) for by_tick in (0.0, 1.0))
    gain, path = problem.gain(best.parameters, best.ticks), problem.answer(problem.lines, best.parameters)
    ratio = (problem.position + path * problem.friction) / problem.effort
    return Dynamics(
        inertia=inertia,
        damping=damping or interval(lambda p: float(p[B])),
        delay_s=Interval(best.ticks / problem.rate + lag.value, delay.ci95),
        delay_ticks=best.ticks,
        lag_s=lag,
        mode=mode,
        mode_above_hz=_mode_above_hz(best.parameters),
        band=band,
        lines_hz=problem.lines,
        coherence=found,
        measured=ratio.mean(axis=0),
        fitted=gain,
        deviation=np.sqrt(0.5 * np.mean(np.abs(ratio - ratio.mean(axis=0)) ** 2, axis=0)),
        unexplained=best.unexplained,
    )


def _mode_above_hz(p: Floats) -> float | None:
    return float(p[COMPLIANCE] ** -0.5 / (2.0 * math.pi)) if len(p) == COMPLIANT else None


def _motor_inertia(p: Floats) -> float:
    return float(p[M] * (p[F_A] / p[F_R]) ** 2)


def _stiffness(p: Floats) -> float:
    return float((p[M] - _motor_inertia(p)) * (2.0 * np.pi * p[F_A]) ** 2)
