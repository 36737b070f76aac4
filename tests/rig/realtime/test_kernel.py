"""The kernel decorator and its disk cache: fast at the second start, and never stale."""

import ast
import functools
import json
import os
import runpy
import shutil
import subprocess
import sys
import time
from collections.abc import Container, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from rig.core import locks, program
from rig.realtime import _cache as cache
from rig.realtime import _user_cache as user_cache
from rig.realtime import compiling, groups, handlers, parts
from rig.realtime import kernel as module
from rig.realtime import source_files as sources
from rig.realtime._cache import cache_key, writable_by_others
from rig.realtime.kernel import kernel
from rig.realtime.source_files import compiled_sources, source_files

HELPER = """
from rig.constants import GAIN
from rig.realtime.kernel import kernel

@kernel("f8(f8)")
def gain(x):
    return GAIN * x
"""

LAW = """
from rig.realtime.kernel import kernel
from rig.helper import gain

@kernel("f8(f8)")
def law(x):
    return gain(x) + 1.0
"""

REPORT = """
import json
from rig.core import program
program.begin()
from rig.realtime import compiling
compiled = []
compiling.listen(compiled.append)
{before}
from rig.law import law
value = law(1.0)
print(json.dumps([value, sum(law.stats.cache_hits.values()), sum(law.stats.cache_misses.values()), compiled]))
"""


class Project:
    """A package around a copy of the decorator: a law, a helper in another file, and its constant in a third."""

    def __init__(self, place: Path) -> None:
        self.root, self.cache = place / "project", place / "cache"
        for package in ("rig", "rig/realtime", "rig/core"):
            (self.root / package).mkdir(parents=True)
            (self.root / package / "__init__.py").touch()
        for copied in (
            module,
            cache,
            sources,
            compiling,
            groups,
            handlers,
            parts,
            user_cache,
            locks,
            program,
        ):
            shutil.copy(copied.__file__, self.root.joinpath(*copied.__name__.split(".")[:-1]))
        (self.root / "rig" / "helper.py").write_text(HELPER)
        (self.root / "rig" / "law.py").write_text(LAW)
        self.write(gain=2.0)

    def write(self, gain: float) -> None:
        (self.root / "rig" / "constants.py").write_text(f"GAIN = {gain}")

    def run(self, before: str = "") -> list[Any]:
        """Run the law in a process; return its value, hits and misses of the cache, and notices of compilation."""
        environment = {
            name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "COVERAGE"))
        }
        environment |= {"PYTHONPATH": str(self.root), "HAPTIC_RIG_CACHE": str(self.cache)}
        # Python itself sees no edit of the same second and length.
        environment["PYTHONDONTWRITEBYTECODE"] = "1"
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", REPORT.format(before=before)],
            cwd=self.root, env=environment, capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip
        assert done.stderr == ""
        return list(json.loads(done.stdout))


SLOW = """
import pathlib, time
from rig.realtime import parts
make = parts.PartCompiler._compile_core

def slow(self, *args):
    pathlib.Path("begun").touch()
    while not pathlib.Path("waits").exists():
        time.sleep(0.01)
    return make(self, *args)

parts.PartCompiler._compile_core = slow
"""


@pytest.mark.exhaustive("::test_threads_prepare_a_kernel_once")
def test_second_process_waits_while_the_first_compiles_and_an_edited_constant_recompiles(
    tmp_path: Path,
) -> None:
    project = Project(tmp_path)
    with ThreadPoolExecutor(1) as beside:
        slow = beside.submit(project.run, SLOW)
        while not (project.root / "begun").exists() and not slow.done():
            time.sleep(0.01)
        other = project.run("import pathlib\ncompiling.listen(lambda on: pathlib.Path('waits').touch())")
        (project.root / "waits").touch()
    assert slow.result() == [3.0, 0, 1, [True, False]]
    assert other == [3.0, 1, 0, [True, False]]
    project.write(gain=5.0)
    assert project.run() == [6.0, 0, 1, [True, False]]


