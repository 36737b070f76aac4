"""``python -m sim_backend.browser DIRECTORY``: write a page with a wall to touch, on a simulated rig compiled for it.

A page changes the wall, and chooses rates and estimator from lists. Whatever exists only in Python comes in tables:
matrix exponentials, parameter blocks, filters of a verdict, limits of linear theory.
"""

import base64
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from firmware_protocol.faults import Fault, Input, LimitFlag
from firmware_protocol.parameters import BY_NAME, encode_block
from rig import config
from rig.analysis.theory import Lifted, NotLinearError, k_max_curve, linear_loop
from rig.config import Experiment, presets
from rig.config.controller import prepare_controller
from rig.control import judging, verdict
from rig.core import board
from rig.core.errors import RigError
from rig.core.sample import COLUMNS, UNITS, Phase, RowFlag
from rig.experiments.trials.judgement import THREW_OUT, THROWN_OUT
from sim_backend.mechanics import driven_hand
from sim_backend.mechanics.plant import DiscretePlant

HERE = Path(__file__).parent
CONSOLE = HERE.parents[1] / "rig" / "extras" / "console" / "page"
FIRMWARE = HERE.parents[1] / "firmware_protocol" / "firmware"
# Position and velocity rate (Hz); a rig's own come first.
RATES = (*((rate, rate) for rate in (1000, 2000, 5000, 10000, 20000)), (10000, 1000), (20000, 2000))
ESTIMATORS = ("fdm-butterworth", "fdm", "foaw-best", "foaw-end", "levant")  # of firmware and every rig
BAND = 0.4  # of the rate: most for the upper end of a verdict's band
DAMPINGS, MOST_DAMPING = 11, 5.0  # of the limits, up to so many times the rig's own
SHOWN = ("position", "velocity", "effort_sent", "effort_applied", "penetration")
WALL = ("float_surface", "float_surface_fraction", "float_stiffness", "float_damping", "float_constant")
LIFETIME_US = 20_000.0
# Without fused operations the results are those of the simulated rig to the last bit.
COMPILE = "cc --target=wasm32-wasi -mexec-model=reactor -O2 -std=c11 -ffp-contract=off -Wl,--strip-all"
_IMPORT = re.compile(r'^import \{(.*?)\} from "(.*?)";$', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:class|const|function) (\w+))", re.MULTILINE)


def changes_of(preset: Experiment, rates: tuple[int, int], estimator: str) -> dict[str, Any]:
    """Return the changes of a rig's experiment for rates and estimator; Koul et al. scale a cut-off in this way."""
    own, judged = preset.controller, preset.verdict
    changes: dict[str, Any] = {"controller.loop": "device", "controller.estimator": estimator}
    changes |= {"controller.position_rate": rates[0], "controller.velocity_rate": rates[1]}
    if estimator == own.estimator and "cutoff_hz" in own.parameters:
        cutoff_hz = float(own.parameters["cutoff_hz"]) * rates[1] / own.velocity_rate
        changes["controller.parameters.cutoff_hz"] = cutoff_hz
    if judged.lowpass_hz > BAND * rates[0]:
        changes["verdict.lowpass_hz"] = BAND * rates[0]
    return changes


def setup_of(experiment: Experiment) -> list[float]:
    """Return the numbers of `rig_setup` in rig.c."""
    model, rate = config.rig_model(experiment), experiment.controller.position_rate
    plant, amplifier, encoder = DiscretePlant.build(model, 1.0 / rate), model.amplifier, model.encoder
    return [
        *(len(plant.phi), plant.gamma.shape[1] - 2, plant.delay_ticks, plant.handle_position, plant.effort),
        *(model.simulation.initial_position or 0.0, amplifier.effort_quantum),
        *(1.0 / amplifier.effort_per_ampere, amplifier.current_quantum_a),
        *(encoder.sign, board.over_current(model)),
        *(*asdict(board.moved_mechanics(model)).values(), *asdict(board.current_sensor(model)).values()),
        *(rate, LIFETIME_US, Input.HOLD_TO_RUN if model.operator else 0),
        *(*plant.parameters.tolist(), *plant.phi.ravel().tolist(), *plant.gamma.ravel().tolist()),
    ]


def _meter(experiment: Experiment) -> list[float]:
    tick_s, resolution = 1.0 / experiment.controller.position_rate, experiment.rig.encoder.resolution
    meter = judging.meter(config.verdict_thresholds(experiment), tick_s, resolution).arguments()
    return [*map(float, meter.recorded[0].item()), *meter.sections.ravel().tolist()]


def _limits(experiment: Experiment, dampings: list[float]) -> list[float]:
    """Return the largest stable stiffness without a hand at each damping; empty if the estimator is not linear."""
    try:
        lifted = Lifted.of(linear_loop(experiment, operator="none"))
    except NotLinearError:
        return []
    return [float(f"{limit.stiffness:.5g}") for limit in k_max_curve(lifted, None, dampings)]


