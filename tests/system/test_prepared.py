"""All code that a run needs is compiled before the device is armed: nothing compiles inside the loop."""

import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from tests.conformance.firmware import need_compiler
from tests.conformance.tiers import first_by_default

PROGRAM = """
from rig.core import program; program.begin()
import sys
from pathlib import Path
from rig import config
from rig.config import presets
from rig.devices.framed import FramedDevice
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.realtime.kernel import Kernel
from rig.loop._run import LoopThread

armed, late = [False], []
in_loop = []
prepare, arm, finish = Kernel.prepare, FramedDevice.arm, LoopThread.finish

def noted(kernel):
    if armed[0] and not kernel.prepared:
        late.append(kernel.__name__)
    prepare(kernel)

def arming(device):
    armed[0] = True
    return arm(device)

def finished(loop):
    finish(loop)
    in_loop.append("scipy.linalg" in sys.modules)
    armed[0] = False

Kernel.prepare, FramedDevice.arm, LoopThread.finish = noted, arming, finished
experiment = presets.load("koul-rigid")
changes = {"controller.loop": sys.argv[1], "controller.estimator": "fdm-butterworth-fixed", "trial.duration_s": 0.6}
request = HitRequest(experiment=config.override(experiment, changes, "test"), output=Path(sys.argv[2]))
assert len(list(hit(request, admit))) == 1
print(late, in_loop, "scipy.linalg" in sys.modules)
"""
# The seal's statistics load scipy.special, which itself loads linear algebra from scipy 1.18 on.
OF_SPECIAL = tuple(map(int, version("scipy").split(".")[:2])) >= (1, 18)


@pytest.mark.parametrize("loop", first_by_default(["host", "device"]))
def test_nothing_compiles_between_arming_and_the_end_of_the_loop(loop: str, tmp_path: Path) -> None:
    """Runs in a new process, where no other test has compiled anything; linear algebra must not be loaded either."""
    if loop == "device":
        need_compiler()

    command = [sys.executable, "-c", PROGRAM, loop, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert (done.stdout, done.stderr) == (f"[] [False] {OF_SPECIAL}\n", "")
