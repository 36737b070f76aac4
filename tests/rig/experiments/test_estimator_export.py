"""Estimators exported as C: compiled, they give the host's velocities; those without an export state the reason."""

import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rig import config
from rig.config import presets
from rig.control import estimators
from rig.core.errors import ConfigError, RecordingError
from rig.experiments.estimation._estimator_export import EstimatorExport, Tolerance, export_estimator
from rig.experiments.estimation._signals import SIGNALS
from rig.experiments.estimation.cases import signal_case
from rig.experiments.estimation.estimators import Variant
from tests.conformance.estimator import REQUIRED
from tests.conformance.tiers import first_by_default
from tests.firmware.build import compile_c

VARIANTS = [
    Variant("fdm"),
    Variant("fdm-butterworth"),
    Variant("fdm-butterworth", {"order": 1.0}),
    Variant("fdm-butterworth", {"order": 8.0, "cutoff_hz": 300.0}),
    Variant("fdm-butterworth", {"cutoff_hz": 20.0}),
    Variant("fdm-butterworth-fixed"),
    Variant("fdm-butterworth-fixed", {"rounding": "zero", "state_bits": 4.0}),
    Variant("foaw-end", {"stop": "global", "window_limit": 64.0}),
    Variant("foaw-best"),
    Variant("foaw-best", {"anchor": "last", "band": 1.5}),
    Variant("levant"),
    Variant("levant", {"discretisation": "explicit", "output": "u1", "lipschitz": 20.0}),
    Variant("levant", {"discretisation": "semi-implicit", "lipschitz": 500.0}),
    Variant("levant", {"lipschitz": 1.0, "output": "u1"}),
    Variant("kalman", {"gain": "steady"}),
    Variant("kalman", {"gain": "steady", "model": "double", "bandwidth_hz": 20.0}),
    Variant("tracking"),
    Variant("disturbance"),
    Variant("disturbance-two-mass", REQUIRED["disturbance-two-mass"]),
]
REFUSED = {
    "period": "time of each encoder edge",
    "period-frequency": "time of each encoder edge",
    "optimal": "runs on the host only",
    "foaw-levant": "runs on the host only",
    "kalman": "only the steady gain",
}


def rig_of(**changes: Any) -> config.Experiment:
    return config.override(presets.load("koul-rigid"), changes)


def write_export(variant: Variant, directory: Path, **more: Any) -> EstimatorExport:
    return export_estimator(variant, rig_of(), directory / "estimator.h", costs=False, **more)


def try_compile(export: EstimatorExport) -> subprocess.CompletedProcess[str]:
    program = compile_c(export.test.with_suffix(""), [export.test], [])
    return subprocess.run([program], capture_output=True, text=True, timeout=20, check=False)


@pytest.mark.parametrize("variant", first_by_default(VARIANTS, 2), ids=lambda variant: variant.label)
def test_the_compiled_estimator_gives_the_velocities_of_the_host(variant: Variant, tmp_path: Path) -> None:
    done = try_compile(write_export(variant, tmp_path))
    assert done.returncode == 0, done.stdout


def test_every_estimator_can_be_exported_or_is_refused_with_the_reason(tmp_path: Path) -> None:
    exported = {variant.estimator for variant in VARIANTS}
    assert exported | set(REFUSED) == set(estimators.BUILT_IN)
    for name, why in REFUSED.items():
        with pytest.raises(ConfigError, match=rf"{name} cannot be exported as C: .*{why}") as refused:
            write_export(Variant(name), tmp_path)
        assert "loop" not in str(refused.value)
        assert refused.value.remedy.startswith("choose ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("variant", "number"),
    [
        (Variant("kalman", {"gain": "steady"}), "gain_velocity"),
        (Variant("levant", {"discretisation": "explicit", "lipschitz": 500.0}), "alpha"),
    ],
    ids=lambda one: one if isinstance(one, str) else one.label,
)
def test_the_test_finds_a_number_off_by_a_tenth(variant: Variant, number: str, tmp_path: Path) -> None:
    export = write_export(variant, tmp_path)
    (found,) = re.finditer(rf"\.{number} = ([\d.e-]+)(f?),", export.text)
    changed = f"{1.1 * float(found[1]):{'.9g' if found[2] else '.0f'}}{found[2]}"
    text = f"{export.text[: found.start(1)]}{changed}{export.text[found.end() - 1 :]}"
    export.header.write_text(text)
    done = try_compile(export)
    assert done.returncode == 1
    assert "allowed" in done.stdout


