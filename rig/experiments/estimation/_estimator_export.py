"""Export a tuned estimator as a C99 header, with a test program that runs the C code on the motion of the tuning.

`rig estimators export` calls this module. The test contains counts, and velocities of the host's estimator in float64;
its tolerance covers the rounding of float32.
"""

import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path

import numpy as np

from rig.config import Experiment, prepare_estimator
from rig.config.controller import resolution as signed
from rig.control.estimators import Floats, Ints, Prepared, run
from rig.core.errors import ConfigError, ToolchainError
from rig.core.present import Row, Table, reported
from rig.core.sample import unit_of
from rig.experiments.estimation._signals import SIGNALS
from rig.experiments.estimation.cases import Case, signal_case
from rig.experiments.estimation.estimators import Variant
from rig.firmware.cycles import FIXED, Cost, EstimatorC, c_float, cost_of, estimator_c
from rig.recording.files import refuse_existing, whole_file

HALF_ULP = 2.0**-24  # of float32, relative
# Largest rounding error of float32, in half units in the last place of the largest velocity. A difference or a slope
# over a window has three roundings (a division of whole numbers, a product). A filter accumulates roundings over its
# memory, which is longer for a lower cut-off: 64 is twice the limit in tests/firmware/law/test_law_estimators.py for
# cut-offs from 20 Hz at 2 kHz on. Integers have no rounding error.
ROUNDINGS = {
    "fdm": 4.0,
    "foaw-end": 4.0,
    "foaw-best": 4.0,
    "fdm-butterworth": 64.0,
    "kalman": 64.0,
    "tracking": 64.0,
    "disturbance": 64.0,
    "disturbance-two-mass": 64.0,
    "levant": 64.0,
}
TRIED = 8.0  # tolerance over the measured effect of a rounded memory
MOST_SAMPLES = 20_000  # largest number of samples of a test, about 600 kB of C
COSTED_SAMPLES = 400  # samples around the highest velocity whose instructions the simulator counts
DEFAULT_SIGNAL = "wall-bounce"
_WIDTH = 100
_IN_A_LINE = 4  # samples


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Largest allowed error of the exported C code's velocities: of each one, or of their rms if `rms` is True."""

    limit: float
    unit: str
    rms: bool = False

    @property
    def text(self) -> str:
        """Return the tolerance as a text with its unit, or "equal" if it is 0."""
        if self.limit == 0.0:
            return "equal"
        return f"within {self.limit:.2g} {self.unit}" + (" rms" if self.rms else "")


@dataclass(frozen=True, kw_only=True)
class EstimatorExport:
    """An exported estimator in C, and its test.

    Attributes
    ----------
    estimator, settings
        Name of the estimator, and the settings that are not at their default.
    rig, velocity_rate_hz, resolution
        Rig, velocity rate (Hz) and travel of a count (rad or m) for which the constants are computed.
    unit
        Unit of the result of ``…_velocity``: rad/s or m/s; for integers the size of the least significant bit (LSB).
    motion, samples, tolerance
        Motion, number of samples and tolerance of the test.
    costs
        Cost of one call on each processor; if empty, `cost_unknown` has the reason.
    header, test
        Paths of the files, whose contents are `text` and `test_text`.
    """

    estimator: str
    settings: dict[str, float | str]
    rig: str
    velocity_rate_hz: float
    resolution: float
    unit: str
    motion: str
    samples: int
    tolerance: Tolerance
    costs: tuple[Cost, ...]
    cost_unknown: str
    header: Path
    test: Path
    text: str = field(repr=False)
    test_text: str = field(repr=False)

    @reported
    def arithmetic(self) -> str:
        """Return ``float32`` or ``integers``, the arithmetic of the C code."""
        return "integers" if self.estimator == FIXED else "float32"

    def items(self) -> list[Row | Table]:
        """Return the lines to print: description of the exported estimator, and its cost on each processor."""
        rate = f"{self.velocity_rate_hz:g} Hz, {self.resolution:.4g} a count"
        rows: list[Row | Table] = [
            Row("estimator", self.estimator, note=f"in {self.arithmetic}, for {self.rig}: {rate}"),
            Row("velocity in", self.unit),
            Row("test", f"{self.samples} samples of {self.motion}", note=self.tolerance.text),
            Row("written", f"{self.header} and {self.test}"),
        ]
        if self.costs:
            return [*rows, _cost_table(self.costs)]
        return [*rows, Row("cost", f"unknown: {self.cost_unknown}")]


