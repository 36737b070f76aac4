"""Keep what pytester's runs import: it forgets its imports, which compiled libraries do not survive."""

import gc
import sys
import warnings
from collections.abc import Iterator
from functools import partialmethod
from pathlib import Path

import numba
import pytest
from _pytest.pytester import SysModulesSnapshot

if numba.config.DISABLE_JIT:
    collect_ignore_glob = ["test_*.py"]  # the loop is compiled

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
def _nothing_else_is_left(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """After a run of pytest in this process forget its test files, and close captures that it left open."""
    if "pytester" not in request.fixturenames:
        yield
        return
    own = str(request.getfixturevalue("pytester").path)

    def forget_tests(_: SysModulesSnapshot) -> None:
        for name, module in list(sys.modules.items()):
            if (getattr(module, "__file__", None) or "").startswith(own):
                del sys.modules[name]

    monkeypatch.setattr(SysModulesSnapshot, "restore", forget_tests)
    yield
    with warnings.catch_warnings(action="ignore", category=ResourceWarning):
        gc.collect()


@pytest.fixture
def suite(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """Return an empty test suite of a lab, which loads only the plug-ins that the tests use."""
    # Looking for all of them takes 0.1 s, and a traceback through this pytest to where a person stopped the run too.
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setattr(
        pytest.ExceptionInfo, "getrepr", partialmethod(pytest.ExceptionInfo.getrepr, style="native")
    )
    plugins = "-p rig.testing.plugin -p xdist -p timeout -p no:cacheprovider"
    pytester.makeini(f"[pytest]\naddopts = {plugins} --strict-markers")
    return pytester