def test_samples_that_were_missed_and_a_counter_that_wraps_are_part_of_the_test(tmp_path: Path) -> None:
    x = rig_of()
    case = signal_case(SIGNALS["sine"], 2000.0, x.rig.encoder.resolution)
    kept = slice(None, None, 3)
    times = {"time_s": case.time_s[kept], "edge_time": case.time_s[kept], "elapsed": 3 * case.elapsed[kept]}
    gaps = replace(case, counts=case.counts[kept] + 2**31, judged=case.judged[kept], **times)
    export = write_export(Variant("kalman", {"gain": "steady"}), tmp_path, case=gaps)
    assert "kalman_kalman" not in export.text, "a name gets the prefix once"
    assert "{-2147483" in export.test_text
    assert try_compile(export).returncode == 0


def test_the_settings_of_the_experiment_are_those_of_its_own_estimator(tmp_path: Path) -> None:
    tuned = rig_of(**{
        "controller.estimator": "kalman",
        "controller.parameters.gain": "steady",
        "controller.parameters.bandwidth_hz": 77.0,
    })  # fmt: skip
    own = export_estimator(Variant("kalman"), tuned, tmp_path / "a.h", costs=False)
    assert own.settings == {"gain": "steady", "bandwidth_hz": 77.0}
    assert "bandwidth_hz = 77" in own.text
    other = export_estimator(Variant("levant"), tuned, tmp_path / "b.h", costs=False)
    assert other.settings == {}
    over = export_estimator(Variant("kalman", {"bandwidth_hz": 50.0}), tuned, tmp_path / "c.h", costs=False)
    assert over.settings["bandwidth_hz"] == 50.0


def test_two_of_them_may_stand_in_one_file(tmp_path: Path) -> None:
    for name in ("foaw-end", "foaw-best", "levant", "fdm-butterworth-fixed"):
        export_estimator(Variant(name), rig_of(), tmp_path / f"{name}.h", costs=False)
    text = "".join(path.read_text() for path in sorted(tmp_path.glob("*.h")))
    assert {head.split()[0] for head in re.findall(r"^(\w.*)\n\{", text, re.M)} == {"static"}, (
        "in two files, too"
    )
    both = tmp_path / "both.c"
    includes = "".join(f'#include "{path.name}"\n' for path in sorted(tmp_path.glob("*.h")))
    both.write_text(f"{includes}int main(void)\n{{\n    return 0;\n}}\n")
    compile_c(tmp_path / "both", [both], [])


def test_a_case_of_another_rig_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="sine has a resolution of 1e-06 at 2000 Hz, but the rig has"):
        write_export(Variant("fdm"), tmp_path, case=signal_case(SIGNALS["sine"], 2000.0, 1e-6))


def test_nothing_is_overwritten_unless_asked(tmp_path: Path) -> None:
    first = write_export(Variant("fdm"), tmp_path)
    with pytest.raises(RecordingError, match="cannot write"):
        write_export(Variant("levant"), tmp_path)
    assert first.header.read_text() == first.text
    assert write_export(Variant("levant"), tmp_path, overwrite=True).header.read_text() != first.text


@pytest.mark.exhaustive("::test_without_a_compiler_the_reason_stands_in_place_of_the_costs")
def test_the_costs_of_an_exported_estimator_are_counted(tmp_path: Path) -> None:
    pytest.importorskip("unicorn", reason="unicorn is not installed (pip install unicorn==2.1.4)")
    export = export_estimator(Variant("fdm"), rig_of(), tmp_path / "a.h")
    if not export.costs:
        pytest.skip(export.cost_unknown)
    small, float_, newer = export.costs
    assert (small.core, float_.core, newer.core) == ("M0+", "M4F", "M33F")
    assert 5 * float_.instructions < small.instructions  # floats in software, on the first
    assert float_.instructions <= float_.cycles <= float_.most_cycles
    assert newer.cycles is None
    assert f"M4F {float_.instructions} instructions" in export.text.replace("\n *", "")


def test_without_a_compiler_the_reason_stands_in_place_of_the_costs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ARM_NONE_EABI_GCC", str(tmp_path / "none"))
    export = export_estimator(Variant("fdm"), rig_of(), tmp_path / "b.h")
    assert export.costs == ()
    assert "which cannot be run" in export.text.replace("\n *", "")


def test_integers_have_to_be_equal(tmp_path: Path) -> None:
    assert write_export(Variant("fdm-butterworth-fixed"), tmp_path).tolerance == Tolerance(0.0, "LSB")
