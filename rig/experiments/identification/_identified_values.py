"""Compute the keys of an experiment from the fits of an identification, with a text on the source of each value.

`identify` calls this module.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from rig.analysis.identification import CoggingMap, Dynamics, Interval, Ripple, Sliding, StructuralMode
from rig.config import Experiment
from rig.core.model import Cogging, Mechanics
from rig.core.sample import unit_of


@dataclass(frozen=True)
class Identified:
    """Identified values by key, and for each key a text with the 95 % interval and the motion that was fitted."""

    values: dict[str, Any] = field(default_factory=dict)
    sources: dict[str, tuple[str, str]] = field(default_factory=dict)

    def put(self, key: str, value: Any, text: str, motion: str) -> None:
        """Set the identified value of a key, with a text on its source and the name of the motion that was fitted."""
        self.values[key] = value
        self.sources[key] = (text, motion)

    def share(self, m: Mechanics, name: str, total: float, text: str, motion: str) -> None:
        """Set both keys of a quantity: divide `total` (SI) between motor and link in the ratio of the description."""
        described = {side: float(getattr(m, f"{side}_{name}")) for side in ("motor", "link")}
        whole = sum(described.values())
        for side, before in described.items():
            part = before / whole if whole > 0.0 else float(side == "motor")
            if part > 0.0:
                words = text if part == 1.0 else f"{100 * part:.3g} % (as described) of {text}"
                self.put(f"rig.mechanics.{side}_{name}", part * total, words, motion)


def identified_values(
    experiment: Experiment,
    sliding: Sliding,
    dynamics: Dynamics,
    cogging: CoggingMap | None = None,
    ripple: Ripple | None = None,
    *,
    on_board: bool = False,
) -> Identified:
    """Return the keys of the experiment with their identified values.

    A single sensor shows only sums over motor and link. The sums are divided in the described proportion: friction and
    damping always, inertia only if no resonance was identified. If the law will run on the board (`on_board`), the
    link's delay in whole ticks is left out.
    """
    found, m = Identified(), experiment.rig.mechanics

    def unit(quantity: str) -> str:
        return unit_of(quantity, experiment.rig.motion)

    hung = m.end_mass * m.handle_radius**2
    if dynamics.mode is None:
        total = dynamics.inertia.value - hung
        found.share(m, "inertia", total, dynamics.inertia.text(unit("inertia")), "dynamics")
    else:
        _put_mode(found, m, dynamics.mode, sliding, unit("inertia"), unit("stiffness"))
    damping, coulomb = sliding.damping, sliding.coulomb
    viscous, back_emf = damping.text(unit("damping")), experiment.rig.amplifier.back_emf
    if back_emf > 0.0:
        viscous += f", beside {back_emf:g} of back-EMF as described"
    found.share(m, "damping", max(0.0, damping.value), viscous, "sliding")
    levels = f"{coulomb.text(unit('effort'))}: up {sliding.up.text()}, down {sliding.down.text()}"
    found.share(m, "coulomb", max(0.0, coulomb.value), levels, "sliding")
    found.put("rig.amplifier.lag_s", max(0.0, dynamics.lag_s.value), dynamics.lag_s.text("s"), "dynamics")
    rate = experiment.controller.position_rate
    # A law on the board does not have the delay of the link that these motions had.
    if not on_board:
        beside = experiment.rig.amplifier.set_point_ticks(1.0 / rate)  # described separately, for any rate
        ticks = max(0, dynamics.delay_ticks - beside)
        whole = f"whole ticks at {rate} Hz; total delay {dynamics.delay_s.text('s')}"
        found.put("rig.simulation.computation_delay_ticks", ticks, whole, "dynamics")
    if cogging is not None:
        _put_cogging(found, cogging, experiment.rig.cogging, ripple, unit("effort"))
    return found


def _put_cogging(
    found: Identified, map_: CoggingMap, described: Cogging, ripple: Ripple | None, effort: str
) -> None:
    """Set the keys of cogging and torque ripple, which share the list of orders; an unmeasured ripple is kept."""
    if ripple is None:
        shares = _by_order(described.orders, described.ripple_cosine, described.ripple_sine)
    else:
        shares = _by_order(ripple.orders, *([i.value for i in part] for part in (ripple.cosine, ripple.sine)))
    orders = sorted({*map_.orders, *shares})
    efforts = _by_order(map_.orders, map_.cogging.cosine, map_.cogging.sine)
    cosine, sine = _columns(orders, efforts)
    certain = f"significant harmonics among those searched; others have less than {map_.unseen:.2g} {effort}"
    for key, value, words in (
        ("period", map_.period, "as described, or a turn of the motor"),
        ("orders", orders, certain),
        ("cosine", cosine, _each(map_.cosine, effort)),
        ("sine", sine, _each(map_.sine, effort)),
        ("minimum", map_.minimum, "of the sweeps"),
        ("maximum", map_.maximum, f"of the sweeps; within, the map is ± {map_.ci95:.2g} {effort}"),
    ):
        found.put(f"rig.cogging.{key}", value, words, "cogging")
    ripples = _columns(orders, shares) if shares else ([], [])
    for key, column, part in zip(("ripple_cosine", "ripple_sine"), ripples, ("cosine", "sine"), strict=True):
        found.values[f"rig.cogging.{key}"] = column
        if ripple is not None:
            words = (
                f"{_each(getattr(ripple, part), 'of the effort')}; others have less than {ripple.unseen:.2g}"
            )
            found.put(f"rig.cogging.{key}", column, words, "ripple")


def _by_order(
    orders: Sequence[int], cosine: Sequence[float], sine: Sequence[float]
) -> dict[int, tuple[float, float]]:
    return {n: (c, s) for n, c, s in zip(orders, cosine, sine, strict=False) if c or s}


def _columns(orders: Sequence[int], each: dict[int, tuple[float, float]]) -> tuple[list[float], list[float]]:
    """Return two lists, cosines and sines of the harmonics `orders`; zero for a harmonic missing in `each`."""
    rows = [each.get(n, (0.0, 0.0)) for n in orders]
    return [c for c, _ in rows], [s for _, s in rows]


def _each(values: Sequence[Interval], unit: str) -> str:
    return ", ".join(value.text() for value in values) + f" {unit}" if values else "none"


def _put_mode(
    found: Identified, m: Mechanics, mode: StructuralMode, sliding: Sliding, inertia: str, stiffness: str
) -> None:
    link, motor, hertz = mode.link_inertia, mode.motor_inertia, mode.resonance_hz
    hung = m.end_mass * m.handle_radius**2
    described = m.motor_damping + m.link_damping
    share = m.motor_damping / described if described > 0.0 else 1.0
    # The mode's damping ratio includes the viscous damping that the strokes have already measured: it would count
    # twice.
    moving = link.value / (link.value + motor.value)  # fraction of the mode's motion that is at the motor
    viscous = share * sliding.damping.value * moving / (4.0 * math.pi * hertz.value * motor.value)
    ratio = min(max(mode.resonance_ratio.value - viscous, 0.0), 0.99)
    text = f"{mode.resonance_ratio.text()} of the mode, less the viscous damping; Coulomb friction adds to it"
    for key, value, words in (
        ("structure", "two-mass", f"a mode at {hertz.text('Hz')}"),
        ("motor_inertia", motor.value, motor.text(inertia)),
        ("link_inertia", link.value - hung, link.text(inertia)),
        ("transmission_stiffness", mode.stiffness.value, mode.stiffness.text(stiffness)),
        ("transmission_damping_ratio", ratio, text),
    ):
        found.put(f"rig.mechanics.{key}", value, words, "dynamics")
