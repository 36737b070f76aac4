"""Export a designed velocity estimator as C99 code: an excerpt of the firmware's sources with the designed numbers.

The numbers are those of a law on the device (`rig.config.device_law`), so the exported code and the firmware of this
package compute the same estimator. The export of estimators calls it. It must not contain the algorithm of an
estimator: that is in the firmware's sources.
"""

import re
from dataclasses import dataclass

import numpy as np

from firmware_protocol.excerpt import excerpt, renamed
from firmware_protocol.parameter import Value
from rig.config.device_law import check_values
from rig.control.estimators import PERIOD, RESOLUTION, Prepared
from rig.control.on_device import NotOnDeviceError, estimator_parameters, velocity_format
from rig.core.errors import ConfigError
from rig.firmware._boards import FIRMWARE

LAW = FIRMWARE / "law"
HEADERS = ("law.h", "estimators.h", "numbers.h")  # whose needed lines are exported
ALWAYS = "law_count_difference"  # the function that each estimator needs
FIXED = "fdm-butterworth-fixed"  # the only estimator in integers


@dataclass(frozen=True, slots=True)
class _Form:
    """The C code of an estimator: source file, struct types (numbers, memory), call, functions to export."""

    source: str
    numbers: str
    memory: str
    call: str
    wanted: tuple[str, ...]


def _observer(effort: str, kind: str = "law_kalman") -> _Form:
    call = f"e->started ? {kind}_run(&e->memory, &NUMBERS, (float)moved, slope, {effort}, elapsed) : 0.0f"
    return _Form("observers.c", kind, f"{kind}_state", call, (f"{kind}_run",))


_FORMS = {
    FIXED: _Form(
        "filters.c",
        "law_biquad",
        "law_biquad_state",
        "law_biquad_run(&e->memory, &NUMBERS, moved, elapsed)",
        ("law_biquad_run", "law_biquad_reset", "law_shifts_must_be_arithmetic"),
    ),
    "fdm": _Form("filters.c", "", "", "slope", ()),
    "fdm-butterworth": _Form(
        "filters.c",
        "law_low_pass",
        "law_low_pass_state",
        "law_low_pass_run(&e->memory, &NUMBERS, slope, elapsed)",
        ("law_low_pass_run",),
    ),
    "foaw-end": _Form(
        "foaw.c",
        "law_foaw",
        "law_foaw_state",
        "law_foaw_end(&e->memory, &NUMBERS, count, elapsed, &e->window)",
        ("law_foaw_end",),
    ),
    "foaw-best": _Form(
        "foaw.c",
        "law_foaw",
        "law_foaw_state",
        "law_foaw_best(&e->memory, &NUMBERS, count, elapsed, &e->window)",
        ("law_foaw_best",),
    ),
    "levant": _Form(
        "observers.c",
        "law_levant",
        "law_levant_state",
        "e->started ? law_levant_run(&e->memory, &NUMBERS, slope, elapsed) : 0.0f",
        ("law_levant_run",),
    ),
    "kalman": _observer("0.0f"),
    "tracking": _observer("0.0f"),
    "disturbance": _observer("NUMBERS.input * effort"),
    "disturbance-two-mass": _observer("NUMBERS.input * effort", "law_two_mass"),
}
# Members of law.h that are not called as the device parameter without the prefix of its structure.
_MEMBERS = {f"kalman_{gain}": f"gain_{gain}" for gain in ("position", "velocity", "acceleration")}


@dataclass(frozen=True, slots=True)
class EstimatorC:
    """A velocity estimator exported as C code.

    Attributes
    ----------
    prefix
        Prefix of all exported names, such as ``kalman`` in ``kalman_begin``, ``kalman_velocity``, ``kalman_estimator``.
    returns
        C type of the velocity.
    scale
        Velocity (rad/s or m/s) of a returned 1.0, or of one LSB if the type is an integer.
    code
        C text with includes, declarations and functions; the public functions are at the end.
    uses_effort
        True if the function ``…_velocity`` has the effort as an argument after the count.
    """

    prefix: str
    returns: str
    scale: float
    code: str
    uses_effort: bool


