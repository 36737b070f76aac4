"""Parameters of a simulated person's hand for three grips of a handle: relaxed, normal and firm.

A verdict about a wall should be taken over all three. Theory, experiment files, `rig.doctor`, the design and sessions
use them. This file must not simulate a hand.

*Relaxed* and *firm* span what the literature gives for hands: 50 to 800 N/m, 1 to 10 N·s/m, 5 to 40 g at the handle;
stiffness and damping rise with grip force while inertia hardly does (Hasser and Cutkosky), and so does the force of
tremor (Sutton and Sykes 1967). Tremor of 15, 166 and 254 µm rms: PMC3032442.
"""

from rig.core.model import Operator

# Same for all grips: how the task is done, not how the handle is held.
_TASK = {
    "press_modulation": 0.2,  # of the reproduction
    "depth": 0.002,  # chosen: most of the push is the press
    "begin_s": 0.15,  # chosen: homing may end this much late
    "reach_s": 0.3,  # chosen: with the press arriving, hits Koul's wall at about half a radian a second
}

NO_OPERATOR = "none"  # in place of a grip: no hand at the handle

GRIPS: dict[str, Operator] = {
    operator.grip: operator
    for operator in (
        Operator(
            grip="relaxed",
            pads_mass=0.005,  # lower end of 5 … 40 g
            pads_stiffness=500.0,  # chosen, within 200 … 1300 N/m of a fingertip (Hajian and Howe 1997)
            pads_damping=2.0,  # lower end of 2 … 7 N·s/m (Hajian and Howe 1997)
            hand_mass=0.15,  # as normal: inertia hardly rises with grip force
            hand_stiffness=60.0,  # chosen, near the lower end of 50 … 800 N/m
            hand_damping=4.0,  # chosen, within 1 … 10 N·s/m: digits are not far from critically damped
            press=1.2,  # chosen: without a wall its spring stretches by 20 mm, within the window of every preset
            tremor=15e-6,
            **_TASK,
        ),
        # The values of the simulation behind the reproduction of Koul et al.: a press of about 0.4 N·m at 0.1 m, with a
        # slow swell, because a perfectly still hand hides a buzz behind Coulomb friction.
        Operator(
            grip="normal",
            pads_mass=0.010,
            pads_stiffness=1500.0,
            pads_damping=4.0,
            hand_mass=0.15,
            hand_stiffness=300.0,
            hand_damping=8.0,
            press=4.0,
            tremor=166e-6,
            **_TASK,
        ),
        Operator(
            grip="firm",
            pads_mass=0.020,  # chosen, within 5 … 40 g
            pads_stiffness=3000.0,  # chosen: twice normal
            pads_damping=8.0,  # chosen: twice normal
            hand_mass=0.15,
            hand_stiffness=800.0,  # upper end of 50 … 800 N/m
            hand_damping=10.0,  # upper end of 1 … 10 N·s/m
            press=6.0,  # chosen: with its spring within Koul's motor against the wall of the presets
            tremor=254e-6,
            **_TASK,
        ),
    )
}


def hand_text(name: str) -> str:
    """Return the name of a grip as text, for example "relaxed hand" for "relaxed"; "no hand" for `NO_OPERATOR`."""
    return "no hand" if name == NO_OPERATOR else f"{name} hand"
