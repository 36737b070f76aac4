"""Texts for a participant's screen: in each state of a session, an instruction for a person without knowledge of rigs.

The engine's names of states are for the operator. The texts in this module replace them, and reveal neither the wall
nor a fault.
"""

from collections.abc import Mapping
from typing import NamedTuple

from rig.session.engine._desk import DeskView


class Instruction(NamedTuple):
    """Instruction on a participant's screen: `cue` in large letters, `text` below.

    If `replaces` is False, the text follows the words that the operator reads to the participant (`DeskView.say`).
    """

    cue: str
    text: str = ""
    replaces: bool = True


LET_GO = "You may let go of the handle."
INSTRUCTIONS: Mapping[str, Instruction] = {
    "starting": Instruction("Please wait", "The session begins soon."),
    # The study's own words come first: the operator reads them out now, and they begin with "Again" after a repetition.
    "ready": Instruction("Get ready", "Do not move yet: wait for Go.", replaces=False),
    "hands off": Instruction("Hands off", "Let go of the handle. The motor now moves it by itself."),
    "homing": Instruction("Please wait", "Hold the handle loosely. The motor moves it to the start."),
    "free space": Instruction("Please wait", "Do not move yet: wait for Go."),
    "go": Instruction("Go", replaces=False),
    "hold": Instruction("Stay there", "Stay where you are until the screen changes."),
    "release": Instruction("Relax", "Stop pushing and relax your hand."),
    "verdict?": Instruction(
        "How was the wall?",
        "Stable: it stayed still. Buzz: it trembled. Unstable: it shook or pushed your hand away. "
        "Unsure: you cannot say.",
    ),
    "rest": Instruction("Rest", "Let go of the handle and rest your hand."),
    "question": Instruction("A question", replaces=False),
    "paused": Instruction("Pause", "Let go of the handle."),
    # Why a hit ended early is for the operator: a participant who reads it expects it in the next one.
    "stopped": Instruction("Please wait", LET_GO),
    "trouble": Instruction("Please wait", LET_GO),
    "ready to end": Instruction("Please wait", f"That was the last one. {LET_GO}"),
    "done": Instruction("Finished", f"Thank you, that was the last one. {LET_GO}"),
}


def instruct(view: DeskView) -> tuple[str, str]:
    """Return the large and the small text for the participant's screen; "Please wait" in an unknown state."""
    instruction = INSTRUCTIONS.get(view.state, Instruction("Please wait"))
    read_out = "" if instruction.replaces else view.say
    return instruction.cue, " ".join(filter(None, (read_out, instruction.text)))