def export_estimator(
    variant: Variant,
    experiment: Experiment,
    header: Path | None = None,
    *,
    case: Case | None = None,
    signal: str = DEFAULT_SIGNAL,
    costs: bool = True,
    overwrite: bool = False,
    on_progress: Callable[[str, float], None] = lambda what, share: None,
) -> EstimatorExport:
    """Write an estimator with the constants for a rig as a C99 header, and a C program that tests the header.

    Parameters
    ----------
    variant
        Name and settings of the estimator; they override the experiment's settings if it uses the same estimator.
    experiment
        Experiment with encoder and velocity rate.
    header
        Path of the header. None: the estimator's name, for example ``kalman.h``. The test is ``kalman_test.c`` beside
        the header.
    case
        Counts for the test, usually those of the tuning. None: `signal`, measured by the rig's encoder.
    signal
        One of `rig.experiments.estimation._signals.SIGNALS`.
    costs
        True to compute the cost of a call, if a cross compiler and the simulator are installed.
    overwrite
        True to replace existing files.
    on_progress
        Called with the name of the present step and the finished fraction of the step (0 to 1).

    Raises
    ------
    ConfigError
        The estimator cannot be exported, its settings are invalid, or the case has another resolution or rate.
    RecordingError
        A file exists already, or cannot be written.
    """
    rate_hz, resolution = float(experiment.controller.velocity_rate), signed(experiment)
    settings = _settings(variant, experiment)
    own = replace(experiment.controller, estimator=variant.estimator, parameters=settings)
    prepared = prepare_estimator(replace(experiment, controller=own), resolution, 1.0 / rate_hz)
    made = estimator_c(prepared)
    header = Path(f"{made.prefix}.h") if header is None else header
    if header.suffix != ".h":
        raise ConfigError(f"{header} is not a valid name for a header", remedy="give a name that ends in .h")
    test = header.with_name(f"{header.stem}_test.c")
    if not overwrite:
        refuse_existing(header)
        refuse_existing(test)
    case = _case(signal, rate_hz, resolution) if case is None else _check_fits(case, rate_hz, resolution)
    counts, elapsed = case.counts[:MOST_SAMPLES], case.elapsed[:MOST_SAMPLES]
    effort = _test_efforts(prepared, experiment.rig.limits.effort, len(counts))
    velocity = run(prepared, counts, case.arrays[1][:MOST_SAMPLES], elapsed, effort)[0]
    computed: tuple[Cost, ...] = ()
    unknown = "not requested"
    if costs:
        computed, unknown = _costs(made, _fastest(velocity, counts, elapsed), on_progress)
    si = unit_of("velocity", experiment.rig.motion)
    export = EstimatorExport(
        estimator=variant.estimator,
        settings=settings,
        rig=experiment.rig.name,
        velocity_rate_hz=rate_hz,
        resolution=resolution,
        unit=si if made.returns == "float" else f"LSBs of {made.scale:.9g} {si}",
        motion=case.name if case.reference == "closed form" else f"{case.name} ({case.reference})",
        samples=len(counts),
        tolerance=_tolerance(prepared, counts, elapsed, velocity, si),
        costs=computed,
        cost_unknown=unknown,
        header=header,
        test=test,
        text="",
        test_text="",
    )
    export = replace(
        export,
        text=f"{_about(export)}{_add_guard(header, made.code)}",
        test_text=_test_text(export, made, counts, elapsed, velocity, effort),
    )
    for path, content in ((header, export.text), (test, export.test_text)):
        with whole_file(path, overwrite=overwrite) as file:
            file.write(content.encode())
    return export


def _settings(variant: Variant, experiment: Experiment) -> dict[str, float | str]:
    """Return the experiment's settings of this estimator, overridden by those of `variant`."""
    own = experiment.controller
    tuned = own.parameters if own.estimator == variant.estimator else {}
    return {
        **{name: value for name, value in tuned.items() if isinstance(value, int | float | str)},
        **variant.settings,
    }


def _case(name: str, rate_hz: float, resolution: float) -> Case:
    if name not in SIGNALS:
        raise ConfigError(f"unknown signal {name!r}", remedy=f"choose one of: {', '.join(SIGNALS)}")
    return signal_case(SIGNALS[name], rate_hz, resolution)