HALF = """
from rig.realtime.kernel import kernel

@kernel("f8(f8)")
def half(x):
    return {factor} * x
"""


def test_a_kernel_is_loaded_for_the_same_source_in_another_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parts.KernelCache, "directory", tmp_path)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "numbas"))
    found = []
    for place, factor in (("here", 0.5), ("there", 0.5), ("edited", 0.25)):
        (tmp_path / place).mkdir()
        path = tmp_path / place / "law_of_a_lab.py"
        path.write_text(HALF.format(factor=factor))
        os.utime(path, (1e9, 1e9))
        half = runpy.run_path(str(path), run_name="law_of_a_lab")["half"]
        values = half(4.0), sum(half.stats.cache_hits.values()), sum(half.stats.cache_misses.values())
        found.append(values)
    assert found == [(2.0, 0, 1), (2.0, 1, 0), (1.0, 0, 1)]
    assert not (tmp_path / "numbas").exists(), "a .numba_config.yaml of the current directory may name it"


def test_cache_that_others_can_write_is_refused_with_one_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Another user's machine code from there would run a law on a person's hand."""
    named, spare = tmp_path / "cache", tmp_path / "tmp"
    spare.mkdir()
    spare.chmod(0o1777)  # as /tmp
    monkeypatch.setenv("HAPTIC_RIG_CACHE", str(named))
    monkeypatch.setattr(cache.tempfile, "gettempdir", lambda: str(spare))
    assert cache.cache_root() == named
    assert not caplog.messages
    inside = cache.open_cache()
    assert (inside.parent, inside.stat().st_mode & 0o077) == (named, 0)
    for mode in (0o770, 0o702):
        caplog.clear()
        named.chmod(mode)
        assert cache.cache_root() == spare / f"haptic-rig-cache-{os.getuid()}"
        assert [str(named) in message for message in caplog.messages] == [True]
    named.chmod(0o755)
    inside.chmod(0o775)
    assert cache.open_cache().parent != named, "the directory of these kernels"
    inside.chmod(0o700)
    shutil.rmtree(named)
    named.touch()  # which stops every user, also root
    assert cache.open_cache().parent == spare / f"haptic-rig-cache-{os.getuid()}"
    tmp_path.chmod(0o777)
    assert "can replace" in writable_by_others(named)
    tmp_path.chmod(0o1777)
    assert writable_by_others(named) == ""


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a file away")
def test_a_cache_of_another_user_or_behind_a_link_of_one_is_not_used(tmp_path: Path) -> None:
    ours, theirs, link = tmp_path / "ours", tmp_path / "theirs", tmp_path / "link"
    ours.mkdir()
    theirs.mkdir()
    link.symlink_to(ours)
    assert writable_by_others(link) == ""
    os.chown(theirs, 1, 1)
    os.lchown(link, 1, 1)
    assert "another user" in writable_by_others(theirs)
    assert "another user" in writable_by_others(link)


def test_caches_unused_for_a_month_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = tmp_path / "cache"
    monkeypatch.setenv("HAPTIC_RIG_CACHE", str(root))
    for name, days in (("kernels-old", 40), ("kernels-recent", 20), ("something-else", 40)):
        (root / name).mkdir(parents=True)
        stamp = time.time() - days * 86_400
        os.utime(root / name, (stamp, stamp))
    current = cache.open_cache()
    assert {path.name for path in root.iterdir()} == {"kernels-recent", "something-else", current.name}


@functools.cache
def unedited_key() -> str:
    return cache_key(compiled_sources())


@pytest.mark.parametrize(
    ("file", "old", "new", "recompiles"),
    [
        ("rig/core/sample.py", "    INSIDE = ", "    INSIDE = 64 + ", True),  # a row flag
        ("firmware_protocol/messages.py", "    lifetime_us: ", "    lifetime: ", True),  # a field of COMMAND
        ("rig/control/step.py", "def step(", "def step_(", True),
        ("rig/cli/hit.py", "def ", "def x_", False),
        ("rig/experiments/hits/hit.py", '"""', '"""Edited. ', False),
        ("rig/session/engine/_conduct.py", "def ", "def x_", False),
    ],
)
def test_key_follows_only_the_sources_of_kernels(
    monkeypatch: pytest.MonkeyPatch, file: str, old: str, new: str, recompiles: bool
) -> None:
    read, edited = sources._read_source, []

    def read_edited(path: str) -> bytes:
        text = read(path)
        if not path.endswith(f"/{file}"):
            return text
        assert old.encode() in text
        edited.append(path)
        return text.replace(old.encode(), new.encode(), 1)

    unedited_key()
    monkeypatch.setattr(sources, "_read_source", read_edited)
    assert (cache_key(compiled_sources()) != unedited_key()) == recompiles
    assert len(edited) == 1


def test_the_key_covers_kernels_and_what_they_import() -> None:
    """The key's fast import finder must miss no form of import that Python's own parser finds."""
    files, covered = source_files(), compiled_sources()
    compiled = {name for name, path in files.items() if "@kernel(" in path.read_text()}
    assert compiled - {sources.__name__} <= set(covered)
    for name, text in covered.items():
        assert set(imported(text.decode(), files)) <= set(sources._find_imports(text, files)), name
    assert {"rig.control.step", "rig.core.sample", "firmware_protocol.messages"} <= set(covered)
    assert source_files(["no_such_package"]) == {}


def imported(text: str, files: Container[str]) -> list[str]:
    """Return the project's modules that a source imports; reject relative imports, which the key does not see."""
    names: list[str] = []
    for node in statements(ast.parse(text)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, ast.unparse(node)
            names += [str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)]
    return [name for name in names if name in files]


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    for part in ("body", "orelse", "handlers", "finalbody", "cases"):
        inner = getattr(tree, part, ())
        for node in inner if isinstance(inner, list) else ():  # not a lambda's or an expression's
            yield node
            yield from statements(node)


