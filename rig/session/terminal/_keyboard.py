"""Convert any bytes from a terminal to names of keys.

A key is named by its character or by one of these names: ``enter space tab escape backspace up down left right home end
pageup pagedown insert delete f1`` … ``f12``, ``ctrl+x``, ``alt+x``; all other keys are ``unknown``. Sources: ECMA-48
(CSI sequences); XTerm Control Sequences (SS3, ``~`` keys, modifyOtherKeys). The console (`_program`) uses it. No input
may raise an error.
"""

import re

# Longest escape sequence (bytes); more bytes without an end are noise on the line.
MOST_SEQUENCE = 64
_ESC = 0x1B  # begins a sequence: with "[" a control sequence (CSI), with "O" a single shift (SS3)
_CSI, _SS3 = ord("["), ord("O")
_BLANK, _DELETE = 0x20, 0x7F  # the ends of the printable ASCII characters, which lie between them


_FINAL = {"A": "up", "B": "down", "C": "right", "D": "left", "H": "home", "F": "end"}
_FUNCTION = {"P": "f1", "Q": "f2", "R": "f3", "S": "f4"}  # after SS3
_LINUX = {"A": "f1", "B": "f2", "C": "f3", "D": "f4", "E": "f5"}  # after CSI [, on the console of Linux
_TILDE = {
    "1": "home",
    "2": "insert",
    "3": "delete",
    "4": "end",
    "5": "pageup",
    "6": "pagedown",
    "7": "home",
    "8": "end",
    "11": "f1",
    "12": "f2",
    "13": "f3",
    "14": "f4",
    "15": "f5",
    "17": "f6",
    "18": "f7",
    "19": "f8",
    "20": "f9",
    "21": "f10",
    "23": "f11",
    "24": "f12",
}
_CONTROL = {
    13: "enter",
    10: "enter",
    9: "tab",
    27: "escape",
    127: "backspace",
    8: "backspace",
    32: "space",
    0: "space",  # with ctrl
}
# Space with a modifier key, from terminals that report modifiers (CSI u, modifyOtherKeys).
_SPACE = re.compile(r"32(;[\d:]*)*u|27;\d+;32~")


class Keyboard:
    """Converter of terminal bytes to names of keys; `flush` ends an escape sequence that stays incomplete."""

    def __init__(self) -> None:
        self._rest = b""

    @property
    def waiting(self) -> bool:
        """True if the last bytes may be incomplete: an escape may be a key or the start of a sequence."""
        return bool(self._rest)

    def feed(self, data: bytes) -> list[str]:
        """Accept bytes from the terminal and return the names of the keys that are complete."""
        self._rest += data
        keys: list[str] = []
        while self._rest:
            length, key = _first(self._rest)
            if length == 0:
                break
            self._rest = self._rest[length:]
            if key:
                keys.append(key)
        return keys

    def flush(self) -> list[str]:
        """Return the keys in an incomplete escape sequence ("escape" or "unknown"), without waiting for more bytes."""
        rest, self._rest = self._rest, b""
        if not rest:
            return []
        return ["escape" if rest == b"\x1b" else "unknown"]


def _first(data: bytes) -> tuple[int, str]:
    """Return length and name of the first key: length 0 if incomplete, name "" if the bytes are no character."""
    if data[0] == _ESC:
        return _escape(data)
    if data[0] in _CONTROL:
        return 1, _CONTROL[data[0]]
    if data[0] < _BLANK:
        return 1, f"ctrl+{chr(data[0] + 0x60)}"
    return _character(data)


def _character(data: bytes) -> tuple[int, str]:
    lead = data[0]
    length = 1 if lead < 0x80 else 2 if lead < 0xE0 else 3 if lead < 0xF0 else 4
    try:
        text = data[:length].decode()
    except UnicodeDecodeError:
        # Wait only for what can still become a character: 0xC0 and 0xC1 begin none, and a byte that continues none
        # would hold up all later keys.
        short = len(data) < length and lead >= 0xC2 and all(byte & 0xC0 == 0x80 for byte in data[1:])
        return (0, "") if short else (1, "")
    # Any blank of Unicode (an input method, AltGr) is space too.
    return length, "space" if text.isspace() else text if text.isprintable() else "unknown"


def _escape(data: bytes) -> tuple[int, str]:
    if len(data) == 1:
        return 0, ""
    if data[1] == _CSI:
        return _control_sequence(data)
    if data[1] == _SS3:
        return _single_shift(data)
    if data[1] == _ESC:
        return 1, "escape"
    length, key = _first(data[1:])
    if key == "space":
        return 1, "escape"
    name = f"alt+{chr(data[1])}" if _BLANK < data[1] < _DELETE else "unknown"
    return (1 + length, name) if length else (0, "")


def _single_shift(data: bytes) -> tuple[int, str]:
    if len(data) == 2:
        return 0, ""
    if not _BLANK < data[2] < _DELETE:
        # The sequence was cut off by other bytes, which are the next key.
        return 2, "unknown"
    letter = chr(data[2])
    return 3, _FUNCTION.get(letter) or _FINAL.get(letter) or ("enter" if letter == "M" else "unknown")


def _control_sequence(data: bytes) -> tuple[int, str]:
    if data[2:3] == b"[":
        if len(data) == 3:
            return 0, ""
        if not _BLANK < data[3] < _DELETE:
            return 3, "unknown"
        return 4, _LINUX.get(chr(data[3]), "unknown")
    for at in range(2, min(len(data), MOST_SEQUENCE)):
        if 0x40 <= data[at] <= 0x7E:
            return at + 1, _meaning(data[2 : at + 1].decode("ascii"))
        # Space is STOP, so no byte before it may swallow it: it ends any sequence that it stands in, and follows as a
        # key.
        if not 0x20 < data[at] < 0x40:
            return at, "unknown"
    return (0, "") if len(data) < MOST_SEQUENCE else (MOST_SEQUENCE, "unknown")


def _meaning(text: str) -> str:
    """Return the name of the key for a control sequence, given without its ``ESC [``."""
    if _SPACE.fullmatch(text):
        return "space"
    if text[-1] == "~":
        return _TILDE.get(text[:-1], "unknown")
    return _FINAL.get(text, "unknown")
