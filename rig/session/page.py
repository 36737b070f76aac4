"""Provide the operator's desk for a page in the browser: questions, keys, texts of each view, and the simulated hand.

In `rig.extras.console` the server uses it for views and the session's process for the desk. It opens no terminal and no
device, and imports neither the control loop nor the simulation; `rig.session.conducting` conducts the session.
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
