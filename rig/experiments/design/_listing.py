"""List every sampling scheme that a design considers, without those that the link or the board cannot run.

`_search` calls this module. The list has no estimators that need edge times, no hybrid estimators, no fixed-point
arithmetic, and no velocity rate that adapts to the speed, because such a rate narrows the range of stable walls.
Schemes that the rules of the experiment, the device or its link refuse are left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

from rig.config import Experiment, controller, prepare_estimator
from rig.config.schemes import Scheme
from rig.core.check import refused
from rig.core.errors import ConfigError
from rig.doctor.gate_result import ticks_late
from rig.experiments.design import _paths as paths
from rig.experiments.trials.plan import link_checks
from rig.experiments.trials.planned import check_positive
from rig.firmware.tick_budget import BOARD, named_budget

Loop = Literal["host", "device"]
Settings = dict[str, float | str]

POSITION_RATES = (1000, 2000, 5000, 10_000, 20_000, 50_000)  # Hz
# Velocity rates are position rates divided by these numbers, at least SLOWEST (Hz).
DIVIDERS = (1, 2, 5, 10, 20)
SLOWEST = 500
CUTOFFS_HZ = tuple(float(f"{50.0 * 2 ** (n / 2):.3g}") for n in range(14))
# Lowest and highest cut-off as fractions of the velocity rate.
LOWEST_SHARE, HIGHEST_SHARE = 1 / 200, 2 / 5
# Longest windows of the estimators with adaptive windows (velocity periods).
WINDOWS = (8.0, 16.0)
# Levant's differentiator and the estimator *optimal* need a bound of the acceleration: these fractions of the largest
# acceleration that the motor can produce.
ACCELERATIONS = (0.1, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class LawPlace:
    """A place where the control law may run (host or device), and the limits of this place.

    Attributes
    ----------
    loop
        ``"host"`` (this computer) or ``"device"``.
    rate_maximum
        Highest position rate (Hz).
    bytes_per_second
        Capacity of the link; None: unlimited.
    round_trip_s
        Time from a sample to its effort if the host runs the law (s); the delay is rounded up to whole ticks, at least
        one. None: the delay that the experiment describes.
    board
        Name of the board whose processor cycles are estimated if the device runs the law.
    """

    loop: Loop
    rate_maximum: int
    bytes_per_second: float | None = None
    round_trip_s: float | None = None
    board: str = BOARD

    def delay_ticks(self, experiment: Experiment, rate: int) -> int:
        """Return the delay from a sample to the effort computed from it (ticks), at the position rate `rate` (Hz)."""
        if self.loop == "host" and self.round_trip_s is not None:
            return ticks_late(self.round_trip_s, rate, experiment.host.pacing)
        return experiment.rig.simulation.computation_delay_ticks

    def allows(self, applied: Experiment) -> bool:
        """Return True if this place (host or device) and its link can run the experiment's law at its rate."""
        try:
            if self.loop == "device":
                controller.prepare_controller(applied)
                if not paths.fits_a_tick(applied.controller, self.board):
                    return False
            return not refused(link_checks(applied, self.rate_maximum, self.bytes_per_second))
        except ConfigError:
            return False


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A candidate for the recommended design: a sampling scheme, and the place where the control law runs.

    Attributes
    ----------
    scheme
        Rates, estimator with its settings, and whether the velocity is held or extrapolated between samples.
    loop, delay_ticks
        Place of the law (``"host"`` or ``"device"``), and delay of its effort in ticks, without the amplifier's delay.
    board
        Name of the board whose processor cycles are estimated if the device runs the law.
    """

    scheme: Scheme
    loop: Loop
    delay_ticks: int
    board: str = BOARD

    @cached_property
    def key(self) -> str:
        """Return a unique name for the file of results: host or device, delay, sampling scheme."""
        return f"{self.loop} {self.delay_ticks} {self.scheme.text}"

    def condition(self, experiment: Experiment) -> Experiment:
        """Return the experiment with this candidate's place of the law (host, device) and delay, not its scheme."""
        rig = experiment.rig
        late = replace(rig.simulation, computation_delay_ticks=self.delay_ticks)
        return replace(
            experiment,
            rig=replace(rig, simulation=late),
            controller=replace(experiment.controller, loop=self.loop),
        )

    def applied(self, experiment: Experiment) -> Experiment:
        """Return the experiment with this candidate's scheme, place and delay; raise `ConfigError` if invalid."""
        return self.scheme.applied(self.condition(experiment))

    def same_law(self, other: Candidate, experiment: Experiment) -> bool:
        """Return True if both candidates run the same law, even if the texts of their sampling schemes differ."""
        return (self.loop, self._rates) == (other.loop, other._rates) and self.law(experiment) == other.law(
            experiment
        )

    @property
    def _rates(self) -> tuple[int, int]:
        return self.scheme.position_rate, self.scheme.velocity_rate

    def law(self, experiment: Experiment) -> tuple[Any, ...]:
        """Return the settings that distinguish two laws: host or device, delay, rates, estimator and its parameters."""
        applied, resolution = self.applied(experiment), experiment.rig.encoder.resolution
        own = applied.controller
        numbers = prepare_estimator(applied, resolution, 1.0 / own.velocity_rate).parameters.tolist()
        adaptive = (own.slow_below, own.slow_velocity_rate) if own.slow_below > 0.0 else None
        rates = own.position_rate, own.velocity_rate
        return (self.loop, self.delay_ticks, *rates, own.estimator, own.prediction, adaptive, *numbers)

    @classmethod
    def own(cls, experiment: Experiment, places: Sequence[LawPlace] = ()) -> Candidate:
        """Return the candidate with the experiment's own sampling scheme, host or device, and the delay there."""
        own = experiment.controller
        there = next((place for place in places if place.loop == own.loop), places_for(experiment)[0])
        delay = there.delay_ticks(experiment, own.position_rate)
        return cls(scheme=Scheme.of(experiment), loop=own.loop, delay_ticks=delay, board=there.board)


