"""Check that the samples sent by a law on the device are complete and agree with its STATE frames.

`rig.firmware._selftest` calls it. It only judges: it must not send to the device.
"""

from firmware_protocol import messages as m
from firmware_protocol.dictionary import Dictionary
from firmware_protocol.packing import unpack_batch_samples
from rig.core.answers import ok, question, refused
from rig.core.check import Check

STREAM_SHARE = 0.9  # least share of ticks with a sample: beginning and end have none
# Share of a period. A longer tick leaves no time for faults and transactions, which this check does not run.
LOAD_LIMIT = 0.8


@question("stream")
def judge_stream(received: list[m.Message], ticks: float, rate: int, dictionary: Dictionary) -> Check:
    """Return a check of the messages that a device sent in `ticks` ticks while it ran the law without any current.

    `rate` is the tick rate (Hz). The check fails on faults, currents, wrong counts, lost samples and too long ticks.
    """
    batches = [message for message in received if isinstance(message, m.Batch)]
    states = {message.sample_index: message for message in received if isinstance(message, m.State)}
    rows, gaps = _collect_samples(batches)
    remedy = "flash the device again; keep motor power off"
    faults = [dictionary.explain_fault(code) for code in {state.fault for state in states.values()} if code]
    if faults:
        return refused("; ".join(fault.text for fault in faults), faults[0].remedy)
    if any(current for _, current in rows.values()):
        return refused("the device set a current although the limit was zero", remedy)
    differ = [index for index, state in states.items() if index in rows and rows[index][0] != state.count]
    if differ:
        return refused(f"BATCH and STATE have different counts in {len(differ)} ticks", remedy)
    text = f"{len(rows)} samples in {len(batches)} frames, {gaps} gaps"
    worst = max((state.execution_time for state in states.values()), default=0)
    load = worst * dictionary.time_unit_ns * 1e-9 * rate
    timed = f"the longest tick took {100 * load:.2g} % of a period (homing only: no contact, no release)"
    if gaps or len(rows) < STREAM_SHARE * ticks:
        remedy = "choose a lower rate or a faster link, or close other programs; rig doctor measures the possible rate"
        return refused(f"{text}, instead of {ticks:.0f}", remedy)
    if load > LOAD_LIMIT:
        remedy = "choose a lower position_rate, or a law in integers (estimator fdm-butterworth-fixed)"
        return refused(f"{text}; {timed}", remedy)
    return ok(f"{text}; no current; {timed}")


def _collect_samples(batches: list[m.Batch]) -> tuple[dict[int, tuple[int, int]], int]:
    """Return (encoder count, current in quanta) by sample index, and the number of gaps between BATCH messages."""
    rows: dict[int, tuple[int, int]] = {}
    gaps = 0
    for number, batch in enumerate(batches):
        if number and (batch.first_index - 1) % 2**32 not in rows:
            gaps += 1
        count = batch.base_count
        for offset, (difference, current, *_) in enumerate(unpack_batch_samples(batch)):
            count += difference
            rows[(batch.first_index + offset) % 2**32] = (count, current)
    return rows, gaps
