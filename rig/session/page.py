"""Functions for the page in the browser: the operator's questions and keys, the texts of each view, the simulated hand.

In `rig.extras.console` the server uses this module for the views, and the session's process for its side of the user
interface. The module opens no terminal and no device, and imports neither the control loop nor the simulation;
`rig.session.conducting` conducts the session.
"""

from rig.session.planning._keymap import STOP, VERDICTS, KeyMap
from rig.session.terminal import _words as words
from rig.session.terminal._asking import SILENCE_S, AskingDesk
from rig.session.terminal._conversation import LATER, Conversation
from rig.session.terminal._participant import instruct
from rig.session.terminal._pointer import START_SHARE, WALL_SHARE, HandKind
from rig.session.terminal._seat import Seat, SeatHand, full_press, keymap_for, refuse_a_hand

__all__ = [
    "LATER",
    "SILENCE_S",
    "START_SHARE",
    "STOP",
    "VERDICTS",
    "WALL_SHARE",
    "AskingDesk",
    "Conversation",
    "HandKind",
    "KeyMap",
    "Seat",
    "SeatHand",
    "full_press",
    "instruct",
    "keymap_for",
    "refuse_a_hand",
    "words",
]
