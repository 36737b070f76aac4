"""Python computes the device's multisine from its parameters, to the last bit, and it matches the theory."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control.excitation_table import PHASES, ExcitationTable, cosine, hashed_phases
from rig.core.errors import ConfigError
from rig.core.sample import Phase
from tests.conformance.tiers import first_by_default
from tests.firmware.law.law_cases import excited
from tests.firmware.law.law_design import FIXED, FLOAT
from tests.firmware.law.law_library import inputs

M32 = 2**32


@st.composite
def tables(draw: Any, most_lines: int = 12, most_period: int = 3000) -> Any:
    lines = draw(st.integers(1, most_lines))
    step = draw(st.integers(1, 20))
    first = draw(st.integers(1, 50))
    least = 2 * (first + (lines - 1) * step) + 1
    return ExcitationTable(
        lines=lines,
        first=first,
        step=step,
        period=draw(st.integers(least, max(least, most_period))),
        amplitude=draw(st.integers(0, 2**26)),
        bits=draw(st.integers(0, 15)),
        ramp=draw(st.integers(0, 60)),
        phases=draw(st.sampled_from(PHASES)),
        seed=draw(st.integers(0, M32 - 1)),
    )


def run(law: Any, p: Any, elapsed: Any) -> Any:
    state = law.reset(p)
    state.phase = Phase.TRIAL
    return law.run(p, inputs(np.full(len(elapsed), p.reference), np.array(elapsed)), state)


@given(st.integers(0, M32 - 1), st.integers(0, 4095))
def test_cosine_and_phases_are_pythons(law: Any, number: int, line: int) -> None:
    assert law.so.law_cosine(number) == cosine(np.array([number], np.uint32))[0]
    assert law.so.law_line_phase(number, line) == hashed_phases(number, line + 1)[line]


@given(tables(), st.integers(1, 5000))
def test_the_table_is_pythons_to_the_bit_in_whatever_pieces(law: Any, excitation: Any, cosines: int) -> None:
    p = excited(FIXED, excitation)
    assert law.check(p) == 0
    assert (law.excitation(p, cosines) == excitation.table).all()


@pytest.mark.parametrize(
    ("excitation", "most_bits"),
    first_by_default(
        [
            (ExcitationTable(249, 1, 1, 20_000, 10 << 16, phases="schroeder"), True),
            (ExcitationTable(1, 32_767, 1, 65_536, 32_767 << 16), False),
            (ExcitationTable(512, 3, 56, 65_536, 24 << 16, phases="hashed", seed=5), True),
            (ExcitationTable(4096, 1, 1, 8193, 64 << 16, phases="schroeder"), False),  # which saturates
        ],
        2,
    ),
    ids=["usual", "fastest", "longest", "most"],
)
def test_large_tables_are_pythons_too(law: Any, excitation: Any, most_bits: bool) -> None:
    excitation = excitation.with_most_bits() if most_bits else excitation
    assert (law.excitation(excited(FIXED, excitation)) == excitation.table).all()


@given(tables(), st.data())
def test_currents_are_pythons_to_the_bit(law: Any, excitation: Any, data: st.DataObject) -> None:
    elapsed = data.draw(st.lists(st.sampled_from([1, 1, 1, 2, 9, 100_000]), min_size=1, max_size=40))
    p = excited(FIXED, excitation)
    shift = p.fixed_wall.shift
    values = excitation.played(np.cumsum(elapsed) - elapsed[0]).tolist()
    scaled = [v << shift - 16 if shift > 16 else v >> 16 - shift for v in values]
    expected = [max(-32767, min(32767, v + 2 ** (shift - 1) >> shift)) for v in scaled]
    assert run(law, p, elapsed)["current"].tolist() == expected


@pytest.mark.parametrize("arithmetic", [FIXED, FLOAT])
def test_it_repeats_and_is_the_multisine_that_the_host_names(law: Any, arithmetic: Any) -> None:
    excitation = ExcitationTable(11, 1, 3, 2000, 90 << 16, phases="hashed", seed=77).with_most_bits()
    wanted = excitation.multisine(20_000, 1.0).period(20_000)
    currents = run(law, excited(arithmetic, excitation), [1] * 4000)["current"]
    assert np.abs(currents - np.tile(wanted, 2)).max() <= 0.5 + excitation.error
    assert (currents[:2000] == currents[2000:]).all()


def test_a_device_refuses_what_the_host_refuses(law: Any) -> None:
    table = ExcitationTable(400, 1, 1, 1000, 2**16)
    broken = {"first": 101, "lines": 4097, "bits": 16, "amplitude": 2**31, "period": 65_537}
    for field, value in broken.items():
        p = excited(FIXED, table)
        setattr(p.excitation, field, value)
        assert law.check(p) != 0
        with pytest.raises(ConfigError):
            replace(table, **{field: value})
