"""Load libraries before pytester runs: it would import and forget them, which compiled ones do not survive."""

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
    """Hit once; what that leaves for good, no collection below looks through again."""
    if numba.config.DISABLE_JIT:
        return
    short = Experiments(None, Path()).short()
    assert len(list(hit(HitRequest(experiment=short, output=tmp_path_factory.mktemp("loaded")), admit))) == 1
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def _captures_closed(request: pytest.FixtureRequest) -> Iterator[None]:
    """A run of pytest in this process that was interrupted leaves its captures open: not for the tests after it."""
    yield
    if "pytester" in request.fixturenames:
        with warnings.catch_warnings(action="ignore", category=ResourceWarning):
            gc.collect()


@pytest.fixture
def suite(pytester: pytest.Pytester) -> pytest.Pytester:
    """An empty suite of a lab."""
    pytester.makeini("[pytest]\naddopts = -p rig.testing.plugin -p no:cacheprovider --strict-markers")
    return pytester
