"""Import libraries before pytester runs: it forgets its imports, which compiled libraries do not survive."""

import gc
import warnings
from collections.abc import Iterator
from pathlib import Path

import numba
import pytest

if numba.config.DISABLE_JIT:
    collect_ignore_glob = ["test_*.py"]  # the loop is compiled

import rig.testing.every_frame
import rig.testing.golden
import rig.testing.maps
import rig.testing.served  # noqa: F401
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.testing import Experiments


@pytest.fixture(scope="session", autouse=True)
def _loaded(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Run one hit, then freeze its objects so that garbage collections below are quick."""
    if numba.config.DISABLE_JIT:
        return
    short = Experiments(None, Path()).short()
    assert len(list(hit(HitRequest(experiment=short, output=tmp_path_factory.mktemp("loaded")), admit))) == 1
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def _captures_closed(request: pytest.FixtureRequest) -> Iterator[None]:
    """Close captures that an interrupted pytest run in this process left open, before the next test."""
    yield
    if "pytester" in request.fixturenames:
        with warnings.catch_warnings(action="ignore", category=ResourceWarning):
            gc.collect()


@pytest.fixture
def suite(pytester: pytest.Pytester) -> pytest.Pytester:
    """Return an empty test suite of a lab."""
    pytester.makeini("[pytest]\naddopts = -p rig.testing.plugin -p no:cacheprovider --strict-markers")
    return pytester