def _rig(preset: Experiment) -> dict[str, Any]:
    own, limits = preset.controller, preset.rig.limits
    dragged: dict[str, Any] = {"trial.kind": "human", "trial.duration_s": 3600.0}
    dragged |= {"trial.minimum_rest_counts": 0.0, "rig.simulation.initial_position": preset.trial.start}
    dragged |= {"rig.limits.human": True, "operator.press": 0.1}  # the page sends its own press
    dragged |= {"rig.limits.effort": min(limits.effort, limits.nominal_effort)}
    dragged |= {"rig.limits.thermal_time_constant_s": 8000.0}  # no winding here heats up
    kinds: dict[str, dict[str, Any]] = {"hit": {}, "play": dragged}
    most = MOST_DAMPING * (preset.wall.damping or preset.homing.damping)
    table: dict[str, Any] = {part: {} for part in ("changes", "blocks", "setups", "meters", "limits")}
    dampings = [most * i / (DAMPINGS - 1) for i in range(DAMPINGS)]
    for rates in dict.fromkeys(((own.position_rate, own.velocity_rate), *RATES)):
        for estimator in ESTIMATORS:
            changes, key = changes_of(preset, rates, estimator), f"{rates[0]}|{rates[1]}|{estimator}"
            try:
                made = [(kind, config.override(preset, changes | more)) for kind, more in kinds.items()]
                runs = {kind: prepare_controller(one, verified=True) for kind, one in made}
            except RigError:  # these rates do not suit the estimator
                continue
            for kind, run in runs.items():
                block = encode_block(run.parameters)
                table["blocks"][f"{kind}|{key}"] = base64.b64encode(block).decode()
                table["setups"][f"{kind}|{rates[0]}"] = setup_of(run.experiment)
            hit = runs["hit"].experiment
            table["meters"][str(rates[0])] = _meter(hit)
            table["changes"][key], table["limits"][key] = changes, _limits(hit, dampings)
    return {
        **table,
        "experiment": config.as_mapping(preset),
        "dampings": dampings,
        "thresholds": asdict(config.verdict_thresholds(preset)),
        "effort_quantum": config.rig_model(preset).amplifier.effort_quantum,
        "resolution": preset.rig.encoder.sign * preset.rig.encoder.resolution,
    }


def tables() -> dict[str, Any]:
    """Return what the page needs from Python, for JSON."""
    header = re.sub(r"/\*.*?\*/", "", (HERE / "rig.h").read_text(encoding="utf-8"), flags=re.DOTALL)
    return {
        "rigs": {name: _rig(presets.load(name)) for name in presets.names()},
        "columns": [{"name": c.name, "unit": UNITS.get(c.unit, {})} for c in COLUMNS if c.name in SHOWN],
        "units": UNITS,
        "estimators": ESTIMATORS,
        "faults": {int(fault): fault.text for fault in Fault},
        "flags": dict(RowFlag.__members__),
        "phases": [phase.name.lower() for phase in Phase],
        "warnings": int(LimitFlag.SPEED | LimitFlag.POSITION),
        "toggles": verdict.TOGGLES,
        "thrown_out": {"faults": [Fault[name] for name in sorted(THROWN_OUT)], **THREW_OUT},
        "hand": {name: value for name, value in vars(driven_hand).items() if name.isupper()},
        "wall": {BY_NAME[name].id: name for name in WALL},
        "layout": [re.findall(r"\b[A-Z_]+\b", names) for names in re.findall(r"(?s)enum \{(.*?)\}", header)],
    }


def compile_rig(module: Path) -> bytes:
    """Return firmware and plant as a WebAssembly module without imports; `module` is a file for the compiler."""
    exported = set(re.findall(r"\brig_\w+(?=[\[(])", (HERE / "rig.h").read_text(encoding="utf-8")))
    sources = [*HERE.glob("*.c"), HERE.parent / "mechanics" / "plant.c", FIRMWARE / "host" / "host.c"]
    sources += [*FIRMWARE.glob("core/*.c"), *FIRMWARE.glob("law/*.c")]
    exports = [f"-Wl,--export={name}" for name in sorted(exported)]
    zig = [sys.executable, "-P", "-m", "ziglang", *COMPILE.split(), *exports]
    home = {"HOME": str(Path.home()), **os.environ}  # of the compiler's cache
    subprocess.run([*zig, "-o", str(module), *sorted(map(str, sources))], env=home, check=True)
    return module.read_bytes()


def _bundle(module: Path, done: dict[Path, str]) -> None:
    """Add a JavaScript module and its imports to `done`, each as a block: a page opened as a file loads no modules."""
    text = module.read_text(encoding="utf-8")
    for _, name in _IMPORT.findall(text):
        if (other := (module.parent / name).resolve()) not in done:
            _bundle(other, done)
    text = _IMPORT.sub(lambda m: f'const {{{m[1]}}} = modules["{Path(m[2]).name}"];', text)
    exports = f'modules["{module.name}"] = {{ {", ".join(_EXPORT.findall(text))} }};'
    done[module] = f"{{\n{_EXPORT.sub('', text)}\n{exports}\n}}\n"


def build(directory: Path) -> None:
    """Write the page into a directory."""
    directory.mkdir(parents=True, exist_ok=True)
    code = base64.b64encode(compile_rig(directory / "wall.js")).decode()
    (directory / "wall.js").unlink()  # executable, as the compiler leaves it
    data = json.dumps({"module": code, "tables": tables()}, separators=(",", ":"))
    scripts: dict[Path, str] = {}
    _bundle(HERE / "page" / "main.js", scripts)
    begin = f'"use strict";\nglobalThis.wallData = {data};\nconst modules = {{}};\n'
    (directory / "wall.js").write_text(begin + "".join(scripts.values()), encoding="utf-8")
    shown = [*CONSOLE.glob("uPlot*"), CONSOLE / "style.css", CONSOLE / "icon.svg"]
    for source in (*shown, HERE / "page" / "index.html", HERE / "page" / "wall.css"):
        shutil.copy(source, directory)


if __name__ == "__main__":
    build(Path(sys.argv[1]))
