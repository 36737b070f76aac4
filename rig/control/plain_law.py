"""Make a force law from a plain function.

    @rig.law(parameters={"quadratic": 1e5})
    def stiffening(penetration: float, velocity: float, p: rig.Parameters) -> float:
        return p.stiffness * penetration + p.quadratic * penetration**2 + p.damping * velocity

Users call it as ``rig.law``, and `rig.testing.laws` checks such laws. It must not run a law: a trial or a replay does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rig.control.law import Law
from rig.control.plain_functions import NO_NUMBERS, Form, Parameter, compile_function, unknown_name
from rig.core.present import Item, Row
from rig.realtime.kernel import kernel, prepare
from rig.realtime.plugs import LAW_CLAMPED, LAW_SIGNATURE

OWN_STATE = LAW_CLAMPED + 1  # the law's own memory begins here
GIVEN = ("stiffness", "damping", "tick_s")  # of every `p`

_INSIDE = f"""
def law(penetration, velocity, elapsed_ticks, state, parameters):
    state[{LAW_CLAMPED}] = 0.0
    if penetration <= 0.0:
        return 0.0
    return {{call}}
"""
_EVERYWHERE = _INSIDE.replace("    if penetration <= 0.0:\n        return 0.0\n", "")


def _form(everywhere: bool) -> Form:
    return Form(
        kind="law",
        quantities={
            "penetration": ("depth inside the wall (rad or m)", "penetration"),
            "velocity": ("estimated velocity (rad/s or m/s), positive inwards", "velocity"),
            "elapsed_s": (
                "time since the call before (s)",
                f"elapsed_ticks * parameters[{GIVEN.index('tick_s')}]",
            ),
        },
        given=GIVEN,
        memory=f"state[{OWN_STATE}:{OWN_STATE} + {{count}}]",
        around=_EVERYWHERE if everywhere else _INSIDE,
        names={},
    )


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class PlainLaw(Law):
    """A force law made from a user's plain function; its parameters have names.

    `parameters` are those that the law has besides the stiffness and damping of the wall. An experiment that names the
    law uses their defaults; `with_parameters` returns a law with other values.
    """

    parameters: Mapping[str, Parameter]
    everywhere: bool

    def brief(self) -> list[Item]:
        """Return name, summary and parameters of the law, for display."""
        rows = [Row(name, one.default, one.unit, one.meaning) for name, one in self.parameters.items()]
        return [f"law {self.name}: {self.summary}", *rows]

    def with_parameters(self, **values: float) -> PlainLaw:
        """Return the law with other values of its parameters; raise `ConfigError` for a wrong name or value."""
        changed = dict(self.parameters)
        for name, value in values.items():
            if name not in changed:
                raise unknown_name(f"law {self.name!r}", "parameter", name, changed)
            changed[name] = replace(
                changed[name], default=changed[name].checked(f"law {self.name!r}", name, value)
            )
        return replace(self, parameters=changed, design=_design(changed))


def law(
    *,
    parameters: Mapping[str, float | Parameter] = NO_NUMBERS,
    memory: Sequence[str] = (),
    name: str | None = None,
    everywhere: bool = False,
) -> Callable[[Callable[..., float]], PlainLaw]:
    """Return a decorator that makes a force law of a plain function and compiles it at once.

    The function returns the reaction of the wall (N·m or N), positive towards free space. Its arguments select what is
    passed: ``penetration`` (rad or m), ``velocity`` (estimated, of the penetration, rad/s or m/s), ``elapsed_s`` (since
    the previous call, s), ``memory``, and ``p`` with the parameters of the law and ``p.stiffness``, ``p.damping`` and
    ``p.tick_s`` (one tick, s).

    Parameters
    ----------
    parameters
        Parameters of the law by name: a default, or a `Parameter` with range, unit and meaning.
    memory
        Names of the numbers that the law stores from call to call; each is zero when a run begins.
    name
        Name in experiments and recordings; default: name of the function, with hyphens.
    everywhere
        True: call the function outside of the wall too, where penetration is negative. False: the reaction outside is
        zero.

    Raises
    ------
    ConfigError
        An argument has an unknown name, or the function cannot be compiled; the message has the line and the remedy.
    """

    def decorate(function: Callable[..., float]) -> PlainLaw:
        made = compile_function(_form(everywhere), function, name, parameters, memory)
        # Not cached: sources outside of this project are not part of the cache's key.
        declared = kernel(LAW_SIGNATURE, cache=False, no_refcount=True)(made.kernel)
        prepare(declared)
        return PlainLaw(
            name=made.name,
            summary=made.summary,
            function=declared,
            floats=OWN_STATE + len(made.memory),
            design=_design(made.parameters),
            parameters=made.parameters,
            everywhere=everywhere,
        )

    return decorate


def _design(parameters: Mapping[str, Parameter]) -> Callable[[Mapping[str, Any]], list[float]]:
    values = [parameter.default for parameter in parameters.values()]

    def design(wall: Mapping[str, Any]) -> list[float]:
        return [*(wall[name] for name in GIVEN), *values]

    return design