def _check_fits(case: Case, rate_hz: float, resolution: float) -> Case:
    if math.isclose(case.rate_hz, rate_hz, rel_tol=1e-9) and math.isclose(
        case.resolution, resolution, rel_tol=1e-9
    ):
        return case
    raise ConfigError(
        f"{case.name} has a resolution of {case.resolution:.6g} at {case.rate_hz:g} Hz, but the rig has "
        f"{resolution:.6g} rad or m for a count at {rate_hz:g} Hz",
        remedy="export for the rig of the recording, or test with a signal",
    )


def _test_efforts(prepared: Prepared, limit: float, samples: int) -> Floats:
    """Return motor efforts to feed into the test (N·m or N), a sine unrelated to the motion; 0 if none are used."""
    if not prepared.estimator.uses_effort:
        return np.zeros(samples)
    # As float32 has them: the test's C and this computer read the same numbers.
    return np.asarray(limit * np.sin(0.05 * np.arange(samples)), np.float32).astype(np.float64)


def _tolerance(prepared: Prepared, counts: Ints, elapsed: Ints, velocity: Floats, unit: str) -> Tolerance:
    name = prepared.estimator.name
    if name == FIXED:
        return Tolerance(0.0, "LSB")
    allowed = ROUNDINGS[name] * HALF_ULP * float(np.abs(velocity).max(initial=0.0))
    if name != "levant":
        return Tolerance(allowed, unit)
    # A rounding may change the sample at which the sign in Levant's differentiator switches, after which its output
    # follows another path. The difference depends on the motion, so that it is measured here.
    off = _with_rounded_memory(prepared, counts, elapsed) - velocity
    return Tolerance(allowed + TRIED * float(np.sqrt(np.mean(np.square(off)))), unit, rms=True)


def _with_rounded_memory(prepared: Prepared, counts: Ints, elapsed: Ints) -> Floats:
    """Return the velocities (rad/s or m/s) of an estimator whose state is rounded to float32 after each sample."""
    update = prepared.estimator.update
    state_f, state_i = np.zeros_like(prepared.state_f), np.zeros_like(prepared.state_i)
    velocities = np.empty(len(counts))
    for k, (count, periods) in enumerate(zip(counts.tolist(), elapsed.tolist(), strict=True)):
        velocities[k] = update(count, 0.0, periods, 0.0, state_f, state_i, prepared.parameters)
        state_f[:] = state_f.astype(np.float32)
    return velocities


