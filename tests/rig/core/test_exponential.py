"""The matrix exponential equals scipy's, and is more exact if rows have different units."""

import math

import numpy as np
import pytest
from scipy import linalg

from rig.core.exponential import expm


@pytest.mark.parametrize("size", [1, 2, 6, 9])
@pytest.mark.parametrize("norm", [0.0, 1e-9, 0.499, 0.5, 0.501, 1.0, 30.0])
def test_the_exponential_equals_scipys(size: int, norm: float) -> None:
    matrix = np.random.default_rng(size).normal(size=(size, size))
    matrix *= norm / np.linalg.norm(matrix, 1)
    expected = linalg.expm(matrix)
    np.testing.assert_allclose(expm(matrix), expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())


@pytest.mark.parametrize("angle", [1e-3, 0.4, 30.0])
def test_a_stiff_spring_turns_by_its_angle_to_the_last_digits(angle: float) -> None:
    stiff = 1e7
    found = expm(np.array([[0.0, angle / stiff], [-angle * stiff, 0.0]]))
    cosine, sine = math.cos(angle), math.sin(angle)
    np.testing.assert_allclose(found, [[cosine, sine / stiff], [-sine * stiff, cosine]], rtol=1e-13)
