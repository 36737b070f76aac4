"""The pytest plug-in: fixtures, options and a marker for tests of rigs, whose names begin with ``rig``.

pytest loads it in every run of an environment that has this package (entry point ``pytest11``), so this file imports
pytest and nothing slow: a fixture imports its parts on first use (`rig.testing`).

On a real rig (``--rig-url serial:///dev/…``) the tests are the same. The rig moves only with ``--rig-verified`` on the
command line (it is not accepted in a file), and a single process runs the tests. STOP is sent after each test and at
the end, also after Ctrl-C or a timeout (with pytest-timeout's ``signal`` method; its ``thread`` method kills the
process, and the device's watchdog acts). A person's STOP (Ctrl-C in a hit, ``rig stop``) ends the run of all tests.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest

from rig import testing

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from rig.devices.framed import FramedDevice

SIMULATED = "sim:"
EVERY_FRAME = "rig_every_frame"
VERIFIED = "--rig-verified"
KEPT = pytest.StashKey["testing.Kept"]()
PROPERTY = "rig_recordings"  # property of a report: directory of the test's recordings


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of this plug-in to pytest, in a separate group."""
    group = parser.getgroup("rig", "rigs: real ones, and simulated ones")
    group.addoption(
        "--rig-url",
        default="sim://",
        metavar="URL",
        help="Rig that the tests hit: sim:// (a new simulated rig for each hit), "
        "serial:///dev/ttyACM0, usb://1209:0001.",
    )
    group.addoption(
        VERIFIED,
        action="store_true",
        help="The rig of --rig-url may move: encoder and motor signs are checked, the handle is at "
        "position zero, and no hand is in its way. Must be typed on each command line; it is not "
        "read from a file.",
    )
    group.addoption(
        "--rig-record",
        choices=("failed", "all", "none"),
        default="failed",
        help="Recordings to keep in rig-recordings: of failed tests, all, none.",
    )
    group.addoption(
        "--rig-golden",
        choices=("check", "update"),
        default="check",
        help="Compare with the golden recordings, or replace them by the present ones.",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker, and refuse to run on a real rig without ``--rig-verified`` or in several processes."""
    config.addinivalue_line(
        "markers",
        f"{EVERY_FRAME}(*kinds, to=None): run the test once for each frame of its hits, with a fault there: drop, "
        "corrupt, duplicate, reorder, truncate, delay, silence, unplug (all unless named), to 'host', 'device' or both",
    )
    if not _simulated(config) and not hasattr(config, "workerinput"):
        _check_consent(config)


def _simulated(config: pytest.Config) -> bool:
    return str(config.getoption("rig_url")).startswith(SIMULATED)


def _check_consent(config: pytest.Config) -> None:
    url = config.getoption("rig_url")
    # The option tx of pytest-xdist lists its processes.
    if getattr(config.option, "tx", None):
        raise pytest.UsageError(
            f"{url} is one rig, and pytest-xdist would run its tests in several processes: add -n0"
        )
    if VERIFIED not in config.invocation_params.args:
        raise pytest.UsageError(
            f"tests would move {url}: check the signs of its motor and encoder (rig device check --url {url}), put its "
            f"handle at position zero, take all hands away, and type {VERIFIED} on this command line"
        )


# ---------------------------------------------------------------------- fixtures


@pytest.fixture(scope="session")
def _rig_rigs(request: pytest.FixtureRequest) -> Iterator[testing.Rigs]:
    config = request.config
    rigs = testing.Rigs(
        config.getoption("rig_url"), verified=config.getoption("rig_verified"), ask=_asker(config)
    )
    try:
        yield rigs
    finally:
        rigs.close()


@pytest.fixture
def rig_experiment(request: pytest.FixtureRequest) -> testing.Experiments:
    """Return a function that creates experiments: ``rig_experiment("mine.toml", {"wall.stiffness": 300.0})``.

    Indirect parametrisation sets the default: ``@pytest.mark.parametrize("rig_experiment", ["mine.toml",
    "koul-rigid"], indirect=True)``. A path is relative to the test's file.
    """
    return testing.Experiments(getattr(request, "param", None), request.path.parent)


@pytest.fixture
def _rig_fault_words() -> testing.FaultWords:
    return testing.FaultWords()


@pytest.fixture
def rig_faults(_rig_fault_words: testing.FaultWords, request: pytest.FixtureRequest) -> testing.FaultWords:
    """Return the test's script of faults, to which a test adds faults: ``rig_faults.link("drop", frame=60)``."""
    _skip_on_a_rig(request.config, "rig_faults: faults on command")
    return _rig_fault_words


@pytest.fixture
def _rig_kept(request: pytest.FixtureRequest) -> Iterator[testing.Kept]:
    node, config = request.node, request.config
    kept = testing.Kept(config.rootpath, node.nodeid, config.getoption("rig_record"))
    node.stash[KEPT] = kept
    yield kept
    kept.close()


@pytest.fixture
def rig_hit(
    _rig_rigs: testing.Rigs,
    rig_experiment: testing.Experiments,
    _rig_fault_words: testing.FaultWords,
    _rig_kept: testing.Kept,
) -> testing.Hits:
    """Return a function that drives the handle against a wall: ``rig_hit("mine.toml", {"wall.stiffness": 300.0})``."""
    return testing.Hits(_rig_rigs, rig_experiment, _rig_fault_words, _rig_kept.place)


@pytest.fixture
def rig_device(_rig_rigs: testing.Rigs, rig_experiment: testing.Experiments) -> Iterator[FramedDevice]:
    """Yield an open device: the real rig, or a simulated rig of the test's default experiment."""
    with _rig_rigs.device(rig_experiment()) as device:
        yield device


@pytest.fixture
def rig_zwidth(
    _rig_rigs: testing.Rigs,
    rig_experiment: testing.Experiments,
    _rig_kept: testing.Kept,
) -> testing.Maps:
    """Return a function that maps stable walls: ``rig_zwidth(schemes=["dual:20k/2k"], dampings=[0.0])``."""
    return testing.Maps(_rig_rigs, rig_experiment, _rig_kept.place)


@pytest.fixture
def rig_golden(request: pytest.FixtureRequest) -> testing.Golden:
    """Return a function that compares a run with its stored, checked recording: ``rig_golden(hit)``."""
    _skip_on_a_rig(request.config, "rig_golden: a rig does not repeat itself; golden recordings")
    return testing.Golden(
        request.path,
        request.node.name,
        update=request.config.getoption("rig_golden") == "update",
    )


@pytest.fixture
def rig_serial(rig_experiment: testing.Experiments) -> Iterator[testing.SerialRig]:
    """Yield a simulated rig on a serial port (`path`) for a program under test.

    The method `did()` of the rig returns the state in which the program left the device.
    """
    with testing.serve_rig(rig_experiment()) as served:
        yield served


def _skip_on_a_rig(config: pytest.Config, what: str) -> None:
    if not _simulated(config):
        pytest.skip(f"{what} need a simulated rig, and the rig is {config.getoption('rig_url')}")


# ---------------------------------------------------------------------- hooks


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip tests with scripted faults if the tests run on a real rig."""
    if item.get_closest_marker(EVERY_FRAME) is not None:
        _skip_on_a_rig(item.config, f"{EVERY_FRAME}: faults on command")


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> None:
    """Repeat a test that has the marker ``rig_every_frame``, each time with a fault at another frame."""
    marker = pyfuncitem.get_closest_marker(EVERY_FRAME)
    if marker is None:
        return
    if "rig_hit" not in pyfuncitem.funcargs:
        pytest.fail(f"a test with {EVERY_FRAME} hits through rig_hit, and this one does not request it")
    hits: Any = pyfuncitem.funcargs["rig_hit"]
    pyfuncitem.obj = testing.with_every_frame(pyfuncitem.obj, hits, marker.args, marker.kwargs.get("to"))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Keep or remove a test's recordings after its end, and report the directory of the kept recordings."""
    report = yield
    kept = item.stash.get(KEPT, None)
    if kept is not None and (report.when == "call" or report.failed) and kept.ended(failed=report.failed):
        report.user_properties.append((PROPERTY, str(kept.place)))
        report.sections.append(("recordings", str(kept.place)))
    return report


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Remove the directory of recordings if it is empty."""
    if not hasattr(session.config, "workerinput"):
        testing.tidy(session.config.rootpath)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the directories of the kept recordings."""
    places = {
        Path(value)
        for reports in terminalreporter.stats.values()
        for report in reports
        for name, value in getattr(report, "user_properties", ())
        if name == PROPERTY
    }
    if places:
        terminalreporter.write_line(
            f"recordings of {len(places)} tests: {', '.join(sorted({str(place.parent) for place in places}))}"
        )


# ---------------------------------------------------------------------- the person at a rig


def _asker(config: pytest.Config) -> Callable[[str], bool]:
    capture = config.pluginmanager.getplugin("capturemanager")

    def ask(text: str) -> bool:
        if capture is not None:
            capture.suspend_global_capture(in_=True)
        try:
            return input(f"\nrig: {text}   Enter: continue, q: end ").strip().lower() in ("", "y", "yes")
        except (EOFError, OSError):  # no terminal to ask on
            return False
        finally:
            if capture is not None:
                capture.resume_global_capture()

    return ask