def _fastest(velocity: Floats, counts: Ints, elapsed: Ints) -> tuple[Ints, Ints]:
    """Return counts and elapsed velocity periods of the 400 samples around the highest velocity."""
    first = max(0, int(np.abs(velocity).argmax()) - COSTED_SAMPLES // 2) if len(velocity) else 0
    return counts[first : first + COSTED_SAMPLES], elapsed[first : first + COSTED_SAMPLES]


def _costs(
    made: EstimatorC, samples: tuple[Ints, Ints], on_progress: Callable[[str, float], None]
) -> tuple[tuple[Cost, ...], str]:
    try:
        return cost_of(made, *samples, on_progress), ""
    except ToolchainError as error:
        return (), error.message


def _cost_table(costs: Sequence[Cost]) -> Table:
    head = ("a call on", "instructions", "most", "cycles", "most", "code (bytes)", "memory (bytes)")
    return Table(head, [astuple(one) for one in costs])


# ------------------------------------------------------------------ what stands in the files


def _about(export: EstimatorExport) -> str:
    """Return the C comment at the top of the header: estimator, settings, use, test and cost."""
    prefix = _prefix(export)
    chosen = (
        ", ".join(f"{name} = {value}" for name, value in export.settings.items()) or "all at their default"
    )
    paragraphs = [
        f"Velocity by the estimator {export.estimator}, in {export.arithmetic}, for {export.rig}: "
        f"{export.velocity_rate_hz:g} samples a second, {export.resolution:.9g} a count. Settings: {chosen}.",
        f"Generated by haptic-rig from its firmware (Apache-2.0). Include it, call {prefix}_begin "
        f"once and {prefix}_velocity in each velocity period: with the count of the encoder, which "
        "may wrap at 32 bits, and the periods since the last call, 1 where none was missed. No "
        f"memory is allocated and nothing is global; an estimator is one {prefix}_estimator.",
        f"It returns {export.unit}. Compile as C99, with -ffp-contract=off where results must equal another machine's.",
        f"Tested by {export.test.name} on {export.samples} samples of {export.motion}: {export.tolerance.text}.",
        _costs_in_words(export),
    ]
    lines = [line for text in paragraphs for line in (*textwrap.wrap(text, _WIDTH - 3), "")][:-1]
    return "/* " + "\n".join(f" * {line}".rstrip() for line in lines)[3:] + "\n */\n"


def _costs_in_words(export: EstimatorExport) -> str:
    if not export.costs:
        return f"Cost on a microcontroller: not computed, {export.cost_unknown}."
    each = [
        f"{c.core} {c.instructions} instructions (at most {c.most_instructions})"
        + ("" if c.cycles is None else f", {c.cycles} cycles (at most {c.most_cycles})")
        for c in export.costs
    ]
    return (
        f"A call on the fastest {COSTED_SAMPLES} samples, gcc -O2, memory without wait states, instructions "
        f"counted and cycles estimated: {'; '.join(each)}. Memory: {export.costs[0].memory_bytes} bytes."
    )


def _prefix(export: EstimatorExport) -> str:
    return export.estimator.replace("-", "_")


def _add_guard(header: Path, code: str) -> str:
    guard = "".join(c if c.isascii() and c.isalnum() else "_" for c in header.name.upper())
    return f"#ifndef RIG_{guard}\n#define RIG_{guard}\n\n{code}\n#endif\n"


def _test_text(
    export: EstimatorExport,
    made: EstimatorC,
    counts: Ints,
    elapsed: Ints,
    velocity: Floats,
    effort: Floats,
) -> str:
    """Return the C test program: it prints its largest error, and exits with 0 if the error is within the tolerance."""
    whole = made.returns != "float"
    wanted = (
        [str(round(v / made.scale)) for v in velocity.tolist()]
        if whole
        else [c_float(v) for v in velocity.tolist()]
    )
    efforts = [f", {c_float(one)}" if made.uses_effort else "" for one in effort.tolist()]
    rows = [
        f"{{{_c_int(count)}, {periods}, {value}{also}}},"
        for count, periods, value, also in zip(
            counts.astype(np.int32).tolist(), elapsed.tolist(), wanted, efforts, strict=True
        )
    ]
    member = "\n    float effort;" if made.uses_effort else ""
    argument = "samples[i].effort, " if made.uses_effort else ""
    table = "\n".join(" ".join(rows[at : at + _IN_A_LINE]) for at in range(0, len(rows), _IN_A_LINE))
    measure = "sqrt(sum / SAMPLES)" if export.tolerance.rms else "worst"
    summary = f"{export.estimator}: off by %.3g{' rms' if export.tolerance.rms else ''}"
    return f"""/* Test of {export.header.name}: {export.motion},
 * and what the host's estimator {export.estimator} makes of it in float64.
 *
 *     cc -std=c99 -ffp-contract=off {export.test.name} -lm && ./a.out
 */
#include <math.h>
#include <stdio.h>

#include "{export.header.name}"

enum {{ SAMPLES = {len(counts)} }};

static const struct {{
    int32_t count;
    uint32_t elapsed;
    {made.returns} velocity;{member}
}} samples[SAMPLES] = {{
{table}
}};

int main(void)
{{
    const double tolerance = {export.tolerance.limit!r};
    {made.prefix}_estimator e;
    double worst = 0.0, sum = 0.0, found, off;
    int i;

    {made.prefix}_begin(&e);
    for (i = 0; i < SAMPLES; i++) {{
        found = (double){made.prefix}_velocity(&e, samples[i].count, {argument}samples[i].elapsed);
        off = fabs(found - (double)samples[i].velocity);
        if (off > worst || off != off) /* what is not a number stays */
            worst = off;
        sum += off * off;
    }}
    off = {measure};
    printf("{summary}, {export.tolerance.limit:.3g} allowed\\n", off);
    return off <= tolerance ? 0 : 1;
}}
"""


def _c_int(value: int) -> str:
    return "-2147483647 - 1" if value == -(2**31) else str(value)
