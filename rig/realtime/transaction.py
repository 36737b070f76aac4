"""The host's side of a transaction, compiled: the very functions of `firmware_protocol.transaction`."""

from __future__ import annotations

from numba import types

from firmware_protocol import transaction
from firmware_protocol.transaction import Transaction
from rig.realtime.kernel import kernel

_i64 = types.int64
TRANSACTION = types.NamedUniTuple(_i64, len(Transaction._fields), Transaction)

after_time = kernel(TRANSACTION(TRANSACTION, _i64, _i64))(transaction.after_time)
after_answer = kernel(TRANSACTION(TRANSACTION, _i64, _i64, _i64, _i64))(transaction.after_answer)
