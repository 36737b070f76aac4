"""Check the requirements on a force law; `check_law` raises an error for the first violation.

The error is an AssertionError with a sentence, so no test runner is needed. Arguments declare intended exceptions, such
as a law that acts outside of the wall. Tests of a lab's own laws call it. It must not depend on pytest.
"""

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.config import Wall
from rig.control import laws
from rig.control.laws import Law, PreparedLaw
from rig.control.plain_law import PlainLaw
from rig.realtime.plugs import LAW_CLAMPED
from rig.testing import _law_arrays as arrays
from rig.testing._compiled import allocations, guarded

Floats = NDArray[np.float64]

WALL: Mapping[str, Any] = asdict(Wall(stiffness=300.0, damping=0.5))
TICK_S = 1.0 / 20_000
# Amplitudes of the tested motions: rad and rad/s, or m and m/s.
DEPTH, SPEED = 0.01, 0.5
# 5e-324 is the smallest subnormal double: its square and its ratio to 1e6 are exactly 0.
EXTREMES = (0.0, 5e-324, 1e-12, 1.0, 1e3, 1e6)
TICKS = 400
# Penetration of one press into the wall and out again, relative to its depth.
_CYCLE = np.sin(np.pi * np.arange(TICKS + 1) / TICKS) ** 2


def reactions(
    law: Law | str, penetration: ArrayLike, velocity: ArrayLike | float = 0.0, **wall: Any
) -> Floats:
    """Return the force or torque (N or N·m) of a law in each tick, as an array; the law starts with zeroed memory.

    Parameters
    ----------
    law
        The law or its name.
    penetration, velocity
        Penetration (rad or m) and velocity (rad/s or m/s) in each tick.
    **wall
        Settings of the wall, such as ``stiffness=300.0``, and ``tick_s`` (s).
    """
    depth = np.ascontiguousarray(penetration, dtype=np.float64)
    return _run(_prepare(law, wall), depth, np.broadcast_to(velocity, depth.shape).astype(np.float64))


def check_law(
    law: Law | str, *, everywhere: bool | None = None, pulls: bool = False, passive: bool = True, **wall: Any
) -> None:
    """Run all checks of this file on a force law; raise AssertionError for the first that fails.

    Parameters
    ----------
    law
        The law or its name.
    everywhere
        True if the law may act outside of the wall, too; None: as the law's own decorator (``@rig.law``) declares.
    pulls
        True if the law may pull a handle at rest into the wall.
    passive
        True if the law must return no more energy than it received; False for a law that drives the handle.
    **wall
        Settings of the wall, such as ``stiffness=300.0``, and ``tick_s`` (s).
    """
    acts_outside = isinstance(law, PlainLaw) and law.everywhere if everywhere is None else everywhere
    check_memory(law, wall)
    check_restart(law, wall)
    check_one_by_one(law, wall)
    check_finite(law, wall)
    if not acts_outside:
        check_outside(law, wall)
    if not pulls:
        check_at_rest(law, wall)
    if passive:
        check_passive(law, wall)


def check_memory(law: Law | str, wall: Mapping[str, Any]) -> None:
    """Check that the arrays of a law are flat and finite, and that a run writes only to its memory."""
    fresh = _prepare(law, wall)
    for array in (fresh.parameters, fresh.state):
        assert array.dtype == "float64", "wrong type of array"
        assert array.ndim == 1, "not a flat array"
    assert np.isfinite(fresh.parameters).all(), "a parameter is not finite"
    assert not fresh.state.any(), "memory of a fresh law is not zero"
    state, untouched = guarded(fresh.state)
    parameters, kept = guarded(fresh.parameters)
    watched = replace(fresh, state=state, parameters=parameters)
    depth, speed = _motion()
    needed = allocations(lambda: _run(watched, depth, speed))
    twice = np.tile(depth, 2), np.tile(speed, 2)
    assert allocations(lambda: _run(watched, *twice)) == needed, "the law allocates while it runs"
    assert untouched(), "the law writes outside of its memory"
    assert kept(), "the law writes outside of its parameters"
    assert (parameters == fresh.parameters).all(), "the law changes its parameters"
    assert state[LAW_CLAMPED] in (0.0, 1.0), "state[LAW_CLAMPED] is neither 0 nor 1"