def test_any_change_of_names_or_contents_changes_the_key() -> None:
    def key(**contents: str) -> str:
        return cache_key({name: text.encode() for name, text in contents.items()})

    keys = [key(a="1", b="2"), key(a="2", b="1"), key(a="12", b=""), key(a="1", c="2"), key(a="1"), key()]
    assert len(set(keys)) == len(keys)
    assert key(a="1", b="2") == keys[0]
    assert all(len(k) == 16 and int(k, 16) >= 0 for k in keys)


def test_key_covers_compiler_and_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = [cache_key({})]
    monkeypatch.setattr(module.numba, "__version__", "0.0.1")
    keys.append(cache_key({}))
    monkeypatch.setattr(cache, "get_host_cpu_name", lambda: "another")
    keys.append(cache_key({}))
    assert len(set(keys)) == 3


@kernel("f8(f8, f8)", cache=False)
def quotient(a: float, b: float) -> float:
    """Divide by numpy's error model: no exception, also for zero."""
    return a / b


@kernel(["f8(f8)", "f4(f4)"], cache=False, inline=True)
def twice(x: Any) -> Any:
    return x + x


def test_a_kernel_raises_nothing_and_holds_no_gil() -> None:
    assert quotient(1.0, 0.0) == np.inf
    assert np.isnan(quotient(0.0, 0.0))
    assert quotient.targetoptions["nogil"] is True
    assert quotient.targetoptions["fastmath"] is False


def test_a_kernel_is_compiled_for_its_signatures_and_no_others() -> None:
    twice.prepare()
    assert [str(s) for s in twice.nopython_signatures] == ["(float64,) -> float64", "(float32,) -> float32"]
    with pytest.raises(TypeError, match="No matching definition"):
        twice("ab")


