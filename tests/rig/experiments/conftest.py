"""Let simulated devices claim to be real ones, for the tests of experiments."""

import pytest

from tests.conformance.claimed import claim_to_be_real


@pytest.fixture
def real(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make simulated devices claim to be real ones."""
    claim_to_be_real(monkeypatch)
