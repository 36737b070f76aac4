"""Clock exchanges while the loop runs: about eleven times a second, send GET_TIME after a COMMAND, and receive TIME.

An exchange has four time stamps: the host's at sending, the device's at receipt and at sending, the host's at receipt.
`rig.core.clock_fit` fits a line to them, which gives offset and drift of the two clocks. Both loops call it. It must
not wait for a reply.
"""

from typing import Any

import numpy as np
from numba import types

from rig.devices.port import PORT_TYPE, LoopPort
from rig.loop.layout import BUFFERS_TYPE, SETTINGS_TYPE, WORD, Buffers
from rig.realtime import codec, control_words
from rig.realtime.atomics import load_word, store_word
from rig.realtime.codec import GET_TIME, TIME
from rig.realtime.kernel import kernel

# Some eleven a second. No multiple of a usual period: exchanges at the same phase of each tick would hide its delay.
EVERY_NS = 91_000_000


@kernel(types.int64(types.int64, types.int64))
def device_ns(ticks: int, device_tick_ps: int) -> int:
    """Return a device time in ns; `ticks` counts units of the device's clock, of `device_tick_ps` (ps) each."""
    # In two parts: the product of ticks and picoseconds would leave 64 bits after 107 days.
    return ticks // 1000 * device_tick_ps + ticks % 1000 * device_tick_ps // 1000


@kernel(types.int64(PORT_TYPE, SETTINGS_TYPE, BUFFERS_TYPE))
def ask_time(port: LoopPort, settings: Any, buffers: Buffers) -> int:
    """Send a GET_TIME if one is due, even if the last had no reply; return 0, or -errno if the link is broken."""
    s, p = settings[0], buffers.progress[0]
    asked_at = port.now(port.clock_handle)
    if s["exchange_every_ns"] == 0 or asked_at - p["asked_at"] < s["exchange_every_ns"]:
        return 0
    p["nonce"] = (p["nonce"] + 1) % 65536
    p["asked_at"] = asked_at
    question = buffers.question
    question[GET_TIME.nonce] = p["nonce"]
    question[GET_TIME.host_sent] = asked_at
    size = codec.encode_get_time(s["session"], p["nonce"], question, buffers.transmit)
    if size < 0:
        return 0
    sent = port.write(port.handle, np.int64(buffers.transmit.ctypes.data), size)
    p["asking"] = 1 if sent == size else 0
    return int(min(sent, 0))


@kernel(types.int64(SETTINGS_TYPE, BUFFERS_TYPE, types.int64, types.uintp))
def take_time(settings: Any, buffers: Buffers, length: int, words: int) -> int:
    """If the `length` bytes in `buffers.raw` are the reply to the last GET_TIME, store its times; return 1, else 0."""
    p, times, exchanges = buffers.progress[0], buffers.times, buffers.exchanges
    device_tick_ps = settings[0]["device_tick_ps"]
    if p["asking"] == 0 or codec.decode_time(buffers.raw, length, buffers.header, times) != 0:
        return 0
    if times[TIME.nonce] != p["nonce"]:
        return 0
    p["asking"] = 0
    done = load_word(words + WORD * control_words.EXCHANGES)
    place = done % len(exchanges)
    exchanges[place, 0] = times[TIME.host_sent]
    exchanges[place, 1] = device_ns(times[TIME.device_received], device_tick_ps)
    exchanges[place, 2] = device_ns(times[TIME.device_sent], device_tick_ps)
    exchanges[place, 3] = p["read_at"]
    # Two halves in turn: a reader of the ring copies the one that is not being written, and EXCHANGES is stored last.
    for i in range(4):
        store_word(words + WORD * (control_words.CLOCK + 4 * (done % 2) + i), exchanges[place, i])
    store_word(words + WORD * control_words.EXCHANGES, done + 1)
    return 1