LIGHT = """
import sys
import rig.config, rig.control.excitation
heavy = {"numba", "scipy", "pydantic"} & set(sys.modules)
assert not heavy, heavy
from rig.config import presets
presets.load("koul-compliant")
import firmware_protocol, rig, rig.control.estimators, rig.control.verdict
import rig.recording.export, rig.recording.reader, rig.recording.seal, rig.session.finished
rig.control.estimators.names()
heavy = {"numba", "scipy", "pandas", "pyarrow", "matplotlib"} & set(sys.modules)
assert not heavy, heavy
"""


def test_modules_without_kernels_do_not_load_the_compiler() -> None:
    subprocess.run([sys.executable, "-c", LIGHT], check=True, timeout=60)


def test_a_kernel_without_reference_counts_writes_into_its_arrays_and_cannot_make_one() -> None:
    """Arrays stay the caller's without reference counting, and the compiler rejects an allocation."""

    @kernel("f8(f8[::1])", cache=False, no_refcount=True)
    def double_first(values: Any) -> Any:
        values[0] *= 2.0
        return values[0]

    values = np.array([3.0])
    holders = sys.getrefcount(values)
    assert double_first(values) == 6.0
    assert values[0] == 6.0
    assert sys.getrefcount(values) == holders

    def allocate(size: Any) -> Any:
        return np.zeros(size)[0]

    with pytest.raises(numba.core.errors.NumbaError):
        kernel("f8(i8)", cache=False, no_refcount=True)(allocate).prepare()


def test_part_used_in_many_places_computes_the_same() -> None:
    """Inline functions that are nested, reached in two ways, of two signatures, or compiled on their own before."""

    @kernel("f8(f8)", cache=False)
    def half(x: Any) -> Any:
        return 0.5 * x

    @kernel(["f8(f8)", "i8(i8)"], cache=False, inline=True)
    def next_one(x: Any) -> Any:
        return x + 1

    @kernel("f8(f8)", cache=False)
    def one_way(x: Any) -> Any:
        return half(x) + next_one(x)

    @kernel("f8(f8)", cache=False, no_refcount=True)
    def other_way(x: Any) -> Any:
        return one_way(half(x)) + float(next_one(int(x))) + min(x, 3.0)

    @kernel("f8(f8)", cache=False)
    def both(x: Any) -> Any:
        return one_way(x) - other_way(x)

    def expected(x: float) -> float:
        return (0.5 * x + x + 1.0) - (0.25 * x + 0.5 * x + 1.0 + int(x) + 1.0 + min(x, 3.0))

    assert [both(x) for x in (0.0, 5.0, -2.5)] == [expected(x) for x in (0.0, 5.0, -2.5)]
    assert not one_way.prepared
    assert one_way(4.0) == 7.0

    @kernel("f8(f8)", cache=False)
    def later(x: Any) -> Any:
        return one_way(x) + other_way(x)

    assert later(4.0) == 7.0 + 4.0 + 5.0 + 3.0


def test_an_exception_of_a_part_reaches_the_caller() -> None:
    @kernel("f8(f8)", cache=False)
    def root(x: Any) -> Any:
        if x < 0.0:
            raise ValueError("no root of a negative number", x)
        return np.sqrt(x)

    @kernel("f8(f8)", cache=False)
    def sum_of_roots(x: Any) -> Any:
        return root(x) + root(x - 1.0)

    assert sum_of_roots(4.0) == 2.0 + np.sqrt(3.0)
    with pytest.raises(ValueError, match="no root of a negative number") as raised:
        sum_of_roots(0.5)
    assert raised.value.args == ("no root of a negative number", -0.5)


def test_threads_prepare_a_kernel_once() -> None:
    @kernel("f8(f8)", cache=False)
    def square(x: Any) -> Any:
        return x * x

    with ThreadPoolExecutor(8) as threads:
        assert list(threads.map(square, range(8))) == [float(i * i) for i in range(8)]
    assert len(square.signatures) == 1
