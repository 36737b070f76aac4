"""Compute the host side of a transaction (a request and its reply): which request to send, and when, in integers.

An update of parameters consists of SET_BEGIN, SET_CHUNKs and SET_COMMIT with one nonce; the host waits for the reply to
each before it sends the next. `after_time` and `after_answer` are pure functions: `Connection` calls them and the
control loop compiles them, so parameters change in the same way before and during a run. They must use only integers,
which numba compiles.
"""

from typing import NamedTuple

from firmware_protocol.faults import Status
from firmware_protocol.messages import SetBegin, SetChunk, SetCommit
from firmware_protocol.packing import data_limit, type_id_of

# Time that a host waits for a reply before it repeats the request; the last time also applies after the last repeat.
RETRY_AFTER_S = (0.020, 0.040, 0.080)
MOST_TRIES = 1 + len(RETRY_AFTER_S)
ENDLESS = 1 << 62  # number of tries without a limit
CHUNK_BYTES = data_limit(SetChunk)

BEGIN, CHUNK, COMMIT = (type_id_of(cls) for cls in (SetBegin, SetChunk, SetCommit))
DONE, REFUSED, UNANSWERED = -1, -2, -3  # values of `step` at the end of a transaction

_OK = int(Status.OK)
_FIRST_NS, _DOUBLINGS = round(RETRY_AFTER_S[0] * 1e9), len(RETRY_AFTER_S) - 1


class Transaction(NamedTuple):
    """Progress of a transaction on the host.

    Attributes
    ----------
    nonce
        Nonce of all requests of the transaction.
    length
        Length of the parameter block (bytes); 0 for requests without a parameter block.
    step
        Type id of the request whose reply is awaited, or the result: DONE, REFUSED or UNANSWERED.
    offset
        Offset of the chunk whose reply is awaited, in the parameter block (bytes).
    tries
        Number of times that the host has sent the request of this step.
    again_at
        Time at which the host must send the request again (ns).
    """

    nonce: int
    length: int
    step: int
    offset: int = 0
    tries: int = 0
    again_at: int = 0


def after_time(t: Transaction, time_ns: int, most_tries: int) -> Transaction:
    """Return the transaction at the host time `time_ns` (ns): with one more try if its request is due to be sent.

    If `tries` of the result is larger, the caller must send the request. After `most_tries` the result is UNANSWERED.
    """
    if t.step < 0 or (t.tries > 0 and time_ns < t.again_at):
        return t
    if t.tries >= most_tries:
        return Transaction(t.nonce, t.length, UNANSWERED, t.offset, t.tries, t.again_at)
    again_at = time_ns + (_FIRST_NS << min(t.tries, _DOUBLINGS))
    return Transaction(t.nonce, t.length, t.step, t.offset, t.tries + 1, again_at)


def after_answer(t: Transaction, nonce: int, request: int, status: int, detail: int) -> Transaction:
    """Return the transaction after an ACK with these fields: its next request, or the result DONE or REFUSED.

    An ACK for another request changes nothing.
    """
    # an OK for the chunk before, which was sent twice
    late = t.step == CHUNK and status == _OK and detail != t.offset
    if t.step < 0 or nonce != t.nonce or request != t.step or late:
        return t
    # Pure integers: `Connection` calls it, and a loop that owns the link compiles the same function, so that parameters
    # change in one way before and during a run.
    step, offset = DONE, t.offset
    if status != _OK:
        step = REFUSED
    elif t.step in (BEGIN, CHUNK):
        offset += CHUNK_BYTES if t.step == CHUNK else 0
        step = CHUNK if offset < t.length else COMMIT
    return Transaction(t.nonce, t.length, step, offset, 0, 0)
