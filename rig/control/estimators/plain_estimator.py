"""A velocity estimator from a plain function.

    @rig.estimator(memory=("slope",))
    def two_slopes(travel: float, elapsed_s: float, memory: rig.Memory) -> float:
        before, memory.slope = memory.slope, travel / elapsed_s
        return 0.5 * (before + memory.slope)

What an encoder does to numbers is dealt with around the function: a 32-bit counter that wraps, the sign of the
resolution, lost samples, and the first sample, which has no predecessor and reads zero.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence

from rig.control.estimators._fdm import count_difference
from rig.control.estimators.estimator import OWN_INTS, PERIOD, RESOLUTION, WINDOW, Estimator, Setting
from rig.control.plain_functions import NO_NUMBERS, Form, Parameter, compile_function
from rig.realtime.kernel import kernel, prepare
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

STARTED, PREVIOUS = OWN_INTS, OWN_INTS + 1  # state_i
_LARGEST = sys.float_info.max

_FORM = Form(
    kind="estimator",
    quantities={
        "travel": ("way since the sample before (rad or m)", f"moved * parameters[{RESOLUTION}]"),
        "elapsed_s": ("time since then (s)", f"elapsed_ticks * parameters[{PERIOD}]"),
        "edge_age_s": ("time since the last encoder edge (s)", "edge_age_s"),
        "effort": ("mean effort of the motor since the sample before (N·m or N)", "effort"),
    },
    given=("resolution", "period_s"),  # parameters[RESOLUTION], parameters[PERIOD]
    memory="state_f[:{count}]",
    around=f"""
def estimator(count, edge_age_s, elapsed_ticks, effort, state_f, state_i, parameters):
    moved = count_difference(count, state_i[{PREVIOUS}])
    state_i[{PREVIOUS}] = count
    if state_i[{STARTED}] == 0:
        state_i[{STARTED}] = 1
        return 0.0
    state_i[{WINDOW}] = elapsed_ticks
    return {{call}}
""",
    names={"count_difference": count_difference},
)


def estimator(
    *,
    parameters: Mapping[str, float | Parameter] = NO_NUMBERS,
    memory: Sequence[str] = (),
    name: str | None = None,
    source: str = "",
) -> Callable[[Callable[..., float]], Estimator]:
    """Make a velocity estimator of a plain function, compiled here and now.

    The function returns the velocity (rad/s or m/s). It names what it needs: ``travel`` since the sample before (rad or
    m), ``elapsed_s`` since then, ``edge_age_s`` (since the last encoder edge), ``effort`` (mean of the motor's effort
    since the sample before, N·m or N), ``memory`` and ``p``, which has ``p.resolution`` (one count; its sign is the
    encoder's) and ``p.period_s`` beside the estimator's own.

    Parameters
    ----------
    parameters
        Settings by name: a default, or a `Parameter` with range, unit and meaning. An experiment sets them under
        ``[controller.parameters]``.
    memory
        Names of what it remembers; each is zero when a run begins.
    name
        In experiments and recordings; that of the function, with hyphens, unless given.
    source
        Where it comes from: paper and equation.

    Raises
    ------
    ConfigError
        A function that names something else, or that cannot be compiled: with its line, and what to do.
    """

    def decorate(function: Callable[..., float]) -> Estimator:
        made = compile_function(_FORM, function, name, parameters, memory)
        update = kernel(ESTIMATOR_SIGNATURE, cache=False, no_refcount=True)(made.kernel)
        prepare(update)
        return Estimator(
            name=made.name,
            summary=made.summary,
            source=source,
            update=update,
            floats=len(made.memory),
            ints=PREVIOUS + 1,
            settings=tuple(_setting(one, parameter) for one, parameter in made.parameters.items()),
            design=lambda settings, resolution, period_s: [settings[one] for one in made.parameters],
        )

    return decorate


def _setting(name: str, parameter: Parameter) -> Setting:
    low, high = max(parameter.minimum, -_LARGEST), min(parameter.maximum, _LARGEST)
    return Setting(name, parameter.default, low, high, parameter.unit, parameter.meaning)
