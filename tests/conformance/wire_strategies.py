"""Hypothesis strategies for everything that a frame can contain, derived from the tables of the protocol."""

from functools import cache

from hypothesis import strategies as st

from firmware_protocol.messages import MESSAGES, Message
from firmware_protocol.packing import data_limit
from firmware_protocol.parameter import Parameter
from firmware_protocol.parameters import PARAMETERS
from firmware_protocol.wire import wire_fields


@cache
def integers_of(ctype: str) -> st.SearchStrategy[int]:
    """Return a strategy for a C integer type, with frequent limits."""
    bits = int(ctype[1:])
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if ctype[0] == "i" else (0, (1 << bits) - 1)
    return st.integers(low, high) | st.sampled_from([low, high, 0])


@cache
def messages_of(cls: type[Message]) -> st.SearchStrategy[Message]:
    parts = {
        name: st.binary(max_size=data_limit(cls)) if wire.ctype == "bytes" else integers_of(wire.ctype)
        for name, wire in wire_fields(cls).items()
    }
    return st.builds(cls, **parts)


@cache
def any_message() -> st.SearchStrategy[Message]:
    return st.sampled_from(sorted(MESSAGES)).flatmap(lambda type_id: messages_of(MESSAGES[type_id]))


def values_of(parameter: Parameter) -> st.SearchStrategy[int | float]:
    if parameter.ctype == "f32":
        return st.floats(parameter.minimum, parameter.maximum, width=32)
    return st.integers(int(parameter.minimum), int(parameter.maximum)).filter(parameter.accepts)


def parameter_sets() -> st.SearchStrategy[dict[str, int | float]]:
    """Return a strategy for any subset of the parameters with accepted values."""
    optional = {parameter.name: values_of(parameter) for parameter in PARAMETERS}
    return st.fixed_dictionaries({}, optional=optional)
