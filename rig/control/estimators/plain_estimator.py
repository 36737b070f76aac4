"""Make a velocity estimator from a plain function.

    @rig.estimator(memory=("slope",))
    def two_slopes(travel: float, elapsed_s: float, memory: rig.Memory) -> float:
        before, memory.slope = memory.slope, travel / elapsed_s
        return 0.5 * (before + memory.slope)

The code around the function handles the encoder: a 32-bit counter that wraps, the sign of the resolution, lost samples,
and the first sample, for which the velocity is zero.
"""

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
    """Return a decorator that makes a velocity estimator of a plain function and compiles it at once.

    The function returns the velocity (rad/s or m/s). Its arguments select what is passed: ``travel`` since the previous
    sample (rad or m), ``elapsed_s`` since then (s), ``edge_age_s`` (time since the last encoder edge, s), ``effort``
    (mean effort of the motor since the previous sample, N·m or N), ``memory``, and ``p`` with the parameters of the
    estimator, ``p.resolution`` (travel for one count, rad or m, negative if counts fall while the position rises) and
    ``p.period_s`` (s).

    Parameters
    ----------
    parameters
        Settings by name: a default, or a `Parameter` with range, unit and meaning. An experiment sets them under
        ``[controller.parameters]``.
    memory
        Names of the numbers that the estimator stores from call to call; each is zero when a run begins.
    name, source
        Name in experiments and recordings (default: that of the function, with hyphens); paper and equation.

    Raises
    ------
    ConfigError
        An argument has an unknown name, or the function cannot be compiled; the message has the line and the remedy.
    """

    def decorate(function: Callable[..., float]) -> Estimator:
        made = compile_function(_FORM, function, name, parameters, memory)
        # Not cached: sources outside of this project are not part of the cache's key.
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
            uses_effort="effort" in made.arguments,
        )

    return decorate


def _setting(name: str, parameter: Parameter) -> Setting:
    low, high = max(parameter.minimum, -_LARGEST), min(parameter.maximum, _LARGEST)
    return Setting(name, parameter.default, low, high, parameter.unit, parameter.meaning)
