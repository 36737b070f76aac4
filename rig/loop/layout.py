"""Memory of the compiled loop besides the ring: settings, state of the link, and buffers.

The files of the loop, trials, motions, the console and LSL import it. The numbers of `EndReason` are in the shared
memory of running loops: add new numbers at the end, and do not change existing ones.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated, NamedTuple

import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from rig.control.current import WORDS
from rig.core.sample import ROW
from rig.realtime import codec
from rig.realtime.codec import COMMAND, GET_TIME, HEAD, STATE, TIME
from rig.realtime.groups import Address, Bytes, FloatRows, Floats, IntRows, Ints, group, type_of
from rig.realtime.mailbox import MOST_BYTES, SET_FLOATS


class EndReason(IntEnum):
    """Reason for which a loop ended."""

    RUNNING = 0
    FINISHED = 1  # all phases done
    STOPPED = 2  # the stop word was set, or the process was asked to stop by a signal
    HEARTBEAT_MISSED = 3  # the supervisor's heartbeat stopped
    LINK_CLOSED = 4  # the port is gone (END_ERRNO says why)
    LINK_SILENT = 5  # no fresh sample for too long
    DEVICE_FAULT = 6  # the device latched a fault
    NONFINITE = 7  # law or estimator gave NaN or infinity
    OUT_OF_WINDOW = 8  # position window or speed limit
    HOMING_FAILED = 9  # the start was not reached in time
    LAW_RAISED = 10  # law or estimator raised an exception (set by the caller)
    OVERRUN = 11  # a tick came more than one period late, and the settings say that this ends the run
    STUCK = 12  # it did not return after a stop: law or estimator never returned (set by the caller)
    DEVICE_ENDED = 13  # the law on the device ended the run, that of the host, in other arithmetic, did not
    ENERGY = 14  # the motor gave more energy to the handle than it may
    VIOLENT = 15  # the effort oscillated between zero and its limit
    CURRENT_DIFFERS = 16  # the measured current did not follow the active one
    DEVICE_CONTRADICTS = 17  # the device's reports are inconsistent (rig.loop._contradictions)
    DEVICE_RESTARTED = 18  # the device's sample index started again
    LIMIT_SWITCH = 19  # the end of the travel was reached, or the switch's wire is broken
    # all commands of one command lifetime arrived later than this lifetime (rig.loop._link_delay)
    LINK_DELAYED = 20
    UNMOVED = 21  # the motor must have moved the rig by itself, and the count stands still


SETTINGS = np.dtype(
    [
        ("period_ns", "<i8"),
        ("session", "<i8"),
        ("lifetime_us", "<i8"),  # of every command: the device's watchdog
        ("lost_after_ns", "<i8"),  # time without a sample that ends the run
        ("device_tick_ps", "<i8"),  # unit of the device's clock
        ("current_quantum_a", "<f8"),
        # 1: wait for the recorder when the ring is full (virtual time); 0: drop, count
        ("wait_for_room", "<i8"),
        ("host_paced", "<i8"),  # 1: wake on the host's own grid; 0: on each sample
        ("stop_when_late", "<i8"),  # 1: a tick more than one period late ends the run
        ("spin_ns", "<i8"),  # host-paced: the last part of each wait, awake
        # n > 0: a limit switch that was open for n - 1 samples ends the run when it is pressed; 0: no limit switch
        ("limit_switch", "<i8"),
        # address of the word that counts requests to stop this process (rig.realtime.stop_requests), 0: none; its value
        # when the run began
        ("stop_requests", "<i8"),
        ("stop_requests_before", "<i8"),
        ("exchange_every_ns", "<i8"),  # time between clock exchanges, or 0 for none
        ("supervise_every_ns", "<i8"),  # law on the device: time between two COMMANDs; 0: the law runs here
        ("batch_samples", "<i8"),  # law on the device: most samples in a BATCH
        # law on the device: by how much its current may differ from the host's law
        ("agreement_quanta", "<i8"),
    ],
    align=True,
)

# State of the link, one row: sequence numbers and the two clocks extended to 64 bits.
PROGRESS = np.dtype(
    [
        ("filled", "<i8"),  # bytes of an unfinished frame at the front of the receive buffer
        ("started", "<i8"),
        ("answers", "<i8"),  # header sequence of the newest STATE
        ("sequence", "<i8"),  # of the next COMMAND
        ("sample_index", "<i8"),
        ("device_time", "<i8"),  # device ticks
        ("earliest", "<i8"),  # least receipt time minus its place on the grid (ns)
        ("read_at", "<i8"),  # host time when the link was last read (ns)
        ("last_fresh", "<i8"),  # host time of the newest fresh sample (ns)
        ("fresh", "<i8"),  # samples taken from the link at the last reading
        ("deadline", "<i8"),  # host-paced: the grid point of this tick (ns)
        ("late", "<i8"),  # this tick behind its grid (ns)
        ("nonce", "<i8"),  # of the last clock exchange
        ("asking", "<i8"),  # 1 while its answer is awaited
        ("asked_at", "<i8"),  # host time of the last question (ns)
        ("parameter_set", "<i8"),  # active
        ("waiting_set", "<i8"),  # taken from the mailbox, not yet active; 0 for none
        ("sets", "<i8"),  # parameter sets that became active during the run
        ("sync_told", "<i8"),  # time of the newest edge of the sync input in a STATE (32 bits)
        ("sync_time", "<i8"),  # the same extended to 64 bits (device ticks); 0 for none
        ("clock_error", "<i8"),  # device's clock ahead of its sample index (device ticks)
        ("contradiction", "<i8"),  # of the device (rig.loop._contradictions), 0 for none
        ("switch_open", "<i8"),  # samples for which the limit switch has been open
        ("active", "<i8"),  # sequence of the command that was active last, -1 for none
        ("too_old_from", "<i8"),  # sample from which on no command came in time (rig.loop._link_delay), or -1
    ],
    align=True,
)

RECEIVE_BYTES = 4096  # of the buffer for bytes from the link
EXCHANGES_KEPT = 8192  # twelve minutes; a longer run keeps the newest
# Parameter sets in one run. More are not taken: a replay would lack them.
SETS_KEPT = 256
COMMANDS_KEPT = 256  # the newest, with which the active current of a STATE is compared
WORD = 8  # bytes of a control word

FLOATS, INTS, INT_ROWS = types.float64[::1], types.int64[::1], types.int64[:, ::1]
SETTINGS_TYPE = types.Array(numba.from_dtype(SETTINGS), 1, "C")
PROGRESS_TYPE = types.Array(numba.from_dtype(PROGRESS), 1, "C")
ROWS_TYPE = types.Array(numba.from_dtype(ROW), 1, "C")


@group
class SharedRing(NamedTuple):
    """Shared memory of a run as the compiled loop sees it: addresses, and the ring buffer of recorded rows.

    `words` is the address of the control words, `mailbox` that of the mailbox for parameter sets (0: no mailbox).
    """

    words: Address
    mailbox: Address
    rows: Annotated[NDArray[np.void], ROWS_TYPE]


@group
class Buffers(NamedTuple):
    """Memory that the loop writes besides the ring; it is allocated once, because the loop must not allocate.

    Attributes
    ----------
    received, raw, transmit
        Bytes from the link, a decoded frame, and a frame to send.
    header, candidate, state, command, question, times
        Fields of a frame's header, and of the messages STATE (received, newest), COMMAND, GET_TIME and TIME.
    exchanges
        The four time stamps of each clock exchange (ns), of the newest `EXCHANGES_KEPT` exchanges.
    mail, waiting
        Bytes of the parameter set that waits to become active, and a view of them as numbers: wall position, then the
        law's parameters.
    sets
        Each parameter set that became active: its number, its first tick, its values.
    sent
        Sequence number and current of the newest `COMMANDS_KEPT` COMMANDs, and the index of the sample that each
        answers.
    currents
        Settings and memory of `rig.control.current`; zeros if the measured current is not checked.
    progress
        State of the link, an array of length 1 with the fields of `PROGRESS`.
    """

    received: Bytes
    raw: Bytes
    transmit: Bytes
    header: Ints
    candidate: Ints
    state: Ints
    command: Ints
    question: Ints
    times: Ints
    exchanges: IntRows
    mail: Bytes
    waiting: Floats
    sets: FloatRows
    sent: Ints
    currents: Ints
    progress: Annotated[NDArray[np.void], PROGRESS_TYPE]

    @classmethod
    def allocate(cls) -> Buffers:
        """Return new buffers with initial values; the caller must do this before the loop starts."""
        progress, mail = np.zeros(1, PROGRESS), np.zeros(MOST_BYTES, np.uint8)
        progress["earliest"] = 1 << 62
        progress["active"] = progress["too_old_from"] = -1
        return cls(
            received=np.zeros(RECEIVE_BYTES, np.uint8),
            raw=np.zeros(codec.RAW_BYTES, np.uint8),
            transmit=np.zeros(codec.FRAME_BYTES, np.uint8),
            header=np.zeros(len(HEAD), np.int64),
            candidate=np.zeros(len(STATE), np.int64),
            state=np.zeros(len(STATE), np.int64),
            command=np.zeros(len(COMMAND), np.int64),
            question=np.zeros(len(GET_TIME), np.int64),
            times=np.zeros(len(TIME), np.int64),
            exchanges=np.zeros((EXCHANGES_KEPT, 4), np.int64),
            mail=mail,
            waiting=mail.view(np.float64),
            sets=np.zeros((SETS_KEPT, 2 + SET_FLOATS), np.float64),
            sent=np.full(3 * COMMANDS_KEPT, -1, np.int64),
            currents=np.zeros(WORDS, np.int64),
            progress=progress,
        )


SHARED_TYPE, BUFFERS_TYPE = type_of(SharedRing), type_of(Buffers)