def check_restart(law: Law | str, wall: Mapping[str, Any]) -> None:
    """Check that a law repeats its results exactly after its memory is set to zero, also next to a second instance."""
    one, depth, speed = _prepare(law, wall), *_motion()
    fresh = _run(one, depth, speed)
    one.state[:] = 0.0
    assert (_run(one, depth, speed) == fresh).all(), "a restart differs from a fresh law"
    one.state[:] = 0.0
    two, both = _prepare(law, wall), np.empty(len(depth))
    for k in range(len(depth)):
        both[k] = _run(one, depth[k : k + 1], speed[k : k + 1])[0]
        _run(two, depth[k : k + 1], -speed[k : k + 1])
    assert (both == fresh).all(), "a law is disturbed by another of its kind"


def check_one_by_one(law: Law | str, wall: Mapping[str, Any]) -> None:
    """Check that single calls of a law return the same forces as calls in a compiled loop."""
    one, depth, speed = _prepare(law, wall), *_motion()
    alone = [
        one.law.function(float(d), float(v), 1, one.state, one.parameters)
        for d, v in zip(depth, speed, strict=True)
    ]
    assert alone == _run(_prepare(law, wall), depth, speed).tolist(), "differs inside a compiled loop"


def check_finite(law: Law | str, wall: Mapping[str, Any]) -> None:
    """Check that the law's force is finite for any penetration, velocity and number of lost ticks."""
    random = np.random.default_rng(3)
    values = np.array([sign * value for value in EXTREMES for sign in (-1.0, 1.0)])
    depth, speed = random.choice(values, TICKS), random.choice(values, TICKS)
    elapsed = random.integers(1, 5000, TICKS)
    force = arrays.run(_prepare(law, wall), depth, speed, elapsed)
    assert np.isfinite(force).all(), _where(
        "gives a reaction that is not finite", ~np.isfinite(force), depth, speed
    )


def check_outside(law: Law | str, wall: Mapping[str, Any]) -> None:
    """Check that the law's force outside of the wall is zero, before and after a contact."""
    depth, speed = _motion()
    outside = np.concatenate([-depth, depth, -depth])
    force = _run(_prepare(law, wall), outside, np.concatenate([speed, speed, -speed]))
    acts = (outside <= 0.0) & (force != 0.0)
    assert not acts.any(), _where("acts outside of the wall", acts, outside, force)


def check_at_rest(law: Law | str, wall: Mapping[str, Any]) -> None:
    """Check that the law does not pull a handle at rest further into the wall."""
    depth = np.linspace(0.0, DEPTH, TICKS)
    force = _run(_prepare(law, wall), depth, np.zeros(TICKS))
    assert (force >= 0.0).all(), _where("pulls a handle at rest into the wall", force < 0.0, depth, force)


def check_passive(law: Law | str, wall: Mapping[str, Any]) -> None:
    """Check that a law returns no more energy than it received when the handle moves into the wall and out again.

    A slow and a fast motion are tested. The work of a step is the mean of two forces times the travel between them,
    which is exact for a spring.
    """
    for slower in (1.0, 1000.0):
        tick_s = slower * TICK_S
        depth = DEPTH * _CYCLE
        speed = np.gradient(depth, tick_s)
        force = _run(_prepare(law, {**wall, "tick_s": tick_s}), depth, speed)
        work = 0.5 * (force[1:] + force[:-1]) * np.diff(depth)
        returned_energy = -float(work.sum())
        assert returned_energy <= 1e-9 * float(np.abs(work).sum()), (
            f"gives {returned_energy:.3g} J in a cycle {DEPTH:g} deep that lasts {TICKS * tick_s:.3g} s: it "
            "feeds energy into the handle"
        )


def _prepare(law: Law | str, wall: Mapping[str, Any]) -> PreparedLaw:
    known = laws.get(law) if isinstance(law, str) else law
    return known.prepare({**WALL, "tick_s": TICK_S, **wall})


def _run(prepared: PreparedLaw, depth: Floats, speed: Floats) -> Floats:
    return arrays.run(prepared, depth, speed, np.ones(len(depth), np.int64))


def _motion() -> tuple[Floats, Floats]:
    """Return penetration (rad or m) and velocity (rad/s or m/s) of a simulated contact with ringing."""
    time = np.linspace(0.0, 1.0, TICKS)
    depth = DEPTH * (np.sin(3.0 * np.pi * time) + 0.2 * np.sin(40.0 * np.pi * time))
    return depth, SPEED * np.cos(40.0 * np.pi * time)


def _where(what: str, bad: NDArray[np.bool_], depth: Floats, other: Floats) -> str:
    k = int(np.flatnonzero(bad)[0]) if bad.any() else 0
    return f"{what}: penetration {depth[k]:.6g}, beside it {other[k]:.6g}"
