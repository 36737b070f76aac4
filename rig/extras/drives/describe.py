"""Write an initial experiment file from what a drive reports about itself: encoder, torque constant, limits.

The mechanics on its shaft are unknown to the drive: the file contains assumed values, which `rig identify` measures.
"""

import math
import sys
from string import Template

if sys.platform == "linux":
    from rig.extras.drives.address import DriveFacts

assert sys.platform == "linux"

# A quadrature encoder's counts are four per line; a drive reports counts alone.
DECODING = 4
EFFORT = 0.3  # N·m, largest effort of the initial file
SPEED = 20.0  # rad/s, speed limit of the initial file
TEXT = Template("""\
# A handle on the shaft of the $name. [drive]: read from the drive; [assumed]: replace by known values, or measure with
#   rig identify FILE --url '$url' --verified -o identified.toml
preset = "koul-rigid"

[rig]
name = "$kind-$id"
description = "a handle on the shaft of the $name, firmware $firmware"
source = "the drive itself; mechanics assumed"

[rig.mechanics]
motor_inertia = 2.0e-4               # [assumed] kg·m², rotor and hub
link_inertia = 4.0e-4                # [assumed] kg·m², a light handle of 10 cm
motor_damping = 1.0e-3               # [assumed] N·m·s/rad
motor_coulomb = 0.01                 # [assumed] N·m
end_mass = 0.0                       # [assumed] kg

[rig.amplifier]
effort_per_ampere = $per_ampere      # [drive] N·m/A, by $scale
effort_limit = $most                 # [drive] N·m at $bound
lag_s = 1.0e-3                       # [assumed] s, of the current loop and of the reply that contains the torque
current_quantum_a = $quantum         # [chosen] A
current_noise_a = $noise             # [assumed] A rms, of the torque that the drive reports

[rig.encoder]
counts_per_revolution = $lines       # [drive] its $source encoder, without the decoding
decoding = $decoding
ratio = $ratio                       # [drive] turns of that encoder for one of the handle

[rig.limits]
nominal_effort = $effort             # [assumed] N·m
effort = $effort                     # [assumed] N·m
speed = $speed                       # [chosen] rad/s, within what the drive allows

[controller]
position_rate = 1000                 # Hz
velocity_rate = 1000
parameters.cutoff_hz = 100.0

[wall]
stiffness = 4.0                      # [chosen] N·m/rad; rig doctor --url lists what the link supports
damping = 0.02

[homing]
stiffness = 2.0
damping = 0.02
effort = 0.1

[trial]
effort = 0.05                        # [chosen] N·m
start = -0.1                         # rad
minimum_rest_counts = 0.0

[verdict]
lowpass_hz = 400.0

[realtime]
""")


def text(found: DriveFacts, url: str) -> str:
    """Return the text of an experiment file (TOML) for a drive at `url`."""
    output = found.output
    decoding = DECODING if output.counts % DECODING == 0 else 1
    most = output.torque_constant * output.most_current
    effort = min(EFFORT, most)
    speed = min(SPEED, 2.0 * math.pi * output.most_speed)
    quantum = max(output.most_current / 32_000.0, 1e-3)  # the protocol sends a current in 16 bits
    filled = TEXT.substitute(
        url=url,
        kind=output.kind,
        name=f"{output.kind} {found.id}",
        id=found.id,
        firmware=found.firmware,
        source=output.encoder,
        scale=output.scale_setting,
        bound=output.current_setting,
        per_ampere=f"{output.torque_constant:.6g}",
        most=f"{_round_down(most):.4g}",
        quantum=f"{quantum:.3g}",
        noise=f"{5 * quantum:.3g}",
        lines=output.counts // decoding,
        decoding=decoding,
        ratio=f"{output.counts_per_turn / output.counts:.6g}",
        effort=f"{effort:.4g}",
        speed=f"{_round_down(speed):.4g}",
    )
    return "".join(map(_align, filled.splitlines(keepends=True)))


def _round_down(value: float) -> float:
    # Four digits. A value above the drive's limit would be refused when the drive is compared with the file.
    step = 10.0 ** (math.floor(math.log10(value)) - 3)
    return math.floor(value / step) * step


def _align(line: str) -> str:
    value, mark, comment = line.partition(" #")
    return f"{value.rstrip():36}{mark}{comment}" if mark and value.strip() else line