def places_for(
    experiment: Experiment,
    where: Literal["host", "device", "both"] | None = None,
    *,
    rate_maximum: int | None = None,
    bytes_per_second: float | None = None,
    round_trip_s: float | None = None,
    board: str = BOARD,
) -> tuple[LawPlace, ...]:
    """Return where a control law may run, with the given limits of board and link; no device is opened.

    `where` defaults to the experiment's choice (host or device), `rate_maximum` (Hz) to its position rate. Raise
    `ConfigError` for an unknown board, and `PlanError` for a limit that is not above 0.
    """
    named_budget(board)
    check_positive({"most_rate": rate_maximum, "link": bytes_per_second, "round_trip": round_trip_s})
    loops: tuple[Loop, ...] = (
        ("host", "device") if where == "both" else (where or experiment.controller.loop,)
    )
    return tuple(
        LawPlace(
            loop=loop,
            rate_maximum=rate_maximum or experiment.controller.position_rate,
            bytes_per_second=bytes_per_second,
            round_trip_s=round_trip_s if loop == "host" else None,
            board=board,
        )
        for loop in loops
    )


def listed(
    experiment: Experiment, places: Sequence[LawPlace], schemes: Sequence[Scheme] = ()
) -> tuple[Candidate, ...]:
    """Return a candidate for each place (host, device) and scheme that can run there; no `schemes`: all built-in ones.

    Raises
    ------
    ConfigError
        One of the given `schemes` is invalid.
    """
    found: dict[str, Candidate] = {}
    for place in places:
        for scheme in schemes or _schemes(experiment, place.rate_maximum):
            delay = place.delay_ticks(experiment, scheme.position_rate)
            candidate = Candidate(scheme=scheme, loop=place.loop, delay_ticks=delay, board=place.board)
            try:
                applied = candidate.applied(experiment)
            except ConfigError:
                if schemes:
                    raise
                continue
            if place.allows(applied):
                found.setdefault(candidate.key, candidate)
    return tuple(found.values())


def _schemes(experiment: Experiment, rate_maximum: int) -> Iterator[Scheme]:
    own = experiment.controller.position_rate
    for fast in sorted({*POSITION_RATES, own}):
        if fast > rate_maximum:
            return
        for slow in [fast // n for n in DIVIDERS if fast % n == 0 and fast // n >= SLOWEST]:
            for name, settings in _estimators(experiment, slow):
                # Extrapolation has an effect only between two velocity samples.
                for prediction in ("hold",) if slow == fast else ("hold", "extrapolate"):
                    yield Scheme(
                        position_rate=fast,
                        velocity_rate=slow,
                        estimator=name,
                        parameters=settings,
                        prediction=prediction,  # type: ignore[arg-type]  # one of the two
                        slow_below=0.0,
                    )


def _estimators(experiment: Experiment, rate: int) -> Iterator[tuple[str, Settings]]:
    cutoffs = [hz for hz in CUTOFFS_HZ if LOWEST_SHARE * rate <= hz <= HIGHEST_SHARE * rate]
    yield "fdm", {}
    for hz in cutoffs:
        yield "fdm-butterworth", {"cutoff_hz": hz, "order": 1.0}
        yield "fdm-butterworth", {"cutoff_hz": hz, "order": 2.0}
        yield "kalman", {"bandwidth_hz": hz, "gain": "steady"}
    for window in WINDOWS:
        yield "foaw-end", {"window_limit": window}
        yield "foaw-best", {"window_limit": window}
    largest = experiment.rig.limits.effort / experiment.rig.mechanics.inertia
    for share in ACCELERATIONS:
        lipschitz = float(f"{share * largest:.2g}")
        yield "levant", {"lipschitz": lipschitz}
        yield "optimal", {"lipschitz": lipschitz}
