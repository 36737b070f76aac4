"""Signatures of the functions that are passed to the compiled loop: estimators, laws, device links and clocks.

Each is a numba first-class function type (a plug point): the loop is compiled once for the type, and any estimator, law
or link with this signature can be passed later. Pass a kernel (`rig.realtime.kernel.kernel`), whose exceptions reach
the loop's caller, or a `NativeFunction` for an address.

If a signature changes, laws of third parties and C functions with this signature must change too.
"""

from typing import Annotated, Any

from numba import types

# A call through a plug point costs about 2 ns for a compiled function, about 0.1 µs for a ctypes callback.
_floats = types.float64[::1]
_ints = types.int64[::1]

# Estimator: (count, edge_age_s, elapsed_ticks, effort, state_f, state_i, parameters) -> velocity in position
# units per second. Called once for each velocity sample; elapsed_ticks counts velocity periods since the
# previous call (1 when none is lost); effort is the mean of what the motor applied since then (N·m or N).
# parameters[0] is the resolution, parameters[1] the velocity period in s, the rest belongs to the estimator.
ESTIMATOR_SIGNATURE = types.float64(
    types.int64, types.float64, types.int64, types.float64, _floats, _ints, _floats
)
ESTIMATOR = types.FunctionType(ESTIMATOR_SIGNATURE)
EstimatorPlug = Annotated[Any, ESTIMATOR]  # of a group (`rig.realtime.groups`)

# Law: (penetration, penetration_velocity, elapsed_ticks, state, parameters) -> reaction effort, positive
# out of the wall. Called in every tick of trial and release; penetration is negative outside the wall.
# state[LAW_CLAMPED] is the row's: non-zero when this tick's reaction was clamped; the rest is the law's own.
LAW_CLAMPED = 0
LAW_SIGNATURE = types.float64(types.float64, types.float64, types.int64, _floats, _floats)
LAW = types.FunctionType(LAW_SIGNATURE)
LawPlug = Annotated[Any, LAW]

# Link: read and write return bytes moved, 0 for none, negative -errno; wait blocks until something can be
# read or the deadline (ns, link's clock) and returns 1, 0 at the deadline, negative -errno. First argument:
# the link's own handle.
TRANSFER_SIGNATURE = types.int64(types.int64, types.int64, types.int64)
TRANSFER = types.FunctionType(TRANSFER_SIGNATURE)
TransferPlug = Annotated[Any, TRANSFER]
WAIT_SIGNATURE = types.int64(types.int64, types.int64)
WAIT = types.FunctionType(WAIT_SIGNATURE)
WaitPlug = Annotated[Any, WAIT]

# Clock: (handle) -> ns.
NOW_SIGNATURE = types.int64(types.int64)
NOW = types.FunctionType(NOW_SIGNATURE)
NowPlug = Annotated[Any, NOW]


class NativeFunction(types.WrapperAddressProtocol):
    """A C function that can be passed to the compiled loop; keep the object alive while the loop runs."""

    def __init__(self, address: int, signature: Any, keep: object = None) -> None:
        self._address = address
        self._signature = signature
        self._keep = keep

    def __wrapper_address__(self) -> int:
        return self._address

    def signature(self) -> Any:
        """Return the numba signature of this C function."""
        return self._signature