def estimator_c(prepared: Prepared) -> EstimatorC:
    """Return a designed estimator as C code.

    Raise `ConfigError` if the firmware has no such estimator, or does not support these settings of it; the message
    gives the reason.
    """
    name = prepared.estimator.name
    try:
        values = estimator_parameters(prepared)
        check_values(values)
    except NotOnDeviceError as error:
        raise ConfigError(
            f"the estimator {name} cannot be exported as C: {error.why}", remedy=error.instead
        ) from None
    form, prefix = _FORMS[name], re.sub(r"\W", "_", name)
    per_count = float(prepared.parameters[RESOLUTION] / prepared.parameters[PERIOD])
    in_integers = name == FIXED
    sources = [LAW / file for file in (*HEADERS, form.source)]
    parts = excerpt(sources, (ALWAYS, *form.wanted), prefix)
    blocks = (
        parts,
        _define_numbers(form, values),
        _define_functions(form, prefix, in_integers=in_integers, per_count=per_count),
    )
    text = "\n".join(block for block in blocks if block)
    includes = ["stdint.h", *(["math.h"] if re.search(r"\b(sqrtf|fabsf)\b", parts) else [])]
    code = "\n".join(f"#include <{each}>" for each in sorted(includes)) + "\n\n" + _prefix_names(text, prefix)
    scale = per_count * velocity_format(prepared).lsb if in_integers else 1.0
    return EstimatorC(
        prefix, "int32_t" if in_integers else "float", scale, code, prepared.estimator.uses_effort
    )


def _prefix_names(text: str, prefix: str) -> str:
    return re.sub(r"\blaw_\w+", lambda found: renamed(found[0], prefix), text).replace(
        "NUMBERS", f"{prefix}_numbers"
    )


def _define_numbers(form: _Form, values: dict[str, Value]) -> str:
    """Return the C definition of the constant struct with the designed numbers; "" if the estimator has no numbers."""
    if not form.numbers:
        return ""
    if form.numbers == "law_low_pass":
        return _low_pass(values)
    prefix = f"{form.numbers.removeprefix('law_')}_"
    own = {_MEMBERS.get(name, name.removeprefix(prefix)): value for name, value in values.items()}
    del own["estimator"]
    if form.numbers == "law_foaw":
        own.setdefault("least_squares", 0)
    return _define_struct(form.numbers, [f".{name} = {_literal(value)}," for name, value in own.items()])


def _low_pass(values: dict[str, Value]) -> str:
    order = int(values["low_pass_order"])
    sections = (order + 1) // 2
    lines = [f".sections = {sections},", ".section = {"]
    for n in range(1, sections + 1):
        numbers = [_literal(values.get(f"low_pass_{part}_{n}", 0.0)) for part in ("inner", "band", "low")]
        lines.append(f"    {{{', '.join(numbers)}, {1 if 2 * n > order else 2}}},")
    return _define_struct("law_low_pass", [*lines, "},"])


def _define_struct(kind: str, lines: list[str]) -> str:
    body = "\n".join(f"    {line}" for line in lines)
    return f"/* As designed. */\nstatic const {kind} NUMBERS = {{\n{body}\n}};\n"


def _literal(value: Value) -> str:
    return c_float(value) if isinstance(value, float) else str(value)


def c_float(value: float) -> str:
    """Return a value as a C constant of type float, with the fewest digits that read back as the same float32."""
    return f"{np.float32(value)!s}f"


def _define_functions(form: _Form, prefix: str, *, in_integers: bool, per_count: float) -> str:
    returns = "int32_t" if in_integers else "float"
    members = [f"{form.memory} memory;"] if form.memory else []
    members += (
        ["uint32_t window; /* velocity periods that the last estimate spans */"]
        if "window" in form.call
        else []
    )
    members += ["int32_t previous; /* count of the last call */", "int started;"]
    body = ["const int32_t moved = e->started ? law_count_difference(count, e->previous) : 0;"]
    if "slope" in form.call:
        body.append("const float slope = elapsed <= 1 ? (float)moved : (float)moved / (float)elapsed;")
    body += [f"{returns} velocity;", "", "if (elapsed < 1)", "    elapsed = 1;", f"velocity = {form.call};"]
    if not re.search(r"\b(moved|slope)\b", form.call):  # a window keeps the counts themselves
        body = [line for line in body if "moved =" not in line]
        members.remove("int32_t previous; /* count of the last call */")
    else:
        body.append("e->previous = count;")
    if not re.search(r"e->started", "".join(body)):
        members.remove("int started;")
    else:
        body.append("e->started = 1;")
    body.append("return velocity;" if in_integers else f"return {c_float(per_count)} * velocity;")
    begin = [f"*e = ({prefix}_estimator){{0}};"]
    begin += ["law_biquad_reset(&e->memory, &NUMBERS);"] if in_integers else []
    effort = "float effort, " if re.search(r"\beffort\b", form.call) else ""
    unit = "; effort: mean of the motor's since the call before (N·m or N)" if effort else ""
    return f"""typedef struct {{
{_indent(members)}
}} {prefix}_estimator;

/* Initialise: no count has been seen. */
static inline void {prefix}_begin({prefix}_estimator *e)
{{
{_indent(begin)}
}}

/* Call once per velocity period{unit}. */
static inline {returns} {prefix}_velocity({prefix}_estimator *e, int32_t count, {effort}uint32_t elapsed)
{{
{_indent(body)}
}}
"""


def _indent(lines: list[str]) -> str:
    return "\n".join(f"    {line}" if line else "" for line in lines)
